//! Keypoints with descriptors, for place recognition and map matching: one trait, several extractors.
//!
//! | module | what |
//! |---|---|
//! | [`extractor`] | the trait [`FeatureExtractor`], keypoints and errors |
//! | [`classical`] | SIFT-like extractor (`sift-1`), no weights needed |
//! | `neural` | XFeat (`xfeat-1`) and R2D2 (`r2d2-1`), cargo feature `neural` |
//! | [`mod@open`] | extractors by name |
//! | [`weights`] | where the weights of networks are stored, and their checksums |
//!
//! Robot and map must use the same extractor: [`FeatureExtractor::name`] is part of the map and of every query.

pub mod classical;
pub mod extractor;
mod feature_set;
#[cfg(feature = "neural")]
pub mod neural;
pub mod open;
pub mod weights;

pub use extractor::{ExtractError, FeatureExtractor, ImageFeatures, Keypoint};
pub use feature_set::{feature_set, kind_of, metric_of};
pub use open::{DEFAULT_EXTRACTOR, KNOWN, OpenError, open};
