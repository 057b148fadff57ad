use futures::FutureExt;

use super::*;
use crate::jobs::spec::tests::spec;

fn store() -> (tempfile::TempDir, Store) {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("deep")).unwrap();
    let store = Store::create(folder.path().join("deep/store").to_str().unwrap()).unwrap();
    (folder, store)
}

#[tokio::test]
async fn stores_are_told_apart_by_their_marks() {
    let (folder, store) = store();
    let here = folder.path().join("deep/store");
    let open = || Store::open(here.to_str().unwrap()).unwrap();
    assert_eq!(open().find().await.unwrap(), None);
    let mark = store.claim().await.unwrap();
    assert_eq!(open().claim().await.unwrap(), mark);
    assert_eq!(open().find().await.unwrap(), Some(mark));
    store.check().await.unwrap();
    store.try_writing().await.unwrap();
    let trials = std::fs::read_dir(here.join("trials"));
    assert_eq!(trials.map_or(0, Iterator::count), 0);
    // Its file system is no longer mounted, and an empty folder is left.
    let away = folder.path().join("away");
    std::fs::rename(&here, &away).unwrap();
    std::fs::create_dir(&here).unwrap();
    for lost in [store.check().await, store.put_order("f", b"{}".to_vec()).await] {
        let lost = lost.unwrap_err().to_string();
        assert!(lost.contains("`pointillist-store` is missing"), "{lost}");
    }
    assert_ne!(open().claim().await.unwrap(), mark);
    assert!(store.check().await.is_err());
    std::fs::remove_dir_all(&here).unwrap();
    std::fs::rename(&away, &here).unwrap();
    store.put_order("f", b"{}".to_vec()).await.unwrap();
}

#[test]
fn missing_folders_are_no_stores() {
    let (folder, _) = store();
    let refusal = |opened: Result<Store, StoreError>| opened.err().unwrap().to_string();
    let missing = folder.path().join("none");
    let text = missing.to_str().unwrap();
    assert!(refusal(Store::open(text)).contains("a folder: No such file"));
    assert!(refusal(Store::create(&format!("{text}/deep"))).contains("s3://BUCKET/PREFIX"));
    assert!(refusal(Store::create("s3:/bucket")).starts_with("--store s3:/bucket: "));
    assert!(!missing.exists() && !FilePath::new("s3:").exists());
    Store::create(text).unwrap();
    Store::create(text).unwrap();
}

#[tokio::test]
async fn workers_wait_for_a_missing_folder_alone() {
    let (folder, _) = store();
    let path = folder.path().join("later");
    let text = path.to_str().unwrap();
    let mut waiting = std::pin::pin!(Store::wait(text));
    assert!(waiting.as_mut().now_or_never().is_none());
    std::fs::create_dir(&path).unwrap();
    assert_eq!(waiting.await.unwrap().name(), text);
    let file = folder.path().join("file");
    std::fs::write(&file, "").unwrap();
    let refusal = Store::wait(file.to_str().unwrap()).await.err().unwrap().to_string();
    assert!(refusal.contains("a folder: Not a directory"), "{refusal}");
    let refusal = Store::wait("gs://bucket").await.err().unwrap().to_string();
    assert!(refusal.starts_with("--store gs://bucket: expected s3://BUCKET"), "{refusal}");
}

#[test]
fn damaged_frames_count_as_missing() {
    let sealed = seal(b"image");
    assert_eq!(unseal(sealed.clone()).unwrap(), b"image"[..]);
    for length in 0..sealed.len() {
        assert_eq!(unseal(sealed.slice(..length)), None, "{length}");
    }
    let mut other = sealed.to_vec();
    other[2] ^= 1;
    assert_eq!(unseal(other.into()), None);
    assert_eq!(unseal(seal(b"")).unwrap(), b""[..]);
}

#[tokio::test]
async fn films_are_stored_listed_and_removed() {
    let (folder, store) = store();
    store.claim().await.unwrap();
    assert_eq!(store.order("f").await.unwrap(), None);
    let scene = Bundle { main: "a.ply".to_owned(), base: None, up: None, files: Vec::new() };
    let order = FilmOrder { spec: spec("s"), scene };
    let text = serde_json::to_vec(&order).unwrap();
    // Halves, and zeros in place of the content, are what a power cut leaves.
    for damaged in [text[..text.len() / 2].to_vec(), vec![0; text.len()], Vec::new()] {
        store.put_order("f", damaged).await.unwrap();
        assert_eq!(store.order("f").await.unwrap(), None);
    }
    store.put_order("f", text).await.unwrap();
    assert_eq!(store.order("f").await.unwrap(), Some(order));
    store.put_frame("f", "aa", b"one").await.unwrap();
    store.put_frame("other", "bb", b"two").await.unwrap();
    assert!(store.has_frame("f", "aa").await.unwrap());
    assert!(!store.has_frame("f", "bb").await.unwrap());
    assert_eq!(store.frame("f", "aa").await.unwrap().unwrap(), b"one"[..]);
    assert_eq!(store.frame("f", "bb").await.unwrap(), None);
    let begin = async |run: &str, worker: &str| {
        let (before, now) =
            store.change_tries("f", run, |tries| tries.begin(worker)).await.unwrap();
        assert_eq!(now.begun(), before.begun() + 1);
        before.begun()
    };
    for (before, worker) in ["a", "b", "a", "c"].into_iter().enumerate() {
        assert_eq!(begin("0-3", worker).await, before as u64);
    }
    assert_eq!(begin("0-0", "a").await, 0);
    store.change_tries("f", "0-3", |tries| tries.take_back("c")).await.unwrap();
    assert_eq!(begin("0-3", "d").await, 3);
    std::fs::write(folder.path().join("deep/store/films/f/tries/0-3"), "half {").unwrap();
    assert_eq!(begin("0-3", "d").await, 0);
    std::fs::write(folder.path().join("deep/store/films/f/frames/aa"), "on").unwrap();
    assert_eq!(store.frame("f", "aa").await.unwrap(), None);
    assert!(!store.has_frame("f", "aa").await.unwrap());
    store.put_frame("f", "aa", b"one").await.unwrap();
    store.set_aside("f", 7, "it burns").await.unwrap();
    assert_eq!(store.why_aside("f", 7).await.unwrap().unwrap(), "it burns");
    let listing = store.list("f").await.unwrap();
    assert_eq!(listing, Listing { frames: vec!["aa".to_owned()], aside: vec![7] });
    store.remove("f").await.unwrap();
    assert_eq!(store.list("f").await.unwrap(), Listing::default());
    assert_eq!(store.order("f").await.unwrap(), None);
    assert!(store.has_frame("other", "bb").await.unwrap());
    store.remove("f").await.unwrap();
}

#[tokio::test]
async fn leftovers_are_removed_unless_the_film_has_an_order_again() {
    let (_folder, store) = store();
    store.claim().await.unwrap();
    store.put_frame("f", "aa", b"one").await.unwrap();
    store.put_frame("f", "bb", b"two").await.unwrap();
    // The job is resumed after the worker has found no order.
    let left = store.leftovers("f").await.unwrap();
    assert_eq!(left.len(), 2);
    store.put_order("f", b"{}".to_vec()).await.unwrap();
    store.remove_leftovers("f", left).await.unwrap();
    assert_eq!(store.list("f").await.unwrap().frames.len(), 2);
    assert!(store.has(&order_path("f")).await.unwrap());
    assert_eq!(store.leftovers("f").await.unwrap(), []);
    store.objects.delete(&order_path("f")).await.unwrap();
    let left = store.leftovers("f").await.unwrap();
    store.remove_leftovers("f", left).await.unwrap();
    assert_eq!(store.list("f").await.unwrap(), Listing::default());
}

/// Makes a file of the store look older.
fn age(file: &FilePath, by: Duration) {
    let file = std::fs::File::options().write(true).open(file).unwrap();
    file.set_modified(SystemTime::now() - by).unwrap();
}

#[tokio::test]
async fn old_assets_are_removed_unless_a_film_needs_them() {
    let (folder, store) = store();
    store.claim().await.unwrap();
    let [old, needed, young] = ["0", "1", "2"].map(|digit| digit.repeat(64));
    let foreign = "model.ply".to_owned();
    let assets = folder.path().join("deep/store/assets");
    std::fs::create_dir_all(&assets).unwrap();
    for name in [&old, &needed, &young, &foreign] {
        std::fs::write(assets.join(name), "ply").unwrap();
    }
    let now = SystemTime::now();
    assert_eq!(store.clean(now).await.unwrap(), 0);
    for name in [&old, &needed, &foreign] {
        age(&assets.join(name), KEPT + PAUSE);
    }
    let mut order = serde_json::json!({"scene": {
        "main": "a.ply", "base": null, "up": null,
        "files": [{"path": "a.ply", "bytes": 3, "sha256": needed}],
    }});
    store.put_order("f", order.to_string().into_bytes()).await.unwrap();
    store.put_order("broken", b"{}".to_vec()).await.unwrap();
    let error = store.clean(now).await.unwrap_err().to_string();
    assert!(error.contains("films/broken/order.json"), "{error}");
    // If a server drew this film, it would have stored the order again.
    age(&folder.path().join("deep/store/films/broken/order.json"), 2 * FRESH);
    assert_eq!(store.clean(now).await.unwrap(), 1);
    let has = |name: &String| assets.join(name).exists();
    assert_eq!([&old, &needed, &young, &foreign].map(has), [false, true, true, true]);
    order["scene"]["files"] = serde_json::json!([]);
    store.put_order("f", order.to_string().into_bytes()).await.unwrap();
    assert_eq!(store.clean(now).await.unwrap(), 1);
    assert_eq!([&needed, &young, &foreign].map(has), [false, true, true]);
}

#[tokio::test]
async fn films_are_removed_that_no_server_stores_again() {
    let (folder, store) = store();
    store.claim().await.unwrap();
    let [dead, living, foreign] = ["a".repeat(32), "b".repeat(32), "foreign".to_owned()];
    for film in [&dead, &living, &foreign] {
        store.put_order(film, b"half {".to_vec()).await.unwrap();
        store.put_frame(film, "aa", b"one").await.unwrap();
    }
    let (now, mut suspects) = (SystemTime::now(), Suspects::new());
    for _ in 0..2 {
        assert_eq!(store.clean_films(now, &mut suspects).await.unwrap(), 0);
    }
    // The clock jumps, and all films look old. A server stores the order of its film again.
    let late = now + ABANDONED + PAUSE;
    assert_eq!(store.clean_films(late, &mut suspects).await.unwrap(), 0);
    let order = folder.path().join("deep/store/films").join(&living).join("order.json");
    std::fs::File::options().write(true).open(order).unwrap().set_modified(now + PAUSE).unwrap();
    assert_eq!(store.clean_films(late, &mut suspects).await.unwrap(), 1);
    assert!(!store.has(&order_path(&dead)).await.unwrap());
    assert_eq!(store.list(&dead).await.unwrap(), Listing::default());
    for film in [&living, &foreign] {
        assert!(store.has_frame(film, "aa").await.unwrap(), "{film}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_film_that_cannot_be_removed_keeps_no_other() {
    let (folder, store) = store();
    store.claim().await.unwrap();
    // Films are removed in the order of their names.
    let [stuck, dead] = ["a".repeat(32), "b".repeat(32)];
    // A folder in place of the order cannot be removed.
    let order = folder.path().join("deep/store/films").join(&stuck).join("order.json");
    std::fs::create_dir_all(&order).unwrap();
    std::fs::write(order.join("part"), "").unwrap();
    store.put_frame(&dead, "aa", b"one").await.unwrap();
    let (late, mut suspects) = (SystemTime::now() + 2 * ABANDONED, Suspects::new());
    assert_eq!(store.clean_films(late, &mut suspects).await.unwrap(), 0);
    let error = store.clean_films(late, &mut suspects).await.unwrap_err().to_string();
    assert!(error.contains(&stuck), "{error}");
    assert_eq!(store.list(&dead).await.unwrap(), Listing::default());
}

/// A power cut cannot be tested; the option that syncs files and folders can.
#[test]
fn folders_sync_what_they_acknowledge() {
    let (_folder, store) = store();
    let objects = format!("{:?}", store.objects);
    assert!(objects.contains("fsync: true"), "{objects}");
}

#[tokio::test]
async fn assets_are_stored_once_and_checked() {
    let (folder, store) = store();
    let file = folder.path().join("big.ply");
    let content: Vec<u8> = (0..PART + 12_345).map(|i| (i * 31 % 251) as u8).collect();
    std::fs::write(&file, &content).unwrap();
    let sha256 = crate::film::manifest::checksum(&content);
    store.put_asset(&sha256, &file).await.unwrap();
    // The second time, nothing is read.
    store.put_asset(&sha256, FilePath::new("/no/such/file")).await.unwrap();
    age(&folder.path().join("deep/store/assets").join(&sha256), FRESH);
    store.put_asset(&sha256, &file).await.unwrap();
    store.put_asset(&sha256, FilePath::new("/no/such/file")).await.unwrap();
    let copy = folder.path().join("copy.ply");
    assert_eq!(store.asset(&sha256, &copy).await.unwrap(), sha256);
    assert_eq!(std::fs::read(&copy).unwrap(), content);
    // A file that is not what its hash says is not stored.
    let other = "3".repeat(64);
    let changed = store.put_asset(&other, &file).await.unwrap_err().to_string();
    assert!(changed.contains("changed while it was stored"), "{changed}");
    assert!(!folder.path().join("deep/store/assets").join(other).exists());
    let missing = store.asset("00", &copy).await.unwrap_err().to_string();
    assert!(missing.starts_with("--store ") && missing.contains("assets/00"), "{missing}");
}
