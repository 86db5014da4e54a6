//! Extractors by name.

use std::path::Path;

use super::FeatureExtractor;
use super::classical::SiftExtractor;

/// The extractor that needs nothing but this program.
pub const DEFAULT_EXTRACTOR: &str = "sift-1";

/// Why there is no such extractor.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// Nobody knows it.
    #[error("there is no extractor {0:?}; there is sift-1")]
    Unknown(String),
}

/// The extractor of that name.
///
/// # Errors
/// [`OpenError`], with what to do.
pub fn open(name: &str, _weights: Option<&Path>) -> Result<Box<dyn FeatureExtractor>, OpenError> {
    match name {
        DEFAULT_EXTRACTOR => Ok(Box::new(SiftExtractor::default())),
        other => Err(OpenError::Unknown(other.to_owned())),
    }
}
