//! Features of an image in the form in which they are stored and sent.

use protocol::{DescriptorKind, Descriptors, FeatureSet};
use vision::{ImageFeatures, Metric};

/// How the wire names a metric.
fn kind_of(metric: Metric) -> DescriptorKind {
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
