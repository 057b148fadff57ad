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
    /// Unlocks the file before it is closed. The lock would outlast the closing as long as another process examines the open files of this
    /// one.
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
        // Shares the lock, as what examines this process's files does.
        let shared = first.try_clone().unwrap();
        drop(first);
        assert!(Locked::attempt(open()).unwrap().is_some());
        drop(shared);
    }
}
