//! The folder of a rosbag2: `metadata.yaml` and the files that it names, or the files alone.

use crate::BagError;
use crate::packed_file;
use crate::rosbag2_metadata::{Information, MetadataYaml};
use crate::storage::Metadata;
use std::path::{Path, PathBuf};

const METADATA: &str = "metadata.yaml";
/// How the names of a recording's files end.
const EXTENSIONS: [&str; 2] = ["db3", "mcap"];
/// A folder with it is one in the EuRoC layout, whatever else is in it.
const EUROC: &str = "mav0";

/// The files of a recording, in order of time.
#[derive(Debug)]
pub(crate) struct Files {
    pub(crate) paths: Vec<PathBuf>,
    /// Texts about the recording.
    pub(crate) metadata: Vec<Metadata>,
    /// Notes about the folder for the user.
    pub(crate) notes: Vec<String>,
}

/// Whether a folder is a rosbag2.
pub(crate) fn is_rosbag2(folder: &Path) -> bool {
    folder.join(METADATA).is_file() || (!folder.join(EUROC).exists() && !files_in(folder).is_empty())
}

/// The files of a folder: by its `metadata.yaml`, or without it in order of their names.
pub(crate) fn read(folder: &Path) -> Result<Files, BagError> {
    let path = folder.join(METADATA);
    if !path.is_file() {
        return without_metadata(folder);
    }
    let text = files::read_to_string(&path).map_err(|source| BagError::io(&path, source))?;
    let yaml: MetadataYaml = serde_saphyr::from_str(&text)
        .map_err(|error| BagError::invalid(&path, format!("it is not the metadata of a rosbag2: {error}")))?;
    let metadata = yaml.information.metadata();
    let Information { relative_file_paths, compression_format, compression_mode, .. } = yaml.information;
    if !compression_mode.is_empty()
        && !compression_mode.eq_ignore_ascii_case("none")
        && !["", "zstd"].contains(&compression_format.as_str())
    {
        let problem = format!("compression \"{compression_format}\" is unknown: zstd is the only one");
        return Err(BagError::invalid(&path, problem));
    }
    // Early versions of rosbag2 wrote the folder's name in front. A file may have been unpacked by hand, or be packed yet.
    let beside = |file: &PathBuf| {
        let plain = folder.join(file.file_name().unwrap_or(file.as_os_str()));
        let candidates =
            [plain.clone(), packed_file::packed_name(&plain), packed_file::unpacked_name(&plain)];
        candidates.into_iter().find(|path| path.exists()).unwrap_or_else(|| folder.join(file))
    };
    Ok(Files { paths: relative_file_paths.iter().map(beside).collect(), metadata, notes: Vec::new() })
}

/// A recorder that was killed leaves no `metadata.yaml`. The files of one recording are numbered.
fn without_metadata(folder: &Path) -> Result<Files, BagError> {
    let mut found = files_in(folder);
    found.sort_by_key(|path| numbered(path));
    if let [first, others @ ..] = found.as_slice() {
        let (name, _) = numbered(first);
        if let Some(other) = others.iter().find(|other| numbered(other).0 != name) {
            let problem = format!(
                "the folder has no {METADATA}, and {} and {} are no numbered files of one recording: name the one that is \
                 meant",
                file_name(first),
                file_name(other)
            );
            return Err(BagError::invalid(folder, problem));
        }
    }
    let note = format!(
        "{}: {METADATA} is missing, as a recorder that was killed leaves it; the files of the folder are read in order of their numbers",
        folder.display()
    );
    Ok(Files { paths: found, metadata: Vec::new(), notes: vec![note] })
}

/// The files of a folder that are recordings, each once, in order of their names.
fn files_in(folder: &Path) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let is_recording = |path: &PathBuf| {
        let plain = packed_file::unpacked_name(path);
        let extension = plain.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
        EXTENSIONS.contains(&extension) && path.is_file() && crate::bag::is_recording_file(path)
    };
    let mut paths: Vec<PathBuf> =
        entries.filter_map(Result::ok).map(|entry| entry.path()).filter(is_recording).collect();
    paths.sort();
    // Of a file that was unpacked beside the packed one, the first in order, which is the unpacked one, counts.
    paths.dedup_by_key(|path| packed_file::unpacked_name(path));
    paths
}

/// The name of a file without its number and extensions, and the number: `drive`, 3 for `drive_3.db3`.
fn numbered(path: &Path) -> (String, u64) {
    let plain = packed_file::unpacked_name(path);
    let stem = plain.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let split =
        stem.rsplit_once('_').and_then(|(name, number)| Some((name.to_owned(), number.parse().ok()?)));
    split.unwrap_or((stem, 0))
}

fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}
