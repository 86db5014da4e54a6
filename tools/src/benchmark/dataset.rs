//! The recordings in the folder of a dataset.

use anyhow::{Context as _, Result, bail};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Names by which bags end.
const BAGS: [&str; 3] = ["bag", "mcap", "db3"];
/// Recordings are looked for in the folder itself and in folders inside it: some datasets have one more a sequence.
const DEPTH: usize = 2;

/// The recordings in a folder by name: folders in the layout of EuRoC or of 4Seasons, bags and folders of rosbag2. A name is a path relative to the
/// folder, without the ending of a bag.
///
/// # Errors
/// A folder that cannot be listed, or holds no recording.
pub fn recordings(folder: &Path) -> Result<BTreeMap<String, PathBuf>> {
    if is_recording(folder) {
        bail!("{} is one recording: name the folder that holds those of the dataset", folder.display());
    }
    let mut found = BTreeMap::new();
    collect(folder, folder, DEPTH, &mut found)?;
    if found.is_empty() {
        bail!(
            "{} holds no recording: looked for folders with mav0/, metadata.yaml or times.txt (4Seasons), and for .bag and .mcap",
            folder.display()
        );
    }
    Ok(found)
}

fn collect(root: &Path, folder: &Path, depth: usize, found: &mut BTreeMap<String, PathBuf>) -> Result<()> {
    let entries = std::fs::read_dir(folder).with_context(|| folder.display().to_string())?;
    for entry in entries {
        let path = entry.with_context(|| folder.display().to_string())?.path();
        if is_recording(&path) {
            let relative = path.strip_prefix(root).unwrap_or(&path);
            let name = if path.is_dir() { relative.to_owned() } else { relative.with_extension("") };
            found.insert(name.display().to_string(), path);
        } else if depth > 1 && path.is_dir() {
            collect(root, &path, depth - 1, found)?;
        }
    }
    Ok(())
}

fn is_recording(path: &Path) -> bool {
    if path.is_dir() {
        return path.join("mav0").is_dir()
            || path.join("metadata.yaml").is_file()
            || sensors::four_seasons::is_recording(path);
    }
    path.extension().and_then(|ending| ending.to_str()).is_some_and(|ending| BAGS.contains(&ending))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_and_bags_are_found_by_name_and_nothing_else_is() {
        let dataset = tempfile::tempdir().unwrap();
        let at = |path: &str| dataset.path().join(path);
        for folder in ["MH_02/mav0/cam0", "room/room1/mav0", "drive_1", "notes/old/deep/mav0"] {
            std::fs::create_dir_all(at(folder)).unwrap();
        }
        for file in
            ["corridor.bag", "lab.mcap", "readme.txt", "drive_1/metadata.yaml", "drive_1/drive_1_0.db3"]
        {
            std::fs::write(at(file), "").unwrap();
        }
        let found = recordings(dataset.path()).unwrap();
        let names: Vec<&str> = found.keys().map(String::as_str).collect();
        assert_eq!(names, ["MH_02", "corridor", "drive_1", "lab", "room/room1"]);
        assert_eq!(found["corridor"], at("corridor.bag"));
        let one = recordings(&at("MH_02")).unwrap_err().to_string();
        assert!(one.contains("is one recording"), "{one}");
        let none = recordings(&at("MH_02/mav0")).unwrap_err().to_string();
        assert!(none.contains("holds no recording"), "{none}");
    }
}
