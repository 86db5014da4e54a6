//! Images and their features: how they are read, described, compared and matched.
//!
//! | module | what |
//! |---|---|
//! | [`image`] | grey images |
//! | [`features`] | finding and describing the distinctive points of an image |
//! | [`descriptors`] | descriptors in memory, and distances between them |
//! | [`matching`] | which descriptor is which: nearest neighbours with distance, ratio and mutual checks |
//! | [`multi_index`] | near binary descriptors among very many |
//! | [`sketch`] | float descriptors as bits, for the same index |
//!
//! The program that brings descriptors says how they are compared ([`Metric`]); this crate knows no map and no
//! wire.
#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod descriptors;
pub mod features;
pub mod image;
pub mod looks;
pub mod matching;
pub mod multi_index;
mod prepared;
pub mod sketch;
pub mod word_index;
mod words;

pub use descriptors::{DescriptorError, DescriptorView, Metric, distance, hamming};
pub use features::{ExtractError, FeatureExtractor, ImageFeatures, Keypoint};
pub use image::{GrayImage, ImageError};
pub use looks::looks;
pub use matching::{Match, MatchOptions, match_descriptors, match_grouped};
pub use multi_index::{Candidate, MultiIndex};
pub use sketch::{SKETCH_BYTES, Sketcher};
pub use word_index::{Hit, WordIndex};
