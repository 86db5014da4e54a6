//! Descriptors converted once for many comparisons.
//!
//! Distances are those of [`super::descriptors::distance`].

use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::descriptors::{
    DescriptorError, DescriptorView, Metric, distance_of_cosine, floats, inverse_norm_int8, normalize,
    number_or_infinite,
};
use super::kernels::{
    DotProduct, Euclidean, FlippedBits, compare_each, fractions, int8_distances, int8_products,
};

/// Descriptors in the form in which distances are computed fastest.
#[derive(Serialize, Deserialize)]
pub(crate) enum PreparedDescriptors {
    /// 64-bit words per descriptor, bits per descriptor, all words; the last word of each is padded with zeros.
    Bits {
        words: usize,
        bits: usize,
        #[serde(with = "super::packed")]
        data: Vec<u64>,
    },
    /// Numbers per descriptor, all numbers, and whether they are unit vectors compared by their cosine.
    Floats {
        dimension: usize,
        #[serde(with = "super::packed")]
        data: Vec<f32>,
        cosine: bool,
    },
    /// Bytes per descriptor, all bytes, and 1 over the norm of each descriptor.
    Int8 {
        dimension: usize,
        #[serde(with = "super::packed")]
        data: Vec<u8>,
        #[serde(with = "super::packed")]
        inverse_norms: Vec<f32>,
    },
}

impl PreparedDescriptors {
    /// Converts each descriptor once.
    pub(crate) fn new(view: &DescriptorView<'_>) -> Self {
        match view.metric() {
            Metric::Hamming => {
                let words = view.width().div_ceil(8);
                let mut data = Vec::with_capacity(words * view.len());
                for descriptor in view {
                    data.extend(descriptor.chunks(8).map(|chunk| {
                        let mut word = [0; 8];
                        word[..chunk.len()].copy_from_slice(chunk);
                        u64::from_le_bytes(word)
                    }));
                }
                Self::Bits { words, bits: 8 * view.width(), data }
            }
            Metric::Euclidean => {
                let data = floats(view.bytes()).collect();
                Self::Floats { dimension: view.width() / 4, data, cosine: false }
            }
            Metric::Cosine => {
                let (dimension, mut data) = (view.width() / 4, floats(view.bytes()).collect::<Vec<f32>>());
                data.chunks_exact_mut(dimension).for_each(normalize);
                Self::Floats { dimension, data, cosine: true }
            }
            Metric::CosineInt8 => Self::int8(view.width(), view.bytes().to_vec()),
        }
    }

    /// Converts descriptors whose bytes are no longer needed, without a copy where the format is that of the bytes.
    ///
    /// # Errors
    /// As [`DescriptorView::new`].
    pub(crate) fn from_bytes(metric: Metric, width: usize, bytes: Vec<u8>) -> Result<Self, DescriptorError> {
        let view = DescriptorView::new(metric, width, &bytes)?;
        Ok(match metric {
            Metric::CosineInt8 => Self::int8(width, bytes),
            Metric::Hamming | Metric::Cosine | Metric::Euclidean => Self::new(&view),
        })
    }

    fn int8(dimension: usize, data: Vec<u8>) -> Self {
        let inverse_norms = data.chunks_exact(dimension).map(inverse_norm_int8).collect();
        Self::Int8 { dimension, data, inverse_norms }
    }

    fn len(&self) -> usize {
        match self {
            Self::Bits { words, data, .. } => data.len() / words,
            Self::Floats { dimension, data, .. } => data.len() / dimension,
            Self::Int8 { inverse_norms, .. } => inverse_norms.len(),
        }
    }

    /// One of them, to be compared with others.
    pub(crate) fn get(&self, index: usize) -> PreparedDescriptor<'_> {
        match self {
            Self::Bits { words, bits, data } => {
                PreparedDescriptor::Bits { own: &data[index * words..(index + 1) * words], bits: *bits }
            }
            Self::Floats { dimension, data, cosine } => PreparedDescriptor::Floats {
                own: &data[index * dimension..(index + 1) * dimension],
                cosine: *cosine,
            },
            Self::Int8 { dimension, data, inverse_norms } => {
                let own = &data[index * dimension..(index + 1) * dimension];
                PreparedDescriptor::Int8 {
                    own: own.iter().map(|byte| byte.cast_signed().into()).collect(),
                    inverse_norm: inverse_norms[index],
                }
            }
        }
    }

    /// Calls `visit` with the index of each descriptor in order and its distances to all `others`, which must have the
    /// same format.
    pub(crate) fn for_each_row(&self, others: &Self, mut visit: impl FnMut(usize, &[f32])) {
        let mut row = Vec::with_capacity(others.len());
        for index in 0..self.len() {
            self.get(index).distances_to(others, 0..others.len(), &mut row);
            visit(index, &row);
        }
    }
}

/// One descriptor in the form in which distances are computed fastest.
pub(crate) enum PreparedDescriptor<'a> {
    Bits {
        own: &'a [u64],
        /// Bits in a descriptor.
        bits: usize,
    },
    Floats {
        own: &'a [f32],
        cosine: bool,
    },
    Int8 {
        /// Widened.
        own: Vec<i16>,
        inverse_norm: f32,
    },
}

impl PreparedDescriptor<'_> {
    /// Writes the distances to a range of `others`, which must have the same format.
    pub(crate) fn distances_to(&self, others: &PreparedDescriptors, range: Range<usize>, row: &mut Vec<f32>) {
        row.clear();
        match (self, others) {
            (Self::Bits { own, bits }, PreparedDescriptors::Bits { words, data: others, .. }) => {
                let others = &others[range.start * words..range.end * words];
                compare_each(&FlippedBits { own }, others, *words, row);
                fractions(row, *bits as f32);
            }
            (Self::Floats { own, cosine }, PreparedDescriptors::Floats { dimension, data: others, .. }) => {
                let others = &others[range.start * dimension..range.end * dimension];
                if *cosine {
                    compare_each(&DotProduct { own }, others, *dimension, row);
                    for cosine in row.iter_mut() {
                        *cosine = distance_of_cosine(*cosine);
                    }
                } else {
                    compare_each(&Euclidean { own }, others, *dimension, row);
                    for distance in row.iter_mut() {
                        *distance = number_or_infinite(*distance);
                    }
                }
            }
            (
                Self::Int8 { own, inverse_norm },
                PreparedDescriptors::Int8 { dimension, data: others, inverse_norms },
            ) => {
                let others = &others[range.start * dimension..range.end * dimension];
                int8_products(own, others, row);
                int8_distances(row, *inverse_norm, &inverse_norms[range]);
            }
            _ => {}
        }
    }
}
