//! Settings of the estimator in a YAML file.

use estimator::EstimatorConfig;
use std::path::{Path, PathBuf};

/// Why a settings file cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SettingsError {
    /// The file cannot be read.
    #[error("cannot read settings {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The file is not YAML.
    #[error("settings {} are not valid YAML: {source}", path.display())]
    Yaml {
        /// The file.
        path: PathBuf,
        /// The error of the parser.
        source: Box<serde_saphyr::Error>,
    },
    /// A setting is unknown or has a wrong value.
    #[error("settings {}: {source}", path.display())]
    Setting {
        /// The file.
        path: PathBuf,
        /// Which one, and why.
        source: serde_json::Error,
    },
}

/// Reads settings of the estimator from a YAML file; what it leaves out is as in `defaults`.
///
/// # Errors
/// [`SettingsError`]: the file cannot be read, or does not hold settings.
pub fn read_settings(path: &Path, defaults: &EstimatorConfig) -> Result<EstimatorConfig, SettingsError> {
    let wrong = |source| SettingsError::Setting { path: path.to_path_buf(), source };
    let text = files::read_to_string(path)
        .map_err(|source| SettingsError::Io { path: path.to_path_buf(), source })?;
    let given: serde_json::Value = serde_saphyr::from_str(&text)
        .map_err(|source| SettingsError::Yaml { path: path.to_path_buf(), source: Box::new(source) })?;
    let mut settings = serde_json::to_value(defaults).map_err(wrong)?;
    overlay(&mut settings, given);
    serde_json::from_value(settings).map_err(wrong)
}

/// Replaces what `given` names, field by field.
fn overlay(settings: &mut serde_json::Value, given: serde_json::Value) {
    match (settings, given) {
        (serde_json::Value::Object(fields), serde_json::Value::Object(given)) => {
            for (name, value) in given {
                overlay(fields.entry(name).or_insert(serde_json::Value::Null), value);
            }
        }
        (setting, value) => *setting = value,
    }
}
