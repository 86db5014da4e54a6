//! The recordings in the folder of a dataset.

use anyhow::{Context as _, Result, bail};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Names by which bags end.
const BAGS: [&str; 3] = ["bag", "mcap", "db3"];
/// Recordings are looked for in the folder itself and in folders inside it: some datasets have one more a sequence.
const DEPTH: usize = 2;

/// The recordings in a folder by name: folders in the layout of EuRoC or of 4Seasons, bags and folders of rosbag2. A name is a path relative to the
/// folder, without the ending of a bag unless another recording has that name.
///
/// # Errors
/// A folder that cannot be listed, or holds no recording.
pub fn recordings(folder: &Path) -> Result<BTreeMap<String, PathBuf>> {
    if is_recording(folder) {
        bail!("{} is one recording: name the folder that holds those of the dataset", folder.display());
    }
    let mut found = Vec::new();
    collect(folder, DEPTH, &mut found)?;
    if found.is_empty() {
        bail!(
            "{} holds no recording: looked for folders with mav0/, metadata.yaml or times.txt (4Seasons), and for .bag and .mcap",
            folder.display()
        );
    }
    Ok(named(folder, found))
}

/// Recordings by name.
fn named(root: &Path, paths: Vec<PathBuf>) -> BTreeMap<String, PathBuf> {
    /// A recording's path in the dataset, with and without the ending of a bag.
    struct Name {
        whole: String,
        short: String,
    }
    let name = |path: &PathBuf| {
        let whole = path.strip_prefix(root).unwrap_or(path);
        let short = if path.is_dir() { whole.to_owned() } else { whole.with_extension("") };
        Name { whole: whole.display().to_string(), short: short.display().to_string() }
    };
    let names: Vec<Name> = paths.iter().map(name).collect();
    let is_taken = |of: &Name| {
        let is_other = |other: &&Name| other.whole != of.whole;
        names.iter().filter(is_other).any(|other| other.short == of.short || other.whole == of.short)
    };
    let chosen = |of: &Name| if is_taken(of) { of.whole.clone() } else { of.short.clone() };
    names.iter().map(chosen).zip(paths).collect()
}

fn collect(folder: &Path, depth: usize, found: &mut Vec<PathBuf>) -> Result<()> {
    let entries = std::fs::read_dir(folder).with_context(|| folder.display().to_string())?;
    for entry in entries {
        let path = entry.with_context(|| folder.display().to_string())?.path();
        if is_recording(&path) {
            found.push(path);
        } else if depth > 1 && path.is_dir() {
            collect(&path, depth - 1, found)?;
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

    #[test]
    fn recordings_of_one_stem_have_two_names_in_whatever_order_they_are_listed() {
        let dataset = tempfile::tempdir().unwrap();
        let at = |path: &str| dataset.path().join(path);
        std::fs::create_dir_all(at("MH_03/mav0")).unwrap();
        let files = ["MH_03.mcap", "lab.bag", "lab.mcap", "lab.bag.db3", "yard.bag"];
        for file in files {
            std::fs::write(at(file), "").unwrap();
        }
        let found = recordings(dataset.path()).unwrap();
        let names: Vec<&str> = found.keys().map(String::as_str).collect();
        assert_eq!(names, ["MH_03", "MH_03.mcap", "lab.bag", "lab.bag.db3", "lab.mcap", "yard"]);
        assert!(found.iter().all(|(name, path)| *path == at(name) || name == "yard"), "{found:?}");
        let mut paths: Vec<PathBuf> = found.values().cloned().collect();
        paths.reverse();
        assert_eq!(named(dataset.path(), paths), found);
    }
}
