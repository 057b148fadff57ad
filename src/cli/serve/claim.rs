//! Ensures that only one daemon at a time keeps the uploads of a root.
//!
//! The claim is a lock on the root folder itself. It leaves no file behind, works where the root cannot be written, and the
//! system releases it however the process ends. On a file system without locks the root stays unclaimed, with a warning.

use std::fs::{File, TryLockError};
use std::path::Path;

use super::patience::{patience, patiently};

/// Holds the claim until dropped.
#[derive(Debug)]
pub(super) struct Claim {
    _folder: File,
}

#[derive(Debug, thiserror::Error)]
#[error(
    "{holder} keeps the uploads of {root}; stop it, give this one another folder with --root, or serve that one without uploads \
     with --no-uploads or --follow-uploads"
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
    let folder = match File::open(root) {
        Ok(folder) => folder,
        Err(error) => return Ok(unclaimed(root, &error)),
    };
    match folder.try_lock() {
        Ok(()) => Ok(Some(Claim { _folder: folder })),
        Err(TryLockError::WouldBlock) => {
            let holder = holder(&folder).map_or("another process".to_owned(), |id| {
                format!("process {id} ({})", name(id).unwrap_or_default())
            });
            Err(Held { holder, root: root.display().to_string() })
        }
        Err(TryLockError::Error(error)) => Ok(unclaimed(root, &error)),
    }
}

fn unclaimed(root: &Path, error: &std::io::Error) -> Option<Claim> {
    tracing::warn!(root = %root.display(), %error, "cannot lock the root: make sure that no second daemon accepts uploads there");
    None
}

/// The process that holds the lock of a folder, if the system tells.
#[cfg(target_os = "linux")]
fn holder(folder: &File) -> Option<u32> {
    use std::os::unix::fs::MetadataExt;
    let inode = folder.metadata().ok()?.ino();
    lock_owner(&std::fs::read_to_string("/proc/locks").ok()?, inode)
}

#[cfg(not(target_os = "linux"))]
fn holder(_: &File) -> Option<u32> {
    None
}

/// Finds the owner of a whole-file lock in `/proc/locks`: `1: FLOCK  ADVISORY  WRITE 42 fe:01:1234 0 EOF`.
#[cfg(any(target_os = "linux", test))]
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
    fn owners_of_locks_are_found() {
        let locks = "1: POSIX  ADVISORY  WRITE 7 fe:01:55 0 EOF\n\
                     2: FLOCK  ADVISORY  WRITE 42 fe:01:55 0 EOF\n3: -> FLOCK ADVISORY WRITE 9 fe:01:55 0 EOF\n";
        assert_eq!(lock_owner(locks, 55), Some(42));
        assert_eq!(lock_owner(locks, 5), None);
    }
}
