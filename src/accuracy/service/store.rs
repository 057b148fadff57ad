//! Results that outlive a process: a JSON file for each scene, in the state folder of the server.
//!
//! A file that cannot be written is logged, and its results end with the process. A file that cannot be read is ignored until it is replaced.

use std::path::PathBuf;
use std::time::SystemTime;

use serde::Deserialize;
use serde_json::{Value, json};

use crate::accuracy::journal::write_whole;
use crate::accuracy::results::Results;

/// Largest file that is read.
const MOST_BYTES: u64 = 16 << 20;

/// Results of a survey.
#[derive(Clone, Debug, PartialEq)]
pub struct Kept {
    /// Id of the scene.
    pub scene: String,
    /// Tag of the scene's content, the adapter and the build.
    pub tag: String,
    /// Revision of the scene.
    pub revision: u64,
    /// End of the survey, in milliseconds since 1970.
    pub since_ms: u64,
    /// [`Results`] as JSON.
    pub results: String,
}

#[derive(Deserialize)]
struct File {
    scene: String,
    tag: String,
    revision: u64,
    since_ms: u64,
    results: Value,
}

impl Kept {
    /// Results that were measured now.
    ///
    /// # Errors
    /// The results cannot be written as JSON.
    pub fn new(
        scene: &str,
        tag: String,
        revision: u64,
        results: &Results,
    ) -> serde_json::Result<Kept> {
        let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        let since_ms = u64::try_from(now.as_millis()).unwrap_or(u64::MAX);
        let (scene, results) = (scene.to_owned(), serde_json::to_string(results)?);
        Ok(Kept { scene, tag, revision, since_ms, results })
    }

    /// The results as a value.
    ///
    /// # Errors
    /// The text is no JSON.
    pub fn value(&self) -> serde_json::Result<Value> {
        serde_json::from_str(&self.results)
    }
}

/// The folder, where there is one.
pub struct Store {
    folder: Option<PathBuf>,
}

impl Store {
    pub fn new(folder: Option<PathBuf>) -> Store {
        Store { folder }
    }

    /// Path of a scene's file. Ids of scenes are lower-case letters, digits, underscores and hyphens.
    fn file(&self, scene: &str) -> Option<PathBuf> {
        Some(self.folder.as_ref()?.join(format!("{scene}.json")))
    }

    /// All results, the oldest first.
    pub fn read(&self) -> Vec<Kept> {
        let entries = self.folder.iter().filter_map(|folder| std::fs::read_dir(folder).ok());
        let files = entries.flatten().filter_map(|entry| Some(entry.ok()?.path()));
        let mut found: Vec<Kept> = files
            .filter(|file| file.extension().is_some_and(|extension| extension == "json"))
            .filter_map(|file| {
                let is_small = file.metadata().ok()?.len() <= MOST_BYTES;
                let text = std::fs::read(&file).ok().filter(|_| is_small)?;
                let read: File = match serde_json::from_slice(&text) {
                    Ok(read) => read,
                    Err(error) => {
                        tracing::warn!(file = %file.display(), %error, "cannot read results of an accuracy measurement");
                        return None;
                    }
                };
                let File { scene, tag, revision, since_ms, results } = read;
                let is_own = self.file(&scene).as_ref() == Some(&file);
                let results = results.to_string();
                is_own.then_some(Kept { scene, tag, revision, since_ms, results })
            })
            .collect();
        found.sort_by_key(|kept| kept.since_ms);
        found
    }

    pub fn write(&self, kept: &Kept) {
        let (Some(folder), Some(file)) = (&self.folder, self.file(&kept.scene)) else { return };
        let Kept { scene, tag, revision, since_ms, .. } = kept;
        let written = kept.value().map_err(std::io::Error::from).and_then(|results| {
            let text = json!({
                "scene": scene, "tag": tag, "revision": revision, "since_ms": since_ms, "results": results,
            });
            std::fs::create_dir_all(folder)?;
            write_whole(&file, text.to_string().as_bytes())
        });
        if let Err(error) = written {
            tracing::error!(file = %file.display(), %error, "cannot keep results of an accuracy measurement");
        }
    }

    pub fn remove(&self, scene: &str) {
        if let Some(file) = self.file(scene) {
            // A file that was never written is gone as well.
            let _ = std::fs::remove_file(file);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accuracy::results::tests::results;

    #[test]
    fn results_are_read_as_they_were_written() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::new(Some(folder.path().join("accuracy")));
        assert_eq!(store.read(), []);
        let kept = |scene: &str, since_ms| Kept {
            since_ms,
            ..Kept::new(scene, "t".to_owned(), 3, &results()).unwrap()
        };
        let (old, new) = (kept("b", 1), kept("a", 2));
        [&new, &old].into_iter().for_each(|kept| store.write(kept));
        let file = folder.path().join("accuracy/broken.json");
        std::fs::write(&file, "{").unwrap();
        // Renamed by hand.
        std::fs::copy(file.with_file_name("a.json"), file.with_file_name("c.json")).unwrap();
        let found = store.read();
        assert_eq!(found.len(), 2);
        assert_eq!((&found[0].scene, &found[1].scene), (&old.scene, &new.scene));
        assert_eq!(found[1].value().unwrap(), new.value().unwrap());
        store.remove("a");
        store.remove("none");
        assert_eq!(store.read().len(), 1);
        // Without a folder nothing is kept.
        Store::new(None).write(&new);
        assert_eq!(Store::new(None).read(), []);
    }
}
