//! Features as they are stored in maps and sent in queries.

use super::ImageFeatures;
use crate::matching::Metric;
use types::{DescriptorKind, Descriptors, FeatureSet};

/// The metric by which descriptors of a kind are compared. Floats are compared by their cosine.
pub fn metric_of(kind: DescriptorKind) -> Metric {
    match kind {
        DescriptorKind::Binary => Metric::Hamming,
        DescriptorKind::Int8 => Metric::CosineInt8,
        DescriptorKind::Float => Metric::Cosine,
    }
}

/// The kind under which descriptors of a metric are stored and sent.
pub fn kind_of(metric: Metric) -> DescriptorKind {
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
