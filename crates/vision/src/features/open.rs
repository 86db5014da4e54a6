//! Extractors by name, as in a configuration or a map.

use super::classical::SiftExtractor;
use super::edgepoint::{self, EdgePointExtractor};
use super::extractor::FeatureExtractor;
use std::path::Path;

/// The default extractor, which needs no weights.
pub const DEFAULT_EXTRACTOR: &str = "sift-1";

/// The names that [`open`] knows; the last two need the feature `neural` and files of weights.
pub const KNOWN: [&str; 4] =
    [DEFAULT_EXTRACTOR, edgepoint::NAME, super::weights::XFEAT.name, super::weights::R2D2.name];

/// Whether an extractor works in the thread that calls it only, so that several of them make use of several processors.
pub fn uses_one_thread(name: &str) -> bool {
    [DEFAULT_EXTRACTOR, edgepoint::NAME].contains(&name)
}

/// Why an extractor could not be opened.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OpenError {
    /// No extractor has that name.
    #[error("unknown extractor {0}; known extractors: {known}", known = KNOWN.join(", "))]
    UnknownExtractor(String),
    /// The program was built without the feature `neural`.
    #[error("extractor {0} needs a program built with `--features neural`")]
    NeedsNeural(String),
    /// The weights that are part of the program cannot be used.
    #[error("the weights of edgepoint2-1 in this program are damaged: {0}; install the program again")]
    Embedded(#[from] super::state_dict::StateDictError),
    /// The weights are missing or damaged.
    #[cfg(feature = "neural")]
    #[error(transparent)]
    Weights(#[from] super::neural::WeightsError),
}

/// Opens an extractor by its name.
///
/// # Arguments
/// * `weights_dir`: the folder of network weights; by default [`super::weights::default_folder`].
///
/// # Errors
/// [`OpenError`].
pub fn open(name: &str, weights_dir: Option<&Path>) -> Result<Box<dyn FeatureExtractor>, OpenError> {
    match name {
        DEFAULT_EXTRACTOR => Ok(Box::new(SiftExtractor::default())),
        edgepoint::NAME => Ok(Box::new(EdgePointExtractor::new()?)),
        name if KNOWN.contains(&name) => open_network(name, weights_dir),
        other => Err(OpenError::UnknownExtractor(other.to_owned())),
    }
}

#[cfg(feature = "neural")]
fn open_network(name: &str, weights_dir: Option<&Path>) -> Result<Box<dyn FeatureExtractor>, OpenError> {
    let folder = weights_dir.map_or_else(super::weights::default_folder, Path::to_path_buf);
    if name == super::weights::XFEAT.name {
        return Ok(Box::new(super::neural::XfeatExtractor::open(&folder)?));
    }
    Ok(Box::new(super::neural::R2d2Extractor::open(&folder)?))
}

#[cfg(not(feature = "neural"))]
fn open_network(name: &str, _: Option<&Path>) -> Result<Box<dyn FeatureExtractor>, OpenError> {
    Err(OpenError::NeedsNeural(name.to_owned()))
}
