//! Descriptors converted once for many comparisons.
//!
//! Distances are those of [`super::descriptors::distance`]. Signed bytes are compared by a product of matrices of `f32`: sums of
//! products of up to 1024 bytes are integers of at most 2^24, exact in any order of summation, and the matrix product uses the widest instructions that the processor has (AVX2 where a plain loop, compiled
//! for every x86-64, may use SSE2 only).

use std::ops::Range;

use nalgebra::{DMatrix, DMatrixView};

use super::descriptors::{
    DescriptorView, Metric, distance_of_cosine, floats, int8_distance, inverse_norm_int8, normalize,
    number_or_infinite, signed,
};

/// Largest dimension whose scalar products of signed bytes are exact in `f32`: `1024 * 128 * 128 = 2^24`.
const MAX_EXACT_DIMENSION: usize = 1024;
/// Descriptors of one side in a matrix product: 64 rows of distances to 400 others stay in the second-level cache.
const BLOCK: usize = 64;

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
                let scale = *bits as f32;
                let others = &others[range.start * words..range.end * words];
                row.extend(others.chunks_exact(*words).map(|other| {
                    let flips: u32 = own.iter().zip(other).map(|(x, y)| (x ^ y).count_ones()).sum();
                    flips as f32 / scale
                }));
            }
            (Self::Floats { dimension, data, cosine }, Self::Floats { data: others, .. }) => {
                let own = &data[index * dimension..(index + 1) * dimension];
                let others = &others[range.start * dimension..range.end * dimension];
                row.extend(others.chunks_exact(*dimension).map(|other| {
                    if *cosine { distance_of_cosine(dot(own, other)) } else { euclidean(own, other) }
                }));
            }
            (
                Self::Int8 { dimension, data, inverse_norms },
                Self::Int8 { data: others, inverse_norms: others_norms, .. },
            ) => {
                let own = &data[index * dimension..(index + 1) * dimension];
                // Widened once: with 64 bytes 7.0 ns a product instead of 9.2 (SSE2).
                let own: Vec<i16> = own.iter().map(|byte| byte.cast_signed().into()).collect();
                let others = &others[range.start * dimension..range.end * dimension];
                row.extend(others.chunks_exact(*dimension).zip(&others_norms[range]).map(|(other, norm)| {
                    int8_distance(dot_widened(&own, other) as f32, inverse_norms[index], *norm)
                }));
            }
            _ => {}
        }
    }

    /// Calls `visit` with the index of each descriptor in order and its distances to all `others`, which must have the
    /// same format.
    pub(crate) fn for_each_row(&self, others: &Self, mut visit: impl FnMut(usize, &[f32])) {
        if let (
            Self::Int8 { dimension, data, inverse_norms },
            Self::Int8 { data: others, inverse_norms: others_norms, .. },
        ) = (self, others)
            && *dimension <= MAX_EXACT_DIMENSION
        {
            let numbers: Vec<f32> = signed(others).collect();
            let others = DMatrixView::from_slice(&numbers, *dimension, others_norms.len()).transpose();
            let mut dots = DMatrix::zeros(others.nrows(), BLOCK);
            for (block, bytes) in data.chunks(BLOCK * dimension).enumerate() {
                let own = DMatrix::from_iterator(*dimension, bytes.len() / dimension, signed(bytes));
                let mut dots = dots.columns_mut(0, own.ncols());
                dots.gemm(1.0, &others, &own, 0.0);
                for (offset, mut column) in dots.column_iter_mut().enumerate() {
                    let index = block * BLOCK + offset;
                    for (dot, norm) in column.iter_mut().zip(others_norms) {
                        *dot = int8_distance(*dot, inverse_norms[index], *norm);
                    }
                    visit(index, column.as_slice());
                }
            }
            return;
        }
        let mut row = Vec::with_capacity(others.len());
        for index in 0..self.len() {
            self.distances_to(index, others, 0..others.len(), &mut row);
            visit(index, &row);
        }
    }
}

/// Scalar product of signed bytes of which one side was widened before, exact like [`super::descriptors::dot_int8`].
fn dot_widened(a: &[i16], b: &[u8]) -> i32 {
    let product = |(x, y): (&i16, &u8)| i32::from(*x) * i32::from(i16::from(y.cast_signed()));
    a.iter().zip(b).map(product).sum()
}

/// Sums in eight lanes, which the compiler turns into vector instructions (a plain sum must keep its order).
fn lanes(a: &[f32], b: &[f32], term: impl Fn(f32, f32) -> f32) -> f32 {
    let (blocks_a, rest_a) = a.as_chunks::<8>();
    let (blocks_b, rest_b) = b.as_chunks::<8>();
    let mut sums = [0.0; 8];
    for (x, y) in blocks_a.iter().zip(blocks_b) {
        for lane in 0..8 {
            sums[lane] += term(x[lane], y[lane]);
        }
    }
    sums.iter().sum::<f32>() + rest_a.iter().zip(rest_b).map(|(x, y)| term(*x, *y)).sum::<f32>()
}

fn dot(a: &[f32], b: &[f32]) -> f32 {
    lanes(a, b, |x, y| x * y)
}

fn euclidean(a: &[f32], b: &[f32]) -> f32 {
    number_or_infinite(lanes(a, b, |x, y| (x - y) * (x - y)).sqrt())
}
