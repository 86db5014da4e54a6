//! From an extractor's features to those that are stored in maps and sent in queries.

use protocol::{DescriptorKind, Descriptors, FeatureSet};
use vision::{ImageFeatures, Metric};

/// The kind of descriptors that a metric compares.
fn kind_of(metric: Metric) -> DescriptorKind {
    match metric {
        Metric::Hamming => DescriptorKind::Binary,
        Metric::CosineInt8 => DescriptorKind::Int8,
        Metric::Cosine | Metric::Euclidean => DescriptorKind::Float,
    }
}

/// The features of an image as they are stored in maps and sent in queries.
///
/// # Arguments
/// * `extractor`: name of the extractor, which must be the same for map and query.
/// * `features`: pixels and descriptors as the extractor returns them.
pub fn feature_set(extractor: &str, features: ImageFeatures) -> FeatureSet {
    FeatureSet {
        pixels: features.keypoints.iter().map(|keypoint| keypoint.pixel).collect(),
        descriptors: Descriptors {
            kind: kind_of(features.metric),
            width: features.width as u16,
            bytes: features.descriptors,
        },
        extractor: extractor.to_owned(),
    }
}
