//! Keypoints with descriptors, for place recognition and map matching: one trait, several extractors.
//!
//! | module | what |
//! |---|---|
//! | [`extractor`] | the trait [`FeatureExtractor`], keypoints and errors |
//! | [`classical`] | SIFT-like extractor (`sift-1`), no weights needed |
//! | [`edgepoint`] | EdgePoint2 (`edgepoint2-1`): a small network whose weights are part of the program |
//! | [`xfeat`], [`r2d2`] | XFeat (`xfeat-1`) and R2D2 (`r2d2-1`): networks whose weights are fetched |
//! | [`mod@open`] | extractors by name |
//! | [`layers`] | layers of small networks |
//! | [`state_dict`] | weights of networks by name, from safetensors files |
//! | [`quantize`](mod@quantize) | descriptors as signed bytes |
//! | [`weights`] | where the weights of networks are stored, and their checksums |
//!
//! Robot and map must use the same extractor: [`FeatureExtractor::name`] is part of the map and of every query.

pub mod classical;
pub mod edgepoint;
pub mod extractor;
mod feature_set;
mod heatmap;
pub mod layers;
pub mod open;
pub mod quantize;
pub mod r2d2;
mod selection;
pub mod state_dict;
pub mod weights;
pub mod xfeat;

pub use edgepoint::EdgePointExtractor;
pub use extractor::{ExtractError, FeatureExtractor, ImageFeatures, Keypoint};
pub use feature_set::{feature_set, kind_of, metric_of};
pub use open::{DEFAULT_EXTRACTOR, KNOWN, OpenError, open};
pub use r2d2::R2d2Extractor;
pub use state_dict::{StateDict, StateDictError};
pub use xfeat::XfeatExtractor;
