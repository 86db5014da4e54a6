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
//! | [`inverted_file`] | near descriptors among very many |
//! | [`looks`](mod@looks) | few descriptors that stand for all views of one thing |
//!
//! The program that brings descriptors says how they are compared ([`Metric`]); this crate knows no map and no
//! wire.
#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod corners;
pub mod descriptors;
pub mod equalization;
pub mod features;
pub mod image;
pub mod inverted_file;
pub mod looks;
pub mod matching;
mod prepared;
pub mod pyramid;
pub mod tracking;
mod words;

pub use corners::{Corner, CornerOptions, detect_corners};
pub use descriptors::{DescriptorError, DescriptorView, Metric, distance, hamming};
pub use equalization::{Equalization, LocalEqualization, equalize, equalize_locally};
pub use features::{ExtractError, FeatureExtractor, ImageFeatures, Keypoint};
pub use image::{GrayImage, ImageError};
pub use inverted_file::{Hit, InvertedFile};
pub use looks::looks;
pub use matching::{Match, MatchOptions, match_descriptors, match_grouped};
pub use pyramid::Pyramid;
