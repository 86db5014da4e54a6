//! Descriptors converted once for many comparisons.
//!
//! Distances are those of [`super::descriptors::distance`].

use std::ops::Range;

use super::descriptors::{
    DescriptorView, Metric, distance_of_cosine, floats, inverse_norm_int8, normalize, number_or_infinite,
};
use super::kernels::{
    DotProduct, Euclidean, FlippedBits, compare_each, fractions, int8_distances, int8_products,
};

/// Descriptors in the form in which distances are computed fastest.
pub(crate) enum PreparedDescriptors {
    /// 64-bit words per descriptor, bits per descriptor, all words; the last word of each is padded with zeros.
    Bits { words: usize, bits: usize, data: Vec<u64> },
    /// Numbers per descriptor, all numbers, and whether they are unit vectors compared by their cosine.
    Floats { dimension: usize, data: Vec<f32>, cosine: bool },
    /// Bytes per descriptor, all bytes, and 1 over the norm of each descriptor.
    Int8 { dimension: usize, data: Vec<u8>, inverse_norms: Vec<f32> },
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
            Metric::CosineInt8 => Self::Int8 {
                dimension: view.width(),
                data: view.bytes().to_vec(),
                inverse_norms: view.iter().map(inverse_norm_int8).collect(),
            },
        }
    }

    fn len(&self) -> usize {
        match self {
            Self::Bits { words, data, .. } => data.len() / words,
            Self::Floats { dimension, data, .. } => data.len() / dimension,
            Self::Int8 { inverse_norms, .. } => inverse_norms.len(),
        }
    }

    /// Writes the distances from descriptor `index` to a range of `others`, which must have the same format.
    pub(crate) fn distances_to(&self, index: usize, others: &Self, range: Range<usize>, row: &mut Vec<f32>) {
        row.clear();
        match (self, others) {
            (Self::Bits { words, bits, data }, Self::Bits { data: others, .. }) => {
                let own = &data[index * words..(index + 1) * words];
                let others = &others[range.start * words..range.end * words];
                compare_each(&FlippedBits { own }, others, *words, row);
                fractions(row, *bits as f32);
            }
            (Self::Floats { dimension, data, cosine }, Self::Floats { data: others, .. }) => {
                let own = &data[index * dimension..(index + 1) * dimension];
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
                Self::Int8 { dimension, data, inverse_norms },
                Self::Int8 { data: others, inverse_norms: others_norms, .. },
            ) => {
                let own = &data[index * dimension..(index + 1) * dimension];
                let own: Vec<i16> = own.iter().map(|byte| byte.cast_signed().into()).collect();
                let others = &others[range.start * dimension..range.end * dimension];
                int8_products(&own, others, row);
                int8_distances(row, inverse_norms[index], &others_norms[range]);
            }
            _ => {}
        }
    }

    /// Calls `visit` with the index of each descriptor in order and its distances to all `others`, which must have the
    /// same format.
    pub(crate) fn for_each_row(&self, others: &Self, mut visit: impl FnMut(usize, &[f32])) {
        let mut row = Vec::with_capacity(others.len());
        for index in 0..self.len() {
            self.distances_to(index, others, 0..others.len(), &mut row);
            visit(index, &row);
        }
    }
}
