//! Descriptors in memory, metrics, and distances between two descriptors.

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// How two descriptors are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Metric {
    /// Binary descriptors: the fraction of bits that differ, 0 to 1; unrelated ones are near 0.5.
    Hamming,
    /// `f32` descriptors: 1 minus the cosine of the angle between them, 0 to 2; unrelated ones are near 1. The
    /// distance to a descriptor of norm zero is 1.
    Cosine,
    /// Signed bytes: 1 minus the cosine of the angle between them, as for [`Metric::Cosine`]. A quarter of its size.
    CosineInt8,
    /// `f32` descriptors: Euclidean distance, in the descriptor's own unit.
    Euclidean,
}

impl Metric {
    /// Whether descriptors are `f32` numbers.
    pub fn is_float(self) -> bool {
        matches!(self, Self::Cosine | Self::Euclidean)
    }
}

/// Invalid descriptor bytes, or descriptors that cannot be compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum DescriptorError {
    /// A descriptor's width is zero, or not a multiple of 4 although it holds `f32` numbers.
    #[error("descriptors of {width} bytes cannot be compared by {metric:?} distance")]
    Width {
        /// Bytes per descriptor.
        width: usize,
        /// The metric.
        metric: Metric,
    },
    /// The bytes are not a whole number of descriptors.
    #[error("{bytes} bytes are not a whole number of descriptors of {width} bytes")]
    Length {
        /// Number of bytes.
        bytes: usize,
        /// Bytes per descriptor.
        width: usize,
    },
    /// Two sets differ in metric or width.
    #[error(
        "descriptors of {left} bytes cannot be compared with descriptors of {right} bytes, or their metrics differ"
    )]
    Mismatch {
        /// Bytes per descriptor of the first set.
        left: usize,
        /// Bytes per descriptor of the second set.
        right: usize,
    },
    /// The number of group numbers (or payloads) is not the number of descriptors.
    #[error("{groups} group numbers or payloads for {descriptors} descriptors")]
    Groups {
        /// Number of group numbers.
        groups: usize,
        /// Number of descriptors.
        descriptors: usize,
    },
    /// More descriptors than an index can number with 32 bits.
    #[error("an index holds at most 2^32 - 1 descriptors")]
    Full,
}

/// Borrowed descriptors of one metric and width, one after the other without gaps.
///
/// # Example
/// ```
/// use vision::{DescriptorView, Metric};
/// let view = DescriptorView::new(Metric::Hamming, 2, &[0xff, 0x00, 0x0f, 0x00])?;
/// assert_eq!(view.len(), 2);
/// assert_eq!(view.get(1), Some(&[0x0f, 0x00][..]));
/// assert_eq!(vision::distance(Metric::Hamming, &view.bytes()[..2], &view.bytes()[2..]), 4.0 / 16.0);
/// # Ok::<(), vision::DescriptorError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DescriptorView<'a> {
    metric: Metric,
    width: usize,
    bytes: &'a [u8],
}

impl<'a> DescriptorView<'a> {
    /// Views `bytes` as descriptors of `width` bytes; `f32` numbers are little-endian.
    ///
    /// # Errors
    /// [`DescriptorError::Width`], [`DescriptorError::Length`].
    pub fn new(metric: Metric, width: usize, bytes: &'a [u8]) -> Result<Self, DescriptorError> {
        if width == 0 || (metric.is_float() && !width.is_multiple_of(4)) {
            return Err(DescriptorError::Width { width, metric });
        }
        if !bytes.len().is_multiple_of(width) {
            return Err(DescriptorError::Length { bytes: bytes.len(), width });
        }
        Ok(Self { metric, width, bytes })
    }

    /// The metric by which they are compared.
    pub fn metric(&self) -> Metric {
        self.metric
    }

    /// Bytes per descriptor.
    pub fn width(&self) -> usize {
        self.width
    }

    /// The bytes of all descriptors.
    pub fn bytes(&self) -> &'a [u8] {
        self.bytes
    }

    /// Number of descriptors.
    pub fn len(&self) -> usize {
        self.bytes.len() / self.width
    }

    /// Whether there are no descriptors.
    pub fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    /// Descriptor `index`, `None` beyond the last.
    pub fn get(&self, index: usize) -> Option<&'a [u8]> {
        let start = index.checked_mul(self.width)?;
        self.bytes.get(start..start.checked_add(self.width)?)
    }

    /// Every descriptor in order.
    pub fn iter(&self) -> std::slice::ChunksExact<'a, u8> {
        self.bytes.chunks_exact(self.width)
    }
}

impl<'a> IntoIterator for &DescriptorView<'a> {
    type Item = &'a [u8];
    type IntoIter = std::slice::ChunksExact<'a, u8>;
    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

/// Number of bits that differ (Hamming distance).
///
/// Both must have the same length; bytes beyond the shorter one are not compared.
///
/// ```
/// assert_eq!(vision::hamming(&[0b1010; 32], &[0b0010; 32]), 32);
/// ```
pub fn hamming(a: &[u8], b: &[u8]) -> u32 {
    let (words_a, rest_a) = a.as_chunks::<8>();
    let (words_b, rest_b) = b.as_chunks::<8>();
    let word = |bytes: &[u8; 8]| u64::from_le_bytes(*bytes);
    let in_words: u32 = words_a.iter().zip(words_b).map(|(x, y)| (word(x) ^ word(y)).count_ones()).sum();
    let in_rest: u32 = rest_a.iter().zip(rest_b).map(|(x, y)| (x ^ y).count_ones()).sum();
    in_words + in_rest
}

/// The numbers of a float descriptor.
pub(crate) fn floats(bytes: &[u8]) -> impl Iterator<Item = f32> {
    bytes.as_chunks::<4>().0.iter().map(|&number| f32::from_le_bytes(number))
}

/// The numbers of a descriptor of signed bytes.
pub(crate) fn signed(bytes: &[u8]) -> impl Iterator<Item = f32> {
    bytes.iter().map(|&byte| f32::from(byte.cast_signed()))
}

/// Scales a vector to norm 1; the zero vector stays.
pub(crate) fn normalize(vector: &mut [f32]) {
    let norm = vector.iter().map(|number| number * number).sum::<f32>().sqrt();
    if norm > 0.0 {
        for number in vector {
            *number /= norm;
        }
    }
}

/// Maps NaN (the descriptors held NaN or infinity) to infinity: such descriptors match nothing.
pub(crate) fn number_or_infinite(distance: f32) -> f32 {
    if distance.is_nan() { f32::INFINITY } else { distance }
}

/// Rounding can take a cosine beyond 1; the distance stays non-negative. (`NaN.max(0.0)` would be 0, a perfect match.)
pub(crate) fn distance_of_cosine(cosine: f32) -> f32 {
    number_or_infinite(1.0 - cosine).max(0.0)
}

/// Distance of two descriptors of the same width, as [`Metric`] defines it; infinite where it would be NaN.
pub fn distance(metric: Metric, a: &[u8], b: &[u8]) -> f32 {
    match metric {
        Metric::Hamming => hamming(a, b) as f32 / (8 * a.len()).max(1) as f32,
        Metric::Cosine => cosine_distance(floats(a).zip(floats(b))),
        Metric::CosineInt8 => {
            int8_distance(dot_int8(a, b) as f32, inverse_norm_int8(a), inverse_norm_int8(b))
        }
        Metric::Euclidean => {
            number_or_infinite(floats(a).zip(floats(b)).map(|(x, y)| (x - y) * (x - y)).sum::<f32>().sqrt())
        }
    }
}

/// 1 minus the cosine of the angle between two vectors, given by their pairs of numbers.
fn cosine_distance(pairs: impl Iterator<Item = (f32, f32)>) -> f32 {
    let (mut dot, mut norm_a, mut norm_b) = (0.0, 0.0, 0.0);
    for (x, y) in pairs {
        dot += x * y;
        norm_a += x * x;
        norm_b += y * y;
    }
    let norms = (norm_a * norm_b).sqrt();
    if norms == 0.0 { 1.0 } else { distance_of_cosine(dot / norms) }
}

/// Scalar product of two vectors of signed bytes; exact up to 2^17 elements.
pub(crate) fn dot_int8(a: &[u8], b: &[u8]) -> i32 {
    let product = |(x, y): (&u8, &u8)| i32::from(x.cast_signed()) * i32::from(y.cast_signed());
    a.iter().zip(b).map(product).sum()
}

/// 1 over the norm of a vector of signed bytes; 0 for a vector of zeros.
pub(crate) fn inverse_norm_int8(bytes: &[u8]) -> f32 {
    let squared = dot_int8(bytes, bytes) as f32;
    if squared > 0.0 { 1.0 / squared.sqrt() } else { 0.0 }
}

/// Cosine distance from the scalar product and the inverse norms; 1 where one of these is 0.
#[inline]
pub(crate) fn int8_distance(dot: f32, inverse_norm_a: f32, inverse_norm_b: f32) -> f32 {
    let distance = 1.0 - dot * (inverse_norm_a * inverse_norm_b);
    // Rounding; a comparison rather than `max`, which would not become a vector instruction.
    if distance < 0.0 { 0.0 } else { distance }
}
