//! Cache of the manifests of jobs that are not being drawn.

use std::collections::VecDeque;
use std::io;
use std::sync::Arc;

use parking_lot::Mutex;

use super::JobError;
use super::book::JobId;
use super::live::{Frames, Live};
use super::store::Place;
use crate::film::{self, FilmError};

/// Largest number of manifests in memory.
const MOST: usize = 4;
/// Largest number of records in all of them together; a single manifest may have more.
const MOST_RECORDS: usize = 200_000;

/// The manifests that were requested last.
#[derive(Default)]
pub struct Manifests {
    known: Mutex<VecDeque<Manifest>>,
}

/// A manifest during one turn of a job ([`Live::turns`]). Frames of one size give lines of one length, so length shows no change.
struct Manifest {
    id: JobId,
    turn: u64,
    frames: Arc<Frames>,
}

impl Manifests {
    /// Records that a run takes or leaves a job: earlier reads of its manifest are then stale.
    pub fn turn(&self, id: JobId, live: &Live) {
        live.turn();
        self.forget(id);
    }

    pub fn forget(&self, id: JobId) {
        self.known.lock().retain(|known| known.id != id);
    }

    /// Returns the frames in a job's manifest; none where there is no manifest.
    ///
    /// # Errors
    /// The manifest cannot be read or is malformed.
    pub fn frames(&self, id: JobId, live: &Live, place: &Place) -> Result<Arc<Frames>, JobError> {
        // Read the turn before the file: if the file changes during the read, the result belongs to a turn that is over.
        let turn = live.turns();
        let found = {
            let known = self.known.lock();
            let found = known.iter().find(|known| (known.id, known.turn) == (id, turn));
            found.map(|known| known.frames.clone())
        };
        if let Some(frames) = found {
            return Ok(frames);
        }
        let frames = match film::records(&place.frames()) {
            Ok(frames) => Arc::new(frames),
            Err(FilmError::Io { error, .. }) if error.kind() == io::ErrorKind::NotFound => {
                return Ok(Arc::default());
            }
            Err(FilmError::Io { file, error }) => return Err(JobError::Io { file, error }),
            Err(error) => {
                return Err(JobError::Io {
                    file: place.manifest(),
                    error: io::Error::other(error),
                });
            }
        };
        let mut known = self.known.lock();
        known.retain(|known| known.id != id);
        if live.turns() == turn {
            known.push_front(Manifest { id, turn, frames: frames.clone() });
            let mut records = 0;
            let fit = known.iter().take_while(|known| {
                records += known.frames.len();
                records <= MOST_RECORDS
            });
            let fit = fit.count().clamp(1, MOST);
            known.truncate(fit);
        }
        Ok(frames)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::film::manifest::{self, Header, Record};

    /// Writes a manifest of one frame whose checksum begins with `digit`.
    fn write(place: &Place, digit: char) {
        let header = Header {
            manifest: manifest::VERSION,
            scene: "s".to_owned(),
            fps: 30.0,
            frames: 1,
            width: 1,
            height: 1,
            output: crate::plan::Output::Color,
            format: crate::encode::ImageFormat::Raw,
        };
        let record = Record {
            frame: 0,
            t: 0.0,
            file: "frame-00000.raw".to_owned(),
            bytes: 4,
            sha256: digit.to_string().repeat(64),
            tag: "1".to_owned(),
        };
        std::fs::create_dir_all(place.frames()).unwrap();
        std::fs::write(place.manifest(), manifest::text(&header, [&record]).unwrap()).unwrap();
    }

    fn sum(manifests: &Manifests, id: JobId, live: &Live, place: &Place) -> char {
        let frames = manifests.frames(id, live, place).unwrap();
        frames[&0].sha256.chars().next().unwrap()
    }

    /// A manifest read while a run begins is valid only until the run writes, even if both versions have the same length.
    #[test]
    fn a_manifest_counts_for_one_turn() {
        let at = tempfile::tempdir().unwrap();
        let (manifests, live) = (Manifests::default(), Live::new(0));
        let place = Place::new(at.path().join("7"));
        assert!(manifests.frames(7, &live, &place).unwrap().is_empty());
        write(&place, 'a');
        manifests.turn(7, &live);
        assert_eq!(sum(&manifests, 7, &live, &place), 'a');
        write(&place, 'b');
        assert_eq!(sum(&manifests, 7, &live, &place), 'a', "it is held");
        // The run has begun a new turn.
        manifests.turn(7, &live);
        assert_eq!(sum(&manifests, 7, &live, &place), 'b');
        manifests.forget(7);
        assert!(manifests.known.lock().is_empty());
    }

    #[test]
    fn few_are_held() {
        let at = tempfile::tempdir().unwrap();
        let (manifests, live) = (Manifests::default(), Live::new(0));
        for id in 0..9 {
            let place = Place::new(at.path().join(id.to_string()));
            write(&place, 'a');
            manifests.frames(id, &live, &place).unwrap();
        }
        let held: Vec<JobId> = manifests.known.lock().iter().map(|known| known.id).collect();
        assert_eq!(held, [8, 7, 6, 5]);
    }
}
