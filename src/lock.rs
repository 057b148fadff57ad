//! Locks on files, for processes that must not work on the same folder (floor 0).

use std::fs::{File, TryLockError};
use std::io;
use std::ops::{Deref, DerefMut};

/// A file or folder that this process has locked, until it drops this value or ends.
#[derive(Debug)]
pub struct Locked(File);

impl Locked {
    /// Locks a file or folder, without waiting. `None` if another owner holds its lock.
    ///
    /// # Errors
    /// The file system cannot lock it.
    pub fn attempt(file: File) -> io::Result<Option<Locked>> {
        match file.try_lock() {
            Ok(()) => Ok(Some(Locked(file))),
            Err(TryLockError::WouldBlock) => Ok(None),
            Err(TryLockError::Error(error)) => Err(error),
        }
    }
}

impl Drop for Locked {
    /// Unlocks the file before it is closed. Otherwise the lock would outlast the closing while another process, a debugger for example,
    /// has a duplicate of the open file.
    fn drop(&mut self) {
        // The lock ends with the process in any case.
        let _ = self.0.unlock();
    }
}

impl Deref for Locked {
    type Target = File;

    fn deref(&self) -> &File {
        &self.0
    }
}

impl DerefMut for Locked {
    fn deref_mut(&mut self) -> &mut File {
        &mut self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lock_ends_although_the_file_is_still_open() {
        let folder = tempfile::tempdir().unwrap();
        let open = || File::open(folder.path()).unwrap();
        let first = Locked::attempt(open()).unwrap().unwrap();
        assert!(Locked::attempt(open()).unwrap().is_none());
        // A duplicate shares the lock, like one that a debugger takes.
        let shared = first.try_clone().unwrap();
        drop(first);
        assert!(Locked::attempt(open()).unwrap().is_some());
        drop(shared);
    }
}
