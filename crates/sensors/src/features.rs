//! Conversion of features to the form in which they are stored and sent.

use protocol::{DescriptorKind, Descriptors, FeatureSet};
use vision::{ImageFeatures, Metric};

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

/// The features of an image in the form in which they are stored and sent.
///
/// # Arguments
/// * `extractor`: name of what made them.
pub fn feature_set(extractor: &str, seen: ImageFeatures) -> FeatureSet {
    FeatureSet {
        pixels: seen.keypoints.iter().map(|keypoint| keypoint.pixel).collect(),
        descriptors: Descriptors {
            kind: kind_of(seen.metric),
            width: seen.width as u16,
            bytes: seen.descriptors,
        },
        extractor: extractor.to_owned(),
    }
}
