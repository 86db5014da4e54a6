//! The folder of a rosbag2: `metadata.yaml` and the files that it names.

use crate::BagError;
use serde::Deserialize;
use std::path::{Path, PathBuf};

const METADATA: &str = "metadata.yaml";

#[derive(Deserialize)]
struct MetadataYaml {
    rosbag2_bagfile_information: Information,
}

#[derive(Deserialize)]
struct Information {
    relative_file_paths: Vec<PathBuf>,
    #[serde(default)]
    compression_format: String,
    #[serde(default)]
    compression_mode: String,
}

/// The files of a recording, in order of time.
pub(crate) struct Files {
    pub(crate) paths: Vec<PathBuf>,
    /// Whether each message is compressed with zstd.
    pub(crate) packed_messages: bool,
}

/// Whether a folder is a rosbag2.
pub(crate) fn is_rosbag2(folder: &Path) -> bool {
    folder.join(METADATA).is_file()
}

/// Reads the folder's `metadata.yaml`.
pub(crate) fn read(folder: &Path) -> Result<Files, BagError> {
    let path = folder.join(METADATA);
    let text = std::fs::read_to_string(&path).map_err(|source| BagError::io(&path, source))?;
    let yaml: MetadataYaml = serde_saphyr::from_str(&text)
        .map_err(|error| BagError::invalid(&path, format!("it is not the metadata of a rosbag2: {error}")))?;
    let information = yaml.rosbag2_bagfile_information;
    let mode = information.compression_mode.to_ascii_lowercase();
    if mode == "file" {
        let problem = "its files are compressed as a whole: unpack them with `zstd -d`, and open the .db3 or .mcap files";
        return Err(BagError::invalid(&path, problem));
    }
    let packed_messages = mode == "message";
    if packed_messages && information.compression_format != "zstd" {
        let problem =
            format!("compression \"{}\" is unknown: zstd is the only one", information.compression_format);
        return Err(BagError::invalid(&path, problem));
    }
    // Early versions of rosbag2 wrote the folder's name in front.
    let beside = |file: &PathBuf| {
        let plain = folder.join(file.file_name().unwrap_or(file.as_os_str()));
        if plain.exists() { plain } else { folder.join(file) }
    };
    let paths = information.relative_file_paths.iter().map(beside).collect();
    Ok(Files { paths, packed_messages })
}
