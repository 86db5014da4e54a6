//! Extractors by name, as in a configuration or a map.

use super::classical::SiftExtractor;
use super::edgepoint::{self, EdgePointExtractor};
use super::extractor::FeatureExtractor;
use super::r2d2::R2d2Extractor;
use super::weights::{self, R2D2, XFEAT};
use super::xfeat::XfeatExtractor;
use std::path::Path;

/// The default extractor, which needs no weights.
pub const DEFAULT_EXTRACTOR: &str = "sift-1";

/// The names that [`open`] knows; the last two need files of weights.
pub const KNOWN: [&str; 4] = [DEFAULT_EXTRACTOR, edgepoint::NAME, XFEAT.name, R2D2.name];

/// Why an extractor could not be opened.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OpenError {
    /// No extractor has that name.
    #[error("unknown extractor {0}; known extractors: {known}", known = KNOWN.join(", "))]
    UnknownExtractor(String),
    /// The weights that are part of the program cannot be used.
    #[error("the weights of edgepoint2-1 in this program are damaged: {0}; install the program again")]
    Embedded(#[from] super::state_dict::StateDictError),
    /// The weights are missing or damaged.
    #[error(transparent)]
    Weights(#[from] super::weights::WeightsError),
}

/// Opens an extractor by its name.
///
/// # Arguments
/// * `weights_dir`: the folder of network weights; by default [`super::weights::default_folder`].
///
/// # Errors
/// [`OpenError`].
pub fn open(name: &str, weights_dir: Option<&Path>) -> Result<Box<dyn FeatureExtractor>, OpenError> {
    let folder = || weights_dir.map_or_else(weights::default_folder, Path::to_path_buf);
    Ok(match name {
        DEFAULT_EXTRACTOR => Box::new(SiftExtractor::default()),
        edgepoint::NAME => Box::new(EdgePointExtractor::new()?),
        name if name == XFEAT.name => Box::new(XfeatExtractor::open(&folder())?),
        name if name == R2D2.name => Box::new(R2d2Extractor::open(&folder())?),
        other => return Err(OpenError::UnknownExtractor(other.to_owned())),
    })
}
