//! Records that were stored, messages of workers and daemons, and settings files.

use std::path::{Component, Path};

use serde::Serialize;
use serde::de::DeserializeOwned;

use super::{Run, text};
use crate::accuracy::journal;
use crate::cli::serve::parse_file;
use crate::farm::{bundle, messages, tries};
use crate::film::manifest;
use crate::jobs::book::{Book, Limits, Record, Slots};
use crate::load::wire::FrameAnswer;

pub const TARGETS: &[(&str, Run)] = &[
    ("job-record", read_job_record),
    ("farm", read_farm_message),
    ("manifest", read_manifest),
    ("journal", read_journal),
    ("settings-file", read_settings_file),
    ("frame-answer", read_frame_answer),
];

/// What is read is written, and read again as the same.
fn stored<T: DeserializeOwned + Serialize>(data: &[u8]) -> Option<T> {
    let read: T = serde_json::from_slice(data).ok()?;
    let written = serde_json::to_vec(&read).unwrap();
    let again: T = serde_json::from_slice(&written).unwrap();
    let written_again = serde_json::to_vec(&again).unwrap();
    let shown = String::from_utf8_lossy;
    assert_eq!(shown(&written_again), shown(&written));
    Some(read)
}

/// Puts a stored record in a book, and does to the job what clients may do.
fn read_job_record(data: &[u8]) {
    let Some(record) = stored::<Record>(data) else { return };
    let slots = Slots { baking: 1, drawing: 1, coding: 1 };
    let limits = Limits { most_unfinished: 4, most: 8, ttl_ms: 1000, slots };
    let (id, since) = (record.id, record.since_ms);
    let mut book = Book::new(limits, [record], id);
    book.next(since, |_| crate::jobs::book::Need::Nothing);
    let _ = book.cancel(id, since);
    let _ = book.resume(id, since);
    book.shift(-1000);
    book.shift(i64::MAX);
    book.expire(since);
    if let Ok(record) = book.get(id) {
        record.spec.request();
    }
}

/// Reads bytes as each of the messages.
fn read_farm_message(data: &[u8]) {
    stored::<messages::Note>(data);
    stored::<messages::Beat>(data);
    if let Some(tries) = stored::<tries::Tries>(data) {
        assert!(tries.deaths() <= tries.begun());
    }
    if let Some(run) = stored::<messages::Run>(data) {
        assert_eq!(run.split().count(), run.frames.len());
        run.message_id();
    }
    let scene = stored::<messages::FilmOrder>(data).map(|order| order.scene);
    let Some(scene) = scene.or_else(|| stored::<messages::Bundle>(data)) else { return };
    let folder = Path::new("/folder");
    let names = scene.files.iter().map(|file| &file.path);
    for name in names.chain([&scene.main]).chain(&scene.base) {
        if let Ok(path) = bundle::below(folder, name) {
            let inner = path.strip_prefix(folder).unwrap();
            assert!(inner.components().all(|part| matches!(part, Component::Normal(_))), "{name}");
        }
    }
}

fn read_manifest(data: &[u8]) {
    let Ok(records) = manifest::parse(data) else { return };
    for record in records.values() {
        let line = manifest::line(record).unwrap();
        assert_eq!(line.iter().filter(|&&byte| byte == b'\n').count(), 1);
        let mut components = Path::new(&record.file).components();
        assert!(matches!(components.next(), Some(Component::Normal(_))));
        assert!(components.next().is_none(), "{}", record.file);
    }
}

fn read_journal(data: &[u8]) {
    if let Ok((records, length)) = journal::parse(Path::new("journal"), data) {
        assert!(length <= data.len());
        for record in &records {
            stored::<journal::Record>(&serde_json::to_vec(record).unwrap()).unwrap();
        }
    }
}

fn read_settings_file(data: &[u8]) {
    let Some(text) = text(data) else { return };
    if let Err(error) = parse_file(text) {
        // It quotes the line.
        assert!(error.to_string().len() < 4096 + 2 * text.len());
    }
}

fn read_frame_answer(data: &[u8]) {
    FrameAnswer::read(data);
}
