//! All integration tests of the crate, in one program.
#![allow(clippy::unwrap_used, missing_docs)]

mod classical;
mod common;
mod corners;
mod descriptors;
mod fast_distances;
mod image_preparation;
mod inverted_file;
mod learned;
mod lucas_kanade;
mod matching;
mod outliers;
mod reference;
mod tracker;
mod weights_file;
