//! The measurement that runs, so that the next process goes on with it where this one ends: a file that says what is measured, and its journals.
//!
//! A server that ends in good order sets the count of starts back. One that is killed again and again by what it measures gives the measurement up.
//! What cannot be written is logged, and a measurement without it begins anew in the next process.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::Wanted;
use crate::accuracy::journal::write_whole;

/// Name of the folder beside the results. No scene can have a file of this name, since results end with `.json`.
const FOLDER: &str = "unfinished";
/// File that says what is measured.
const FILE: &str = "wanted.json";
/// Starts of a measurement, none of which ended in good order, after which it is given up.
const MOST_STARTS: u32 = 3;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Told {
    scene: String,
    wanted: Wanted,
    /// Starts since a process ended in good order.
    starts: u32,
}

/// The folder, where there is one.
pub struct Unfinished {
    folder: Option<PathBuf>,
}

impl Unfinished {
    /// `folder` is that of the results.
    pub fn new(folder: Option<&Path>) -> Unfinished {
        Unfinished { folder: folder.map(|folder| folder.join(FOLDER)) }
    }

    /// Folder of the journals.
    pub fn journals(&self) -> Option<&Path> {
        self.folder.as_deref()
    }

    /// Notes that a measurement starts, and removes what is left of another one.
    pub fn start(&self, scene: &str, wanted: &Wanted) {
        let Some(folder) = &self.folder else { return };
        let before = self.told().filter(|told| told.scene == scene && told.wanted == *wanted);
        if before.is_none() {
            self.remove();
        }
        let starts = before.map_or(0, |told| told.starts) + 1;
        let told = Told { scene: scene.to_owned(), wanted: wanted.clone(), starts };
        log(folder, fs::create_dir_all(folder).and_then(|()| write(folder, &told)));
    }

    /// Notes that the process ends in good order before the measurement does.
    pub fn pause(&self) {
        let (Some(folder), Some(told)) = (&self.folder, self.told()) else { return };
        log(folder, write(folder, &Told { starts: 0, ..told }));
    }

    /// The measurement that an earlier process began and did not end. One that was started too often is removed.
    pub fn left_over(&self) -> Option<(String, Wanted)> {
        let told = self.told();
        let gives_up = told.as_ref().is_some_and(|told| told.starts >= MOST_STARTS);
        if gives_up {
            tracing::error!(
                ?told,
                "an accuracy measurement is given up: the server was killed each time that it ran"
            );
        }
        if gives_up || told.is_none() {
            self.remove();
            return None;
        }
        told.map(|told| (told.scene, told.wanted))
    }

    /// Removes what is left of the measurement of a scene.
    pub fn remove_of(&self, scene: &str) {
        if self.told().is_some_and(|told| told.scene == scene) {
            self.remove();
        }
    }

    /// Removes everything.
    pub fn remove(&self) {
        let Some(folder) = &self.folder else { return };
        match fs::remove_dir_all(folder) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => log(folder, Err(error)),
            _ => {}
        }
    }

    fn told(&self) -> Option<Told> {
        serde_json::from_slice(&fs::read(self.folder.as_ref()?.join(FILE)).ok()?).ok()
    }
}

fn write(folder: &Path, told: &Told) -> io::Result<()> {
    write_whole(&folder.join(FILE), &serde_json::to_vec(told)?)
}

fn log(folder: &Path, done: io::Result<()>) {
    if let Err(error) = done {
        tracing::error!(folder = %folder.display(), %error, "cannot keep what an accuracy measurement needs to go on after a restart");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wanted(repeats: u32) -> Wanted {
        let (cameras, size) = (vec!["a".to_owned()], [32, 24]);
        Wanted { is_for_planner: false, is_quick: true, cameras, size, repeats }
    }

    #[test]
    fn a_measurement_is_left_over_until_it_is_removed() {
        let folder = tempfile::tempdir().unwrap();
        let open = || Unfinished::new(Some(folder.path()));
        assert_eq!(open().left_over(), None);
        open().start("town", &wanted(3));
        let journal = open().journals().unwrap().join("journal");
        fs::write(&journal, "line").unwrap();
        assert_eq!(open().left_over(), Some(("town".to_owned(), wanted(3))));
        // The same one goes on, another one begins anew.
        open().start("town", &wanted(3));
        assert!(journal.exists());
        open().start("town", &wanted(4));
        assert!(!journal.exists());
        open().remove_of("other");
        assert_eq!(open().left_over(), Some(("town".to_owned(), wanted(4))));
        open().remove_of("town");
        assert_eq!((open().left_over(), folder.path().read_dir().unwrap().count()), (None, 0));
    }

    #[test]
    fn a_measurement_that_kills_the_process_is_given_up() {
        let folder = tempfile::tempdir().unwrap();
        let open = || Unfinished::new(Some(folder.path()));
        for start in 1..=2 * MOST_STARTS {
            open().start("town", &wanted(3));
            assert!(open().left_over().is_some() || start % MOST_STARTS == 0, "{start}");
        }
        // An orderly end sets the count back.
        for _ in 0..2 * MOST_STARTS {
            open().start("town", &wanted(3));
            open().pause();
            assert!(open().left_over().is_some());
        }
    }

    #[test]
    fn what_cannot_be_read_is_removed() {
        let folder = tempfile::tempdir().unwrap();
        let unfinished = Unfinished::new(Some(folder.path()));
        unfinished.start("town", &wanted(3));
        fs::write(unfinished.journals().unwrap().join(FILE), "{").unwrap();
        assert_eq!(unfinished.left_over(), None);
        assert!(!unfinished.journals().unwrap().exists());
        // Without a folder nothing is kept.
        let none = Unfinished::new(None);
        none.start("town", &wanted(3));
        assert!(none.left_over().is_none() && none.journals().is_none());
    }
}
