//! The journal of a survey: one JSON line for every finished measurement, so that a second run goes on where the first one stopped.
//!
//! The first line says what the survey measures. A run with other arguments, another scene, adapter or build is refused. A last line that
//! a crash cut off is removed. One process at a time holds the journal's lock.

use std::fs::OpenOptions;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::metrics::{Coverage, Spread};
use super::temporal::Change;
use crate::lock::Locked;
use crate::plan::Given;

/// Name of the journal in the folder of a report.
pub const JOURNAL: &str = "measurements.jsonl";

/// How the first line begins.
const FIRST: &[u8] = b"{\"kind\":\"run\"";

/// Why a journal cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum JournalError {
    #[error("{file}: {error}", file = file.display())]
    Io { file: PathBuf, error: io::Error },
    #[error("cannot make the folder {folder}: {error}", folder = folder.display())]
    Folder { folder: PathBuf, error: io::Error },
    #[error("{folder} has files of other things; give a new or empty folder, whose files the report may replace", folder = folder.display())]
    Foreign { folder: PathBuf },
    #[error(
        "{file} belongs to a run with {differences}; give another folder, repeat that run's arguments, or delete the folder to start anew",
        file = file.display()
    )]
    Other { file: PathBuf, differences: String },
    #[error("{file}, line {line}: {reason}; delete the file to start anew", file = file.display())]
    Damaged { file: PathBuf, line: usize, reason: String },
    #[error("{file}: another process is writing this report; wait for it, or give another folder", file = file.display())]
    InUse { file: PathBuf },
}

/// A pose of a survey.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = SurveyPose)]
pub struct PoseRecord {
    pub name: String,
    /// Folder of its frames in the report's folder of frames.
    pub folder: String,
    pub eye: [f64; 3],
    pub target: [f64; 3],
    pub up: [f64; 3],
    /// Vertical field of view in degrees, of a perspective.
    pub fov_deg: Option<f64>,
    /// Height of the view in scene units, of an orthographic projection.
    pub ortho_height: Option<f64>,
}

/// The frames of a camera path that are compared.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = SurveyPath)]
pub struct PathRecord {
    /// Name of the path in the scene, or of its file.
    pub name: String,
    /// Frames per second.
    pub fps: f64,
    /// Number of the first frame.
    pub from: u64,
    /// Number of the last frame.
    pub to: u64,
    /// SHA-256 of the frames' cameras.
    pub cameras: String,
    /// Settings that are compared along the path.
    pub rows: Vec<String>,
}

/// What a survey measures. Two runs with equal identities continue each other.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = SurveyIdentity)]
pub struct Identity {
    pub version: String,
    pub adapter: String,
    pub scene: String,
    /// Entity tag of a frame of the scene: it changes with the scene's content, the adapter and the build.
    pub tag: String,
    pub width: u32,
    pub height: u32,
    pub repeats: u32,
    pub seed: u64,
    /// The reference frame, in words.
    pub reference: String,
    pub poses: Vec<PoseRecord>,
    pub rows: Vec<String>,
    /// The path along which frames are compared as well, if there is one.
    #[serde(default)]
    pub path: Option<PathRecord>,
}

impl Identity {
    /// A number that differs between surveys: their references are kept under it.
    fn key(&self) -> u64 {
        let mut hasher = DefaultHasher::new();
        format!("{self:?}").hash(&mut hasher);
        hasher.finish()
    }
}

/// Errors of a frame against the reference.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = SurveyErrors)]
pub struct Metrics {
    /// Mean squared error of the red, green and blue bytes.
    pub mse: f64,
    /// `None` for the planner, which needs the squared error alone.
    #[serde(flatten)]
    #[schema(value_type = OtherMetrics)]
    pub others: Option<OtherMetrics>,
}

/// Errors of a frame against the reference by further measures.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = SurveyOtherErrors)]
pub struct OtherMetrics {
    pub ssim: f64,
    pub flip: f64,
    pub max_error: u8,
    pub coverage: Coverage,
    /// Relative errors of depth; `None` where the frame's drawing has no depths of its own.
    pub depth: Option<Spread>,
    /// Errors of normals, in degrees; `None` likewise.
    pub normal_deg: Option<Spread>,
}

/// A line of the journal. Poses and rows are given by their names.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Record {
    Run {
        identity: Box<Identity>,
        date: String,
    },
    Image {
        pose: String,
        row: String,
        metrics: Box<Metrics>,
        drawn: Box<Given>,
        notes: Vec<String>,
    },
    /// The frame is drawn as that of another row.
    Same {
        pose: String,
        row: String,
        same_as: String,
        notes: Vec<String>,
    },
    /// The program refuses the frame.
    Refused {
        pose: String,
        row: String,
        why: String,
    },
    Time {
        pose: String,
        row: String,
        repeat: u32,
        gpu_ms: f64,
    },
    /// A frame of the path.
    Frame {
        frame: u64,
        row: String,
        /// The row whose frame this one is, where it is drawn as that of another row.
        same_as: Option<String>,
        /// Mean squared error of the red, green and blue bytes.
        mse: f64,
        /// What changed since the frame before; `None` for the first frame, and after one that was refused.
        change: Option<Change>,
    },
    /// The program refuses a frame of the path.
    FrameRefused {
        frame: u64,
        row: String,
        why: String,
    },
}

/// An open journal.
#[derive(Debug)]
pub struct Journal {
    /// The file and its path; `None` for a journal in memory alone.
    place: Option<(PathBuf, Locked)>,
    /// Date of the first run.
    pub date: String,
    /// A number that follows from the identity.
    pub key: u64,
    pub records: Vec<Record>,
}

impl Journal {
    /// Opens the journal of the folder, or begins one on this date. The folder is created if it is missing.
    ///
    /// # Errors
    /// The folder cannot be written, another process holds the journal, or the journal is damaged or that of another survey.
    pub fn open(folder: &Path, identity: &Identity, date: &str) -> Result<Journal, JournalError> {
        Journal::prepare(folder)?;
        let path = folder.join(JOURNAL);
        let failed = |error| JournalError::Io { file: path.clone(), error };
        let opened =
            OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&path);
        let Some(mut file) = opened.and_then(Locked::attempt).map_err(failed)? else {
            return Err(JournalError::InUse { file: path });
        };
        let mut text = Vec::new();
        file.read_to_end(&mut text).map_err(failed)?;
        let (records, kept) = parse(&path, &text)?;
        let is_own = text.is_empty() || kept > 0 || text.starts_with(FIRST);
        let (date, key) = (date.to_owned(), identity.key());
        let place = Some((path.clone(), file));
        let mut journal = Journal { place, date: date.clone(), key, records: Vec::new() };
        let mut records = records.into_iter();
        match records.next() {
            None if is_own => {
                journal.keep(0)?;
                let identity = Box::new(identity.clone());
                journal.write(&Record::Run { identity, date })?;
            }
            Some(Record::Run { identity: found, date }) => {
                let differences = differences(&found, identity);
                if !differences.is_empty() {
                    let differences = differences.join(", ");
                    return Err(JournalError::Other { file: path, differences });
                }
                journal.keep(kept)?;
                (journal.date, journal.records) = (date, records.collect());
            }
            _ => {
                let reason = "the first line does not say what was measured".to_owned();
                return Err(JournalError::Damaged { file: path, line: 1, reason });
            }
        }
        Ok(journal)
    }

    /// Checks that a report can be written into a folder, which is created if it is missing. Callers ask before they do the work.
    ///
    /// # Errors
    /// The folder cannot be made or written, or has files of other things.
    pub fn prepare(folder: &Path) -> Result<(), JournalError> {
        let failed = |error| JournalError::Io { file: folder.to_owned(), error };
        std::fs::create_dir_all(folder)
            .map_err(|error| JournalError::Folder { folder: folder.to_owned(), error })?;
        let is_empty = std::fs::read_dir(folder).map_err(failed)?.next().is_none();
        if !is_empty && !folder.join(JOURNAL).exists() {
            return Err(JournalError::Foreign { folder: folder.to_owned() });
        }
        // A file without a name tells whether files can be made here.
        tempfile::tempfile_in(folder).map_err(failed)?;
        Ok(())
    }

    /// The journal of this name in a folder of journals, where there is one and can be written; a journal of another survey is replaced. Else one that ends
    /// with the process.
    pub fn resumed(folder: Option<&Path>, name: &str, identity: &Identity, date: &str) -> Journal {
        let Some(folder) = folder.map(|folder| folder.join(name)) else {
            return Journal::in_memory(identity, date);
        };
        let opened = Journal::open(&folder, identity, date).or_else(|error| {
            let is_useless = matches!(
                error,
                JournalError::Other { .. }
                    | JournalError::Damaged { .. }
                    | JournalError::Foreign { .. }
            );
            if !is_useless {
                return Err(error);
            }
            tracing::warn!(%error, "a measurement begins anew");
            std::fs::remove_dir_all(&folder)
                .map_err(|error| JournalError::Io { file: folder.clone(), error })?;
            Journal::open(&folder, identity, date)
        });
        opened.unwrap_or_else(|error| {
            tracing::error!(%error, "a measurement is kept in memory alone");
            Journal::in_memory(identity, date)
        })
    }

    /// A journal that ends with the process.
    pub fn in_memory(identity: &Identity, date: &str) -> Journal {
        Journal { place: None, date: date.to_owned(), key: identity.key(), records: Vec::new() }
    }

    /// Cuts the file off behind so many bytes: a crash may have left a part of a line.
    fn keep(&mut self, bytes: usize) -> Result<(), JournalError> {
        let Some((path, file)) = &mut self.place else { return Ok(()) };
        let failed = |error| JournalError::Io { file: path.clone(), error };
        file.set_len(bytes as u64).map_err(failed)?;
        file.seek(SeekFrom::End(0)).map(drop).map_err(failed)
    }

    fn write(&mut self, record: &Record) -> Result<(), JournalError> {
        let Some((path, file)) = &mut self.place else { return Ok(()) };
        let failed = |error| JournalError::Io { file: path.clone(), error };
        let mut line = serde_json::to_vec(record).map_err(|error| failed(error.into()))?;
        line.push(b'\n');
        file.write_all(&line).map_err(failed)
    }

    /// Adds a finished measurement.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn add(&mut self, record: Record) -> Result<(), JournalError> {
        self.write(&record)?;
        self.records.push(record);
        Ok(())
    }
}

/// The records of a journal, and the length of the text that holds them.
pub(crate) fn parse(path: &Path, text: &[u8]) -> Result<(Vec<Record>, usize), JournalError> {
    let kept = text.iter().rposition(|&byte| byte == b'\n').map_or(0, |at| at + 1);
    let mut records = Vec::new();
    for (number, line) in text[..kept].split_inclusive(|&byte| byte == b'\n').enumerate() {
        let record = serde_json::from_slice(line).map_err(|error| JournalError::Damaged {
            file: path.to_owned(),
            line: number + 1,
            reason: error.to_string(),
        })?;
        records.push(record);
    }
    Ok((records, kept))
}

/// What the journal's survey has that this one has not, in words.
fn differences(found: &Identity, wanted: &Identity) -> Vec<String> {
    let names = |identity: &Identity| {
        identity.poses.iter().map(|pose| pose.name.as_str()).collect::<Vec<_>>().join(", ")
    };
    let pairs = [
        ("version", found.version.clone(), wanted.version.clone()),
        ("adapter", found.adapter.clone(), wanted.adapter.clone()),
        ("scene", found.scene.clone(), wanted.scene.clone()),
        ("size", size(found), size(wanted)),
        ("repeats", found.repeats.to_string(), wanted.repeats.to_string()),
        ("seed", found.seed.to_string(), wanted.seed.to_string()),
        ("poses", names(found), names(wanted)),
        ("reference", found.reference.clone(), wanted.reference.clone()),
        ("number of settings", found.rows.len().to_string(), wanted.rows.len().to_string()),
        ("path", path(found), path(wanted)),
    ];
    let mut differences: Vec<String> = pairs
        .into_iter()
        .filter(|(_, found, wanted)| found != wanted)
        .map(|(name, found, wanted)| format!("{name} {found} (now {wanted})"))
        .collect();
    if differences.is_empty() && found != wanted {
        differences.push("other content of the scene, or another build of the program".to_owned());
    }
    differences
}

fn size(identity: &Identity) -> String {
    format!("{}x{}", identity.width, identity.height)
}

fn path(identity: &Identity) -> String {
    identity.path.as_ref().map_or("none".to_owned(), |path| {
        let PathRecord { name, fps, from, to, cameras, rows } = path;
        let cameras = &cameras[..cameras.len().min(8)];
        let settings = rows.len();
        format!("{name} at {fps} frames per second, frames {from} to {to}, cameras {cameras}…, {settings} settings")
    })
}

/// Writes a whole file: under another name first, then renamed, so that a reader never sees a part of it.
///
/// # Errors
/// The file cannot be written.
pub fn write_whole(file: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut name = file.as_os_str().to_owned();
    name.push(".part");
    std::fs::write(&name, bytes)?;
    std::fs::rename(&name, file)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn identity() -> Identity {
        Identity {
            version: "1".into(),
            adapter: "A".into(),
            scene: "s.json".into(),
            tag: "t".into(),
            width: 64,
            height: 36,
            repeats: 3,
            seed: 1,
            reference: "r".into(),
            poses: Vec::new(),
            rows: vec!["a".into()],
            path: None,
        }
    }

    fn time(repeat: u32) -> Record {
        Record::Time { pose: "p".into(), row: "a".into(), repeat, gpu_ms: 1.5 }
    }

    #[test]
    fn a_second_run_finds_the_measurements_of_the_first() {
        let folder = tempfile::tempdir().unwrap();
        let nested = folder.path().join("a/b");
        let mut journal = Journal::open(&nested, &identity(), "monday").unwrap();
        journal.add(time(0)).unwrap();
        journal.add(time(1)).unwrap();
        assert!(matches!(
            Journal::open(&nested, &identity(), "tuesday"),
            Err(JournalError::InUse { .. })
        ));
        drop(journal);
        let again = Journal::open(&nested, &identity(), "tuesday").unwrap();
        assert_eq!(
            (again.records.as_slice(), again.date.as_str()),
            (&[time(0), time(1)][..], "monday")
        );
    }

    #[test]
    fn a_line_that_a_crash_cut_off_is_removed() {
        let folder = tempfile::tempdir().unwrap();
        Journal::open(folder.path(), &identity(), "monday").unwrap().add(time(0)).unwrap();
        let file = folder.path().join(JOURNAL);
        let mut text = std::fs::read(&file).unwrap();
        text.extend(b"{\"kind\":\"time\",\"pose");
        std::fs::write(&file, &text).unwrap();
        let mut journal = Journal::open(folder.path(), &identity(), "tuesday").unwrap();
        assert_eq!(journal.records, [time(0)]);
        journal.add(time(1)).unwrap();
        drop(journal);
        let journal = Journal::open(folder.path(), &identity(), "tuesday").unwrap();
        assert_eq!(journal.records, [time(0), time(1)]);
        drop(journal);
        text[5] = b'x';
        text.push(b'\n');
        std::fs::write(&file, &text).unwrap();
        let error = Journal::open(folder.path(), &identity(), "wednesday").unwrap_err();
        assert!(error.to_string().contains("line 1"), "{error}");
    }

    #[test]
    fn another_survey_is_refused_with_what_differs() {
        let folder = tempfile::tempdir().unwrap();
        drop(Journal::open(folder.path(), &identity(), "monday").unwrap());
        let open = |change: fn(&mut Identity)| {
            let mut wanted = identity();
            change(&mut wanted);
            Journal::open(folder.path(), &wanted, "tuesday").unwrap_err().to_string()
        };
        let error = open(|wanted| wanted.width = 128);
        assert!(
            error.contains("size 64x36 (now 128x36)") && error.contains("another folder"),
            "{error}"
        );
        let error = open(|wanted| wanted.adapter = "B".into());
        assert!(error.contains("adapter A (now B)"), "{error}");
        let error = open(|wanted| {
            let (name, cameras) = ("fly".into(), "0123456789".into());
            wanted.path =
                Some(PathRecord { name, fps: 30.0, from: 0, to: 9, cameras, rows: Vec::new() });
        });
        assert!(
            error.contains("path none (now fly at 30 frames per second, frames 0 to 9"),
            "{error}"
        );
        let error = open(|wanted| wanted.tag = "u".into());
        assert!(error.contains("content of the scene"), "{error}");
        assert!(Journal::open(folder.path(), &identity(), "tuesday").is_ok());
    }

    #[test]
    fn files_of_others_are_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("index.html");
        std::fs::write(&file, "mine").unwrap();
        let open = || Journal::open(folder.path(), &identity(), "monday").unwrap_err().to_string();
        assert!(open().contains("files of other things"));
        let refused = Journal::prepare(folder.path()).unwrap_err().to_string();
        assert_eq!(refused, open());
        assert!(Journal::prepare(&file).is_err(), "this is a file");
        let empty = tempfile::tempdir().unwrap();
        assert!(Journal::prepare(&empty.path().join("new/one")).is_ok());
        let journal = folder.path().join(JOURNAL);
        for text in ["mine", "mine\n", "{\"kind\":\"time\"}"] {
            std::fs::write(&journal, text).unwrap();
            assert!(open().contains("line 1"), "{text}");
            assert_eq!(std::fs::read_to_string(&journal).unwrap(), text);
        }
        // A run of another size keeps what a crash left, too.
        std::fs::remove_file(&journal).unwrap();
        std::fs::remove_file(&file).unwrap();
        drop(Journal::open(folder.path(), &identity(), "monday").unwrap());
        let mut text = std::fs::read(&journal).unwrap();
        text.extend(b"{\"kind\":");
        std::fs::write(&journal, &text).unwrap();
        let other = Identity { width: 65, ..identity() };
        assert!(Journal::open(folder.path(), &other, "monday").is_err());
        assert_eq!(std::fs::read(&journal).unwrap(), text);
    }

    #[test]
    fn a_journal_in_memory_keeps_its_records() {
        let mut journal = Journal::in_memory(&identity(), "monday");
        journal.add(time(0)).unwrap();
        assert_eq!((journal.records.as_slice(), journal.date.as_str()), (&[time(0)][..], "monday"));
        assert_ne!(journal.key, Journal::in_memory(&Identity { width: 65, ..identity() }, "").key);
    }

    #[test]
    fn a_journal_is_resumed_where_that_is_possible() {
        let folder = tempfile::tempdir().unwrap();
        let place = Some(folder.path());
        Journal::resumed(place, "a", &identity(), "monday").add(time(0)).unwrap();
        let again = Journal::resumed(place, "a", &identity(), "tuesday");
        assert_eq!((again.records.as_slice(), again.date.as_str()), (&[time(0)][..], "monday"));
        // Another process writes it.
        let mut second = Journal::resumed(place, "a", &identity(), "tuesday");
        assert!(second.place.is_none() && second.records.is_empty());
        second.add(time(1)).unwrap();
        drop(again);
        let other = Identity { width: 65, ..identity() };
        let replaced = Journal::resumed(place, "a", &other, "tuesday");
        assert!(replaced.records.is_empty() && replaced.place.is_some());
        drop(replaced);
        std::fs::write(folder.path().join("a").join(JOURNAL), "mine\n").unwrap();
        assert!(Journal::resumed(place, "a", &other, "tuesday").place.is_some());
        std::fs::write(folder.path().join("file"), "").unwrap();
        assert!(Journal::resumed(place, "file", &other, "tuesday").place.is_none());
        assert!(Journal::resumed(None, "a", &other, "tuesday").place.is_none());
    }

    #[test]
    fn a_folder_that_cannot_be_made_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        std::fs::write(&file, "").unwrap();
        let error = Journal::open(&file.join("under"), &identity(), "monday").unwrap_err();
        assert!(error.to_string().contains("under"), "{error}");
    }
}
