//! The features of one image: pixels and descriptors.

use crate::bounded;
use crate::descriptors::{DescriptorFormat, Descriptors};
use serde::{Deserialize, Serialize};

/// Most features in one image. Extractors give 300 to 2,000; the cost of matching grows with the square.
pub const MAX_FEATURES: usize = 20_000;

/// The features of one image: pixel `i` belongs to descriptor `i`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FeatureSet {
    /// `[u, v]`, distorted, as measured; (0, 0) is the centre of the top-left pixel.
    #[serde(deserialize_with = "bounded::list::<_, _, MAX_FEATURES>")]
    pub pixels: Vec<[f32; 2]>,
    /// Their descriptors, in the same order.
    pub descriptors: Descriptors,
    /// Name and version of the extractor that computed the descriptors, for example `sift-1`; empty if unknown. Empty in a
    /// stored map, whose info names it once.
    #[serde(default)]
    pub extractor: String,
}

impl FeatureSet {
    /// No features, of descriptors of the given format and of an unknown extractor.
    pub fn empty(format: DescriptorFormat) -> Self {
        Self { pixels: Vec::new(), descriptors: Descriptors::empty(format), extractor: String::new() }
    }

    /// Number of features.
    pub fn len(&self) -> usize {
        self.pixels.len()
    }

    /// Whether the list is empty.
    pub fn is_empty(&self) -> bool {
        self.pixels.is_empty()
    }
}
