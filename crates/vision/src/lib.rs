//! Images and their features: detection, tracking, description and matching. No map, no network.
//!
//! | module | what |
//! |---|---|
//! | [`image`] | grey images, pyramids, histogram equalization |
//! | [`detection`] | corners distributed over the image |
//! | [`tracking`] | pyramidal Lucas-Kanade tracking from image to image and between stereo cameras |
//! | [`matching`] | descriptors, metrics, brute-force matching, inverted file over a visual vocabulary |
//! | [`features`] | keypoint extractors with descriptors: SIFT-like; the networks EdgePoint2, XFeat and R2D2 |
//!
//! # Conventions
//! Pixel (0, 0) is the centre of the top-left pixel, x to the right, y down; pixels are distorted, as observed.
//! Descriptors are bytes with a [`Metric`]; extractors state theirs.
//!
//! # Vector instructions
//! A program for every x86-64 may use SSE2 only. [`pulp`] compiles what is inlined into [`pulp::NullaryFnOnce::call`] for AVX2
//! too, and chooses when it runs. So loops over pixels are `inline(always)`: a function that is called instead would use SSE2.
#![cfg_attr(test, allow(clippy::unwrap_used))]
#![allow(clippy::inline_always, reason = "see \"Vector instructions\"")]

pub mod detection;
pub mod features;
pub mod image;
pub mod matching;
pub mod tracking;

pub use detection::{Corner, CornerOptions, detect_corners};
pub use features::{
    ExtractError, FeatureExtractor, ImageFeatures, Keypoint, feature_set, kind_of, metric_of,
};
pub use image::{
    Equalization, GrayImage, ImageError, LocalEqualization, MAX_IMAGE_FILE_BYTES, MAX_IMAGE_SIDE, MAX_PIXELS,
    MAX_SCANS, Pyramid, RawImage, equalize, equalize_locally,
};
pub use matching::{
    DescriptorError, DescriptorView, Hit, InvertedFile, Match, MatchOptions, Matcher, Metric, distance,
    exact, hamming, match_descriptors, match_grouped, packed, prototype_descriptors,
};
