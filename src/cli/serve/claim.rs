//! Ensures that only one server at a time keeps the uploads of a root.
//!
//! The claim is a lock on the root folder itself. It leaves no file behind, works where the root cannot be written, and the
//! system releases it however the process ends. NFS locks only files that are open for writing: there, the claim is a lock on the file [`FILE`] in
//! the root. On a file system without locks the root stays unclaimed, with a warning.

use std::fs::{File, OpenOptions};
use std::io::Read;
use std::path::Path;

use super::patience::{patience, patiently};
use crate::lock::Locked;

/// The file that is locked where folders cannot be. It stays when it is unlocked.
const FILE: &str = ".pointillist-lock";

/// Holds the claim until dropped.
#[derive(Debug)]
pub(super) struct Claim {
    _locked: Locked,
}

#[derive(Debug, thiserror::Error)]
#[error(
    "{holder} already accepts uploads in {root}; stop it, give this server another folder with --root, or start this server \
     with --follow-uploads or --no-uploads"
)]
struct Held {
    holder: String,
    root: String,
}

/// Claims a root, and waits briefly for a process that is about to end. `None` if the file system has no locks.
///
/// # Errors
/// Another process holds the claim. The text names the process if the system tells.
pub(super) fn claim(root: &Path) -> anyhow::Result<Option<Claim>> {
    Ok(patiently(patience(), |_: &Held| true, || try_claim(root))?)
}

fn try_claim(root: &Path) -> Result<Option<Claim>, Held> {
    match lock(root, File::open(root))? {
        Ok(claim) => Ok(Some(claim)),
        Err(_) => claim_by_file(root),
    }
}

/// Claims a root by the lock on a file.
fn claim_by_file(root: &Path) -> Result<Option<Claim>, Held> {
    let file = OpenOptions::new().create(true).append(true).open(root.join(FILE));
    match lock(root, file)? {
        Ok(claim) => Ok(Some(claim)),
        Err(error) => {
            tracing::warn!(root = %root.display(), %error, "cannot lock the root: make sure that no second server accepts uploads there");
            Ok(None)
        }
    }
}

/// Locks a file or folder. The inner error is that of the file system.
fn lock(root: &Path, opened: std::io::Result<File>) -> Result<std::io::Result<Claim>, Held> {
    let file = match opened {
        Ok(file) => file,
        Err(error) => return Ok(Err(error)),
    };
    let inode = inode(&file);
    match Locked::attempt(file) {
        Ok(Some(locked)) => Ok(Ok(Claim { _locked: locked })),
        Ok(None) => {
            let holder = inode.and_then(holder).map_or("another process".to_owned(), |id| {
                format!("process {id} ({})", name(id).unwrap_or_default())
            });
            Err(Held { holder, root: root.display().to_string() })
        }
        Err(error) => Ok(Err(error)),
    }
}

/// The inode number of a file or folder, by which `/proc/locks` names it.
#[cfg(target_os = "linux")]
fn inode(file: &File) -> Option<u64> {
    use std::os::unix::fs::MetadataExt;
    Some(file.metadata().ok()?.ino())
}

#[cfg(not(target_os = "linux"))]
fn inode(_: &File) -> Option<u64> {
    None
}

/// The process that holds the lock of a file, if the system tells.
///
/// Linux writes `/proc/locks` anew for each read and continues at a position, so that a lock is left out between two reads where another process
/// releases one before it. A read of a page is consistent: the buffer is large from the start, and the list is read again if the lock is missing.
fn holder(inode: u64) -> Option<u32> {
    let locks = || {
        let mut locks = String::with_capacity(64 << 10);
        File::open("/proc/locks").ok()?.read_to_string(&mut locks).ok()?;
        Some(locks)
    };
    (0..3).find_map(|_| lock_owner(&locks()?, inode))
}

/// Finds the owner of a whole-file lock in `/proc/locks`: `1: FLOCK  ADVISORY  WRITE 42 fe:01:1234 0 EOF`.
fn lock_owner(locks: &str, inode: u64) -> Option<u32> {
    locks.lines().find_map(|line| {
        let words: Vec<&str> = line.split_whitespace().collect();
        let [_, "FLOCK", _, _, owner, file, ..] = words[..] else { return None };
        let is_it = file.rsplit(':').next()?.parse() == Ok(inode);
        is_it.then(|| owner.parse().ok()).flatten()
    })
}

fn name(id: u32) -> Option<String> {
    let name = std::fs::read_to_string(format!("/proc/{id}/comm")).ok()?;
    Some(name.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_root_is_claimed_once() {
        let folder = tempfile::tempdir().unwrap();
        let first = try_claim(folder.path()).unwrap().unwrap();
        let told = try_claim(folder.path()).unwrap_err().to_string();
        assert!(told.contains("--root") && told.contains("--no-uploads"), "{told}");
        if cfg!(target_os = "linux") {
            assert!(told.contains(&format!("process {} ", std::process::id())), "{told}");
        }
        drop(first);
        assert!(try_claim(folder.path()).unwrap().is_some());
        assert!(std::fs::read_dir(folder.path()).unwrap().next().is_none(), "no file is left");
    }

    #[test]
    fn a_root_whose_folder_cannot_be_locked_is_claimed_by_a_file() {
        let folder = tempfile::tempdir().unwrap();
        let first = claim_by_file(folder.path()).unwrap().unwrap();
        let told = claim_by_file(folder.path()).unwrap_err().to_string();
        assert!(told.contains("--root"), "{told}");
        drop(first);
        assert!(claim_by_file(folder.path()).unwrap().is_some());
        // Without a place for the file, the root stays unclaimed.
        assert!(claim_by_file(&folder.path().join("missing")).unwrap().is_none());
    }

    #[test]
    fn owners_of_locks_are_found() {
        let locks = "1: POSIX  ADVISORY  WRITE 7 fe:01:55 0 EOF\n\
                     2: FLOCK  ADVISORY  WRITE 42 fe:01:55 0 EOF\n3: -> FLOCK ADVISORY WRITE 9 fe:01:55 0 EOF\n";
        assert_eq!(lock_owner(locks, 55), Some(42));
        assert_eq!(lock_owner(locks, 5), None);
    }
}
