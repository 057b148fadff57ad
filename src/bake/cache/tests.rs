mod bytes;

use glam::{DVec3, Vec2, Vec3};

use self::bytes::{body, sealed, set_word};
use super::*;
use crate::assets::{Clip, ClipLine, Mesh, PointCloud};
use crate::bake::kernels::circle;
use crate::bake::pack::{pack_mesh, pack_samples};
use crate::bake::tree::build_tree;
use crate::scene::random::SplitMix64;

const KEY: [u8; 32] = [0xa5; 32];

/// Disks on a wavy square; every third has a clip line.
fn cloud(count: usize) -> PointCloud {
    let mut random = SplitMix64::new(count as u64);
    let mut next = || (random.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
    let positions: Vec<DVec3> = (0..count)
        .map(|_| {
            let (x, y) = (next(), next());
            DVec3::new(x, y, 0.1 * (7.0 * x).sin())
        })
        .collect();
    let line = |i: usize| ClipLine { normal: Vec2::X, offset: -0.1 * i as f32 / count as f32 };
    let clip =
        |i: usize| Clip { lines: [i.is_multiple_of(3).then(|| line(i)), None], either: false };
    PointCloud {
        positions,
        colors: Some((0..count).map(|i| [i as u8, 20, 200, 255]).collect()),
        normals: Some(vec![Vec3::Z; count]),
        oriented: true,
        kernels: Some(vec![circle(Vec3::Z, 0.02); count]),
        clips: Some((0..count).map(clip).collect()),
        ..PointCloud::default()
    }
}

/// A square of `side` × `side` quads.
fn mesh(side: u32) -> Mesh {
    let at = |x: u32, y: u32| y * (side + 1) + x;
    let corner = |i| DVec3::new(f64::from(i % (side + 1)), f64::from(i / (side + 1)), 0.5);
    let quads = (0..side * side).map(|i| (i % side, i / side));
    let halves = |(x, y)| {
        let [a, b, c, d] = [at(x, y), at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)];
        [[a, b, c], [a, c, d]]
    };
    Mesh {
        positions: (0..at(0, side + 1)).map(corner).collect(),
        triangles: quads.flat_map(halves).collect(),
        ..Mesh::default()
    }
}

/// A tree with clip lines, samples without nodes, and a mesh.
fn geometries(count: usize, side: u32) -> Vec<PackedGeometry> {
    vec![
        PackedGeometry::Samples(build_tree(&cloud(count), None).unwrap()),
        PackedGeometry::Samples(pack_samples(&cloud(count)).unwrap()),
        PackedGeometry::Triangles(pack_mesh(&mesh(side), &[]).unwrap()),
    ]
}

fn small() -> Vec<PackedGeometry> {
    geometries(5, 1)
}

fn bytes_of(geometries: &[PackedGeometry]) -> Vec<u8> {
    let mut bytes = Vec::new();
    Entry::of(geometries).unwrap().write(&mut bytes, &KEY).unwrap();
    bytes
}

fn assert_same(a: &[PackedGeometry], b: &[PackedGeometry]) {
    // Prints every field, and floats so that they are told apart.
    assert_eq!(format!("{a:?}"), format!("{b:?}"));
}

fn names(folder: &Path) -> Vec<String> {
    let name = |item: io::Result<fs::DirEntry>| item.unwrap().file_name().into_string().unwrap();
    let mut names: Vec<String> = fs::read_dir(folder).unwrap().map(name).collect();
    names.sort();
    names
}

fn set_age(path: &Path, hours: u64) {
    let used = SystemTime::now() - Duration::from_secs(3600 * hours);
    File::options().write(true).open(path).unwrap().set_modified(used).unwrap();
}

#[test]
fn what_is_stored_is_loaded() {
    let folder = tempfile::tempdir().unwrap();
    // Not there yet.
    let cache = BakeCache::new(folder.path().join("a").join("b"), u64::MAX);
    let all = geometries(4000, 40);
    let PackedGeometry::Samples(tree) = &all[0] else { panic!("samples") };
    assert!(!tree.clips.is_empty() && !tree.nodes.is_empty() && tree.chunks.len() > 4);
    assert!(all[2].chunks().len() > 2);
    for stored in [&all[..], &all[2..], &[]] {
        cache.store(&KEY, stored).unwrap();
        assert_same(&cache.load(&KEY).unwrap(), stored);
        let bytes = fs::metadata(cache.path(&KEY)).unwrap().len();
        assert_eq!(bytes, Entry::of(stored).unwrap().bytes());
    }
    assert_eq!(names(&cache.folder), [format!("{}.bake", "a5".repeat(32))]);
}

#[test]
fn files_that_are_not_the_keys_own_are_removed() {
    let folder = tempfile::tempdir().unwrap();
    let cache = BakeCache::new(folder.path(), u64::MAX);
    let whole = bytes_of(&small());
    let mut other_version = body(&small());
    set_word(&mut other_version, 2, FORMAT_VERSION + 1);
    let mut flipped = whole.clone();
    flipped[300] ^= 4;
    let cases = [
        sealed(other_version),
        flipped,
        whole[..whole.len() - 1].to_vec(),
        [&whole[..], b"more"].concat(),
        b"ply\nformat ascii 1.0\n".repeat(20),
        Vec::new(),
    ];
    for bytes in cases {
        fs::write(cache.path(&KEY), bytes).unwrap();
        assert!(cache.load(&KEY).is_none());
        assert!(names(folder.path()).is_empty());
    }
    let other = [1; 32];
    fs::write(cache.path(&other), &whole).unwrap();
    assert!(cache.load(&other).is_none() && names(folder.path()).is_empty());
    fs::write(cache.path(&KEY), whole).unwrap();
    assert!(cache.load(&KEY).is_some());
}

#[test]
fn writers_at_once_leave_whole_entries() {
    let folder = tempfile::tempdir().unwrap();
    let cache = BakeCache::new(folder.path(), u64::MAX);
    let versions: Vec<Vec<PackedGeometry>> = (1..5).map(|i| geometries(300 * i, 3)).collect();
    std::thread::scope(|threads| {
        for (index, version) in versions.iter().enumerate() {
            let cache = &cache;
            threads.spawn(move || {
                for round in 0..10 {
                    cache.store(&KEY, version).unwrap();
                    cache.store(&[index as u8; 32], version).unwrap();
                    let found = cache.load(&KEY).expect("never in parts");
                    assert_eq!(found.len(), 3, "round {round}");
                }
            });
        }
    });
    let last = format!("{:?}", cache.load(&KEY).unwrap());
    assert!(versions.iter().any(|version| format!("{version:?}") == last));
    for (index, version) in versions.iter().enumerate() {
        assert_same(&cache.load(&[index as u8; 32]).unwrap(), version);
    }
    assert_eq!(names(folder.path()).len(), 5);
}

#[test]
fn what_was_used_the_longest_ago_goes_first() {
    let folder = tempfile::tempdir().unwrap();
    let all = small();
    let bytes = Entry::of(&all).unwrap().bytes();
    let cache = BakeCache::new(folder.path(), 3 * bytes + bytes / 2);
    let has = |key: u8| cache.path(&[key; 32]).exists();
    for key in 0..3 {
        cache.store(&[key; 32], &all).unwrap();
        set_age(&cache.path(&[key; 32]), 10 - u64::from(key));
    }
    fs::write(folder.path().join("notes.txt"), vec![0; 10_000]).unwrap();
    // Loading is using.
    assert!(cache.load(&[0; 32]).is_some());
    cache.store(&[3; 32], &all).unwrap();
    assert_eq!([has(0), has(1), has(2), has(3)], [true, false, true, true]);
    // The entry just written stays, whatever the clocks say.
    for key in [0, 2, 3] {
        let ahead = SystemTime::now() + Duration::from_secs(3600);
        let file = File::options().write(true).open(cache.path(&[key; 32])).unwrap();
        file.set_modified(ahead).unwrap();
    }
    let larger = geometries(5, 4);
    let room = Entry::of(&larger).unwrap().bytes();
    assert!(bytes < room && room < 2 * bytes, "{bytes} {room}");
    cache.store(&[4; 32], &larger).unwrap();
    assert_eq!([has(0), has(2), has(3), has(4)].iter().filter(|&&is| is).count(), 2);
    assert!(has(4) && folder.path().join("notes.txt").exists());
}

#[test]
fn entries_too_large_to_be_kept_cost_no_others() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = Entry::of(&small()).unwrap().bytes();
    let cache = BakeCache::new(folder.path(), bytes);
    cache.store(&KEY, &small()).unwrap();
    cache.store(&[1; 32], &geometries(100, 4)).unwrap();
    assert!(cache.load(&KEY).is_some() && cache.load(&[1; 32]).is_none());
    assert_eq!(names(folder.path()).len(), 1);
}

#[test]
fn what_crashed_writers_left_goes_after_a_day() {
    let folder = tempfile::tempdir().unwrap();
    let cache = BakeCache::new(folder.path(), u64::MAX);
    for (name, hours) in [("writing-old.tmp", 25), ("writing-new.tmp", 1), ("old.tmp", 99)] {
        fs::write(folder.path().join(name), "part").unwrap();
        set_age(&folder.path().join(name), hours);
    }
    cache.store(&KEY, &small()).unwrap();
    let entry = format!("{}.bake", "a5".repeat(32));
    assert_eq!(names(folder.path()), [entry.as_str(), "old.tmp", "writing-new.tmp"]);
}

#[test]
fn folders_that_cannot_be_used_are_errors_and_no_panics() {
    let folder = tempfile::tempdir().unwrap();
    assert!(BakeCache::new(folder.path().join("none"), 1 << 20).load(&KEY).is_none());
    assert!(names(folder.path()).is_empty());
    // Below a file nothing can be made, whoever asks.
    let file = folder.path().join("file");
    fs::write(&file, "").unwrap();
    for below in [file.clone(), file.join("below")] {
        let cache = BakeCache::new(&below, 1 << 20);
        assert!(cache.load(&KEY).is_none());
        assert!(cache.store(&KEY, &small()).is_err());
    }
    assert!(file.exists());
    // A folder in an entry's place.
    let cache = BakeCache::new(folder.path(), 1 << 20);
    fs::create_dir(cache.path(&KEY)).unwrap();
    assert!(cache.load(&KEY).is_none());
    assert!(cache.store(&KEY, &small()).is_err());
    assert_eq!(names(folder.path()).len(), 2);
}

#[test]
fn the_users_folder_is_absolute_or_none() {
    let folder = |xdg: Option<&str>, home: Option<&str>| {
        user_folder(xdg.map(OsString::from), home.map(OsString::from))
    };
    let path = |text: &str| Some(PathBuf::from(text));
    assert_eq!(folder(Some("/x"), Some("/h")), path("/x/pointillist"));
    for unset in [None, Some(""), Some("relative")] {
        assert_eq!(folder(unset, Some("/h")), path("/h/.cache/pointillist"));
        assert_eq!(folder(unset, unset), None);
    }
}
