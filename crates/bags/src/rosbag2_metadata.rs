//! The information about a rosbag2: `metadata.yaml`, and the same in the files of SQLite.
//!
//! Its `custom_data` holds texts by their keys. Those of [`Metadata`] have the keys `name/entry`.

use crate::storage::Metadata;
use serde::{Deserialize, Deserializer};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::PathBuf;

/// Between the name of a [`Metadata`] and that of its entry.
const SEPARATOR: char = '/';

/// `metadata.yaml`.
#[derive(Deserialize)]
pub(crate) struct MetadataYaml {
    #[serde(rename = "rosbag2_bagfile_information")]
    pub(crate) information: Information,
}

/// What is stated about a recording, as far as it is read.
#[derive(Deserialize)]
pub(crate) struct Information {
    pub(crate) relative_file_paths: Vec<PathBuf>,
    #[serde(default)]
    pub(crate) compression_format: String,
    #[serde(default)]
    pub(crate) compression_mode: String,
    #[serde(default, deserialize_with = "null_or_texts")]
    custom_data: BTreeMap<String, String>,
}

impl Information {
    /// The texts about the recording, in order of their names.
    pub(crate) fn metadata(&self) -> Vec<Metadata> {
        let mut named: BTreeMap<&str, BTreeMap<String, String>> = BTreeMap::new();
        for (key, text) in &self.custom_data {
            let (name, entry) = key.split_once(SEPARATOR).unwrap_or(("", key));
            named.entry(name).or_default().insert(entry.to_owned(), text.clone());
        }
        named.into_iter().map(|(name, entries)| Metadata { name: name.to_owned(), entries }).collect()
    }
}

/// `custom_data: ~` is what rosbag2 writes where there is none.
fn null_or_texts<'de, D: Deserializer<'de>>(deserializer: D) -> Result<BTreeMap<String, String>, D::Error> {
    Ok(Option::deserialize(deserializer)?.unwrap_or_default())
}

/// A text in quotes, on one line. Strings of JSON are such of YAML.
pub(crate) fn quoted(text: &str) -> serde_json::Value {
    serde_json::Value::from(text)
}

/// The value of `custom_data`, from behind its colon to the end of its last line.
pub(crate) fn custom_data_yaml(metadata: &[Metadata]) -> String {
    let mut lines = String::new();
    for Metadata { name, entries } in metadata {
        for (entry, text) in entries {
            let key = quoted(&format!("{name}{SEPARATOR}{entry}"));
            let _ = write!(lines, "\n  {key}: {}", quoted(text));
        }
    }
    if lines.is_empty() { " ~\n".to_owned() } else { lines + "\n" }
}
