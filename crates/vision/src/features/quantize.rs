//! Quantization of unit vectors to signed bytes.
//!
//! The distance of [`crate::matching::Metric::CosineInt8`] does not depend on the length of a descriptor, so each one is
//! scaled individually: its largest magnitude becomes 127. Nothing is clipped.

use super::extractor::{ImageFeatures, Keypoint};
use crate::matching::Metric;

/// The largest signed byte.
const LARGEST: f32 = 127.0;

/// Appends the vector to `bytes`, one signed byte per number. The zero vector stays zero.
pub fn quantize(vector: &[f32], bytes: &mut Vec<u8>) {
    let largest = vector.iter().fold(0.0_f32, |largest, number| largest.max(number.abs()));
    let scale = if largest > 0.0 { LARGEST / largest } else { 0.0 };
    bytes.extend(vector.iter().map(|number| ((number * scale).round() as i8).cast_unsigned()));
}

/// The features of keypoints whose descriptors are unit vectors of `width` numbers, as signed bytes.
pub(super) fn quantized<'a>(
    keypoints: Vec<Keypoint>,
    width: usize,
    vectors: impl Iterator<Item = &'a [f32]>,
) -> ImageFeatures {
    let mut descriptors = Vec::with_capacity(keypoints.len() * width);
    for vector in vectors {
        quantize(vector, &mut descriptors);
    }
    ImageFeatures { keypoints, metric: Metric::CosineInt8, width, descriptors }
}
