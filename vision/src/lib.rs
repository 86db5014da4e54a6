//! Images and their features: how they are read, described, compared and matched.
//!
//! | module | what |
//! |---|---|
//! | [`image`] | grey images |
//! | [`equalization`] | spreading the grey levels, for poor light |
//! | [`pyramid`] | smaller copies of an image |
//! | [`corners`] | points worth tracking, spread over the image |
//! | [`tracking`] | following points from image to image and from camera to camera |
//! | [`features`] | finding and describing the distinctive points of an image |
//! | [`descriptors`] | descriptors in memory, and distances between them |
//! | [`matching`] | which descriptor is which: nearest neighbours with distance, ratio and mutual checks |
//! | [`multi_index`] | near binary descriptors among very many |
//! | [`sketch`] | float descriptors as bits, for the same index |
//!
//! The program that brings descriptors says how they are compared ([`Metric`]); this crate knows no map and no
//! wire.
#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod corners;
pub mod descriptors;
pub mod equalization;
pub mod features;
pub mod image;
pub mod matching;
pub mod multi_index;
pub mod pyramid;
pub mod sketch;
pub mod tracking;

pub use corners::{Corner, CornerOptions, detect_corners};
pub use descriptors::{DescriptorError, DescriptorView, Metric, distance, hamming};
pub use equalization::{Equalization, LocalEqualization, equalize, equalize_locally};
pub use features::{ExtractError, FeatureExtractor, ImageFeatures, Keypoint};
pub use image::{GrayImage, ImageError};
pub use matching::{Match, MatchOptions, match_descriptors, match_grouped};
pub use multi_index::{Candidate, MultiIndex};
pub use pyramid::Pyramid;
pub use sketch::{SKETCH_BYTES, Sketcher};
