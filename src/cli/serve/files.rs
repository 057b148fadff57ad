//! The files that the server loads at the start, and the root folder.

use std::path::{Path, PathBuf};

use anyhow::{Context, ensure};

use super::ServeArgs;
use crate::http::server::StartScenes;

/// The folder that scenes are read from: the given one, else the common folder of the files on the command line, else `scenes`.
pub(super) fn root(args: &ServeArgs) -> anyhow::Result<PathBuf> {
    let common = match &args.root {
        Some(_) => None,
        None => common_folder(&named_files(args)?),
    };
    let root = common.as_deref().or(args.root.as_deref()).unwrap_or(Path::new("scenes"));
    let canonical = root.canonicalize().with_context(|| {
        format!("cannot open the scene root {}; give another folder with --root", root.display())
    })?;
    ensure!(canonical.is_dir(), "the scene root {} is not a folder", root.display());
    ensure!(
        common.is_none() || canonical.parent().is_some(),
        "the files have no common folder except the root of the file system; give a folder with --root"
    );
    Ok(canonical)
}

/// The files on the command line as absolute paths.
fn named_files(args: &ServeArgs) -> anyhow::Result<Vec<PathBuf>> {
    let absolute = |file: &PathBuf| {
        let path =
            file.canonicalize().with_context(|| format!("{} cannot be opened", file.display()))?;
        ensure!(path.is_file(), "{} is not a file; give folders with --root", file.display());
        Ok(path)
    };
    args.files.iter().map(absolute).collect()
}

/// The deepest folder that contains all files.
fn common_folder(files: &[PathBuf]) -> Option<PathBuf> {
    let (first, rest) = files.split_first()?;
    let holds_all = |folder: &&Path| rest.iter().all(|file| file.starts_with(folder));
    first.ancestors().skip(1).find(holds_all).map(Path::to_path_buf)
}

/// The requested scenes; without any, every scene file directly in the root, or if there is none, every asset file.
pub(super) fn start_scenes(args: &ServeArgs, root: &Path) -> anyhow::Result<StartScenes> {
    let named = named_files(args)?;
    if args.scene.is_empty() && named.is_empty() {
        let entries = std::fs::read_dir(root).context("cannot list the scene root")?;
        let mut files: Vec<PathBuf> = entries
            .filter_map(Result::ok)
            .map(|entry| entry.path())
            .filter(|path| path.is_file())
            .filter(|path| !path.file_name().is_some_and(|n| n.to_string_lossy().starts_with('.')))
            .collect();
        files.sort();
        let is_scene = |path: &PathBuf| path.extension().is_some_and(|e| e == "json");
        if files.iter().any(is_scene) {
            files.retain(is_scene);
        } else {
            files.retain(|path| crate::assets::is_supported_extension(&path.to_string_lossy()));
        }
        return Ok(StartScenes { scenes: with_ids(files), required: false });
    }
    let mut files = Vec::new();
    for path in named {
        ensure!(
            path.starts_with(root),
            "{} lies outside the scene root {}",
            path.display(),
            root.display()
        );
        files.push(path);
    }
    for scene in &args.scene {
        // Relative to the root, or else to the working directory.
        let in_root = root.join(scene);
        let path = if in_root.exists() { in_root } else { scene.clone() };
        let path = path.canonicalize().with_context(|| {
            format!("--scene {}: no such file in {}", scene.display(), root.display())
        })?;
        ensure!(
            path.starts_with(root),
            "--scene {}: lies outside the scene root {}",
            scene.display(),
            root.display()
        );
        files.push(path);
    }
    Ok(StartScenes { scenes: with_ids(files), required: true })
}

fn with_ids(files: Vec<PathBuf>) -> Vec<(String, PathBuf)> {
    files
        .into_iter()
        .map(|file| {
            let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
            (crate::http::slug(&name), file)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::tests::flags;
    use super::*;

    #[test]
    fn scenes_at_the_start() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path().canonicalize().unwrap();
        for name in ["b.json", "A One.json", ".hidden.json", "c.ply"] {
            std::fs::write(root.join(name), "{}").unwrap();
        }
        let found = start_scenes(&ServeArgs::default(), &root).unwrap();
        let ids: Vec<&str> = found.scenes.iter().map(|(id, _)| id.as_str()).collect();
        assert_eq!((ids, found.required), (vec!["a-one", "b"], false));
        for name in ["b.json", "A One.json"] {
            std::fs::remove_file(root.join(name)).unwrap();
        }
        std::fs::write(root.join("notes.md"), "").unwrap();
        let found = start_scenes(&ServeArgs::default(), &root).unwrap();
        let ids: Vec<&str> = found.scenes.iter().map(|(id, _)| id.as_str()).collect();
        assert_eq!((ids, found.required), (vec!["c"], false));
        let found = start_scenes(&flags(&["--scene", "c.ply"]), &root).unwrap();
        assert_eq!((found.scenes[0].0.as_str(), found.required), ("c", true));
        assert!(start_scenes(&flags(&["--scene", "none.ply"]), &root).is_err());
        assert!(start_scenes(&flags(&["--scene", "/dev/null"]), &root).is_err());
    }

    #[test]
    fn files_on_the_command_line_give_the_root() {
        let folder = tempfile::tempdir().unwrap();
        let top = folder.path().canonicalize().unwrap();
        std::fs::create_dir_all(top.join("a/b")).unwrap();
        let files = ["a/x.ply", "a/y.json", "a/b/z.las"].map(|name| top.join(name));
        files.iter().for_each(|file| std::fs::write(file, "").unwrap());
        let [x, y, z] = files.each_ref().map(|file| file.to_str().unwrap());
        let a = top.join("a");
        assert_eq!(root(&flags(&[x])).unwrap(), a);
        assert_eq!(root(&flags(&[x, z])).unwrap(), a);
        assert_eq!(root(&flags(&[z])).unwrap(), a.join("b"));
        let args = flags(&[y, z]);
        let start = start_scenes(&args, &root(&args).unwrap()).unwrap();
        let ids: Vec<&str> = start.scenes.iter().map(|(id, _)| id.as_str()).collect();
        assert_eq!((ids, start.required), (vec!["y", "z"], true));
        let args = flags(&[x, "--root", a.join("b").to_str().unwrap()]);
        let refused = start_scenes(&args, &root(&args).unwrap()).unwrap_err().to_string();
        assert!(refused.contains("outside the scene root"), "{refused}");
        let refused = root(&flags(&["/no/such.ply"])).unwrap_err().to_string();
        assert!(refused.contains("/no/such.ply cannot be opened"), "{refused}");
        let refused = root(&flags(&[a.to_str().unwrap()])).unwrap_err().to_string();
        assert!(refused.contains("--root"), "{refused}");
    }
}
