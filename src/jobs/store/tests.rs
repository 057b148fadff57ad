use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use redb::{Database, StorageBackend};

use super::database::{JOBS, builder};
use super::*;
use crate::jobs::book::Repeat;
use crate::jobs::spec::tests::spec;

fn record(id: JobId, state: State) -> Record {
    Record {
        id,
        spec: spec("s"),
        owner: Some("ann".to_owned()),
        request_id: Some("r-1".to_owned()),
        repeat: Some(Repeat {
            owner: String::new(),
            key: "k".to_owned(),
            fingerprint: "f".to_owned(),
        }),
        state,
        made: Made { total: Some(9), done: 3, fps: Some(30.0), ..Made::default() },
        created_ms: 5,
        since_ms: 6,
        turn: 7,
        drawn: 8,
    }
}

fn open(folder: &Path) -> Opened {
    Store::open(folder, 100).unwrap()
}

/// Stores a job's record and folder.
fn keep(store: &Store, record: &Record) {
    store.keep(record.id, || Some(record.clone())).unwrap();
    store.place(record.id).prepare(record).unwrap();
}

#[test]
fn what_is_put_is_found() {
    let at = tempfile::tempdir().unwrap();
    let folder = at.path().join("deep/state");
    let opened = open(&folder);
    assert!(opened.records.is_empty() && opened.warnings.is_empty() && opened.last_id == 0);
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        assert_eq!(
            folder.metadata().unwrap().permissions().mode() & 0o77,
            0,
            "nobody else's business"
        );
    }
    let failure = Failure { kind: FailureKind::Video, detail: "no".to_owned() };
    let records = [record(1, State::Running), record(3, State::Failed(failure))];
    for record in &records {
        keep(&opened.store, record);
    }
    keep(&opened.store, &record(7, State::Done));
    opened.store.bury(7).unwrap();
    opened.store.keep(7, || None).unwrap();
    drop(opened);
    let opened = open(&folder);
    assert_eq!((opened.records, opened.last_id), (records.to_vec(), 7));
    assert_eq!(opened.warnings, [] as [String; 0]);
    assert!(!folder.join("jobs/7").exists(), "what a removal left over is removed");
    assert!(folder.join("jobs/1/job.json").exists());
}

#[test]
fn folders_that_no_job_can_have_are_left_alone() {
    let at = tempfile::tempdir().unwrap();
    drop(open(at.path()));
    let folder = at.path().join("jobs").join(u64::MAX.to_string());
    fs::create_dir(&folder).unwrap();
    assert_eq!(open(at.path()).last_id, 0);
    assert!(folder.exists());
}

#[test]
fn leftovers_that_cannot_be_removed_are_warnings() {
    let at = tempfile::tempdir().unwrap();
    let Opened { store, .. } = open(at.path());
    let removed = record(3, State::Done);
    keep(&store, &removed);
    store.bury(3).unwrap();
    fs::create_dir(at.path().join("jobs/5")).unwrap();
    let (mut records, mut last_id, mut warnings) = (vec![removed], 0, Vec::new());
    let remove = |_: &Place| Err(io::Error::other("the disk failed"));
    store.find_again(&mut records, &mut last_id, 100, &mut warnings, remove).unwrap();
    assert!(records.is_empty() && last_id == 5);
    warnings.sort();
    for (warning, folder) in warnings.iter().zip(["jobs/3", "jobs/5"]) {
        assert!(warning.contains(folder) && warning.ends_with("the disk failed"), "{warning}");
    }
    assert_eq!(warnings.len(), 2);
}

#[test]
fn a_folder_is_one_process_at_a_time() {
    let at = tempfile::tempdir().unwrap();
    let first = open(at.path());
    let second = Store::open(at.path(), 0).err().unwrap();
    assert!(matches!(second, StateError::Locked { .. }));
    assert!(second.to_string().contains("another running server"), "{second}");
    drop(first);
    open(at.path());
    let file = at.path().join("file");
    fs::write(&file, "").unwrap();
    let refused = Store::open(&file, 0).err().unwrap().to_string();
    assert!(refused.contains("cannot use"), "{refused}");
}

#[test]
fn damaged_databases_are_set_aside_and_jobs_found_again() {
    let cut = |bytes: &mut Vec<u8>| bytes.truncate(1000);
    let flip =
        |bytes: &mut Vec<u8>| bytes.iter_mut().skip(100).step_by(3).for_each(|byte| *byte ^= 0xff);
    let noise = |bytes: &mut Vec<u8>| *bytes = b"remember the milk".to_vec();
    for damage in [cut as fn(&mut Vec<u8>), flip, noise] {
        let at = tempfile::tempdir().unwrap();
        let opened = open(at.path());
        keep(&opened.store, &record(4, State::Running));
        drop(opened);
        let file = at.path().join(DATABASE);
        let mut bytes = fs::read(&file).unwrap();
        damage(&mut bytes);
        fs::write(&file, &bytes).unwrap();
        let opened = open(at.path());
        assert!(opened.warnings[0].contains("damaged"), "{:?}", opened.warnings);
        assert_eq!(fs::read(at.path().join("jobs.redb.damaged-100")).unwrap(), bytes);
        let found = &opened.records[0];
        assert_eq!((found.id, &found.spec, found.created_ms), (4, &spec("s"), 5));
        assert!(
            matches!(&found.state, State::Failed(failure) if failure.kind == FailureKind::Recovered)
        );
        assert_eq!((opened.last_id, opened.records.len()), (4, 1));
        drop(opened);
        // The job is in the database again.
        let opened = open(at.path());
        assert_eq!((opened.records.len(), opened.warnings), (1, Vec::new()));
    }
}

#[test]
fn rows_and_folders_that_are_not_ours() {
    let at = tempfile::tempdir().unwrap();
    let opened = open(at.path());
    let books = opened.store.books.lock();
    let change = books.ledger.database().begin_write().unwrap();
    change.open_table(JOBS).unwrap().insert(12, &b"{\"of\": \"a later version\"}"[..]).unwrap();
    change.commit().unwrap();
    drop(books);
    fs::create_dir(at.path().join("jobs/notes")).unwrap();
    fs::create_dir(at.path().join("jobs/5")).unwrap();
    fs::write(at.path().join("jobs/5/job.json"), "remember the milk").unwrap();
    drop(opened);
    let opened = open(at.path());
    assert!(opened.records.is_empty());
    assert_eq!((opened.last_id, opened.warnings.len()), (12, 2), "{:?}", opened.warnings);
    assert!(at.path().join("jobs/notes").exists() && at.path().join("jobs/5/job.json").exists());
}

#[test]
fn sizes_and_what_is_dropped() {
    let at = tempfile::tempdir().unwrap();
    let opened = open(at.path());
    let place = opened.store.place(2);
    assert_eq!(place.bytes(), 0);
    place.prepare(&record(2, State::Done)).unwrap();
    fs::create_dir(place.frames()).unwrap();
    let own = place.bytes();
    for (name, length) in [("frame-00000.png", 10), ("frame-00001.png", 20), ("frames.jsonl", 3)] {
        fs::write(place.frames().join(name), vec![0; length]).unwrap();
    }
    fs::write(place.video(), [0; 5]).unwrap();
    assert_eq!(place.bytes(), own + 38);
    place.drop_frames().unwrap();
    assert_eq!(place.bytes(), own + 8);
    assert!(place.manifest().exists());
    place.remove().unwrap();
    place.remove().unwrap();
    assert_eq!(place.bytes(), 0);
}

/// A disk in memory that can be full.
#[derive(Clone, Debug, Default)]
struct Disk {
    bytes: Arc<Mutex<Vec<u8>>>,
    is_full: Arc<AtomicBool>,
    /// Number of times that a database was opened on it.
    opened: Arc<AtomicUsize>,
}

impl Disk {
    fn check(&self) -> io::Result<()> {
        let is_full = self.is_full.load(Ordering::Relaxed);
        if is_full { Err(io::ErrorKind::StorageFull.into()) } else { Ok(()) }
    }

    fn open(&self, folder: &Path) -> Opened {
        let opener = || -> Opener {
            let disk = self.clone();
            Box::new(move || -> Result<Database, redb::DatabaseError> {
                disk.opened.fetch_add(1, Ordering::Relaxed);
                builder().create_with_backend(disk.clone())
            })
        };
        Store::open_with(folder, 100, opener).unwrap()
    }
}

impl StorageBackend for Disk {
    fn len(&self) -> io::Result<u64> {
        Ok(self.bytes.lock().len() as u64)
    }

    fn read(&self, offset: u64, out: &mut [u8]) -> io::Result<()> {
        let bytes = self.bytes.lock();
        let found = bytes.get(offset as usize..offset as usize + out.len());
        out.copy_from_slice(found.ok_or(io::ErrorKind::UnexpectedEof)?);
        Ok(())
    }

    fn set_len(&self, len: u64) -> io::Result<()> {
        self.check()?;
        self.bytes.lock().resize(len as usize, 0);
        Ok(())
    }

    fn sync_data(&self) -> io::Result<()> {
        self.check()
    }

    fn write(&self, offset: u64, data: &[u8]) -> io::Result<()> {
        self.check()?;
        self.bytes.lock()[offset as usize..offset as usize + data.len()].copy_from_slice(data);
        Ok(())
    }
}

#[test]
fn a_full_disk_is_told_and_survived() {
    let at = tempfile::tempdir().unwrap();
    let disk = Disk::default();
    let Opened { store, .. } = disk.open(at.path());
    let (one, two) = (record(1, State::Running), record(2, State::Running));
    keep(&store, &one);
    disk.is_full.store(true, Ordering::Relaxed);
    for _ in 0..3 {
        let refused = store.keep(2, || Some(two.clone())).unwrap_err();
        let StateError::Io { error, .. } = &refused else { panic!("{refused}") };
        assert_eq!(error.kind(), io::ErrorKind::StorageFull);
    }
    assert!(store.keep(1, || None).is_err());
    assert_eq!(store.owed(), [1, 2]);
    // Once there is space again, the next changes are written.
    disk.is_full.store(false, Ordering::Relaxed);
    let done = record(2, State::Done);
    store.keep(2, || Some(done.clone())).unwrap();
    assert_eq!(store.owed(), [1]);
    store.keep(1, || Some(one.clone())).unwrap();
    assert_eq!(store.owed(), [] as [JobId; 0]);
    let opened = disk.opened.load(Ordering::Relaxed);
    store.keep(1, || Some(one.clone())).unwrap();
    assert_eq!(disk.opened.load(Ordering::Relaxed), opened, "opened again only where it failed");
    drop(store);
    let found = disk.open(at.path());
    assert_eq!((found.records, found.last_id), (vec![one, done], 2));
}

/// A full disk is no obstacle to starting, and a job removed then stays removed although the database cannot be changed.
#[test]
fn removed_jobs_do_not_come_back() {
    let at = tempfile::tempdir().unwrap();
    let disk = Disk::default();
    let Opened { store, .. } = disk.open(at.path());
    keep(&store, &record(1, State::Done));
    keep(&store, &record(2, State::Done));
    fs::create_dir(store.place(1).frames()).unwrap();
    fs::write(store.place(1).frames().join("frame-00000.png"), [0; 10]).unwrap();
    disk.is_full.store(true, Ordering::Relaxed);
    store.bury(1).unwrap();
    assert!(store.keep(1, || None).is_err());
    store.place(1).empty().unwrap();
    assert!(store.place(1).is_buried() && !store.place(1).frames().exists());
    // A runner may have written `job.json` again since.
    store.place(1).prepare(&record(1, State::Done)).unwrap();
    drop(store);
    disk.is_full.store(false, Ordering::Relaxed);
    let opened = disk.open(at.path());
    assert_eq!((opened.records.len(), opened.records[0].id, opened.last_id), (1, 2, 2));
    assert!(!at.path().join("jobs/1").exists());
    drop(opened);
    assert_eq!(disk.open(at.path()).records.len(), 1, "the database knows as well");
}
