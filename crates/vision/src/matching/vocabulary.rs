//! Visual vocabulary: descriptors quantized to visual words.
//!
//! Words are unit vectors found by spherical k-means; a descriptor is assigned to the word of largest cosine
//! similarity. Bits are mapped to +1 and -1: the cosine of two such vectors is `1 - 2 h`, with `h` the fraction of bits
//! that differ, so the order is that of the Hamming distance.
//!
//! Sources: Sivic & Zisserman, "Video Google", ICCV 2003; Dhillon & Modha, "Concept decompositions for large sparse
//! text data using clustering", Machine Learning 2001 (spherical k-means).

use super::descriptors::{DescriptorView, Metric, floats, signed};
use nalgebra::DMatrix;

/// Iterations of k-means. Queries probe several words, so full convergence brings nothing.
const ITERATIONS: usize = 6;

/// Descriptors per matrix product: 1024 x 256 numbers stay in the second-level cache.
const BLOCK: usize = 256;

/// Visual words of one metric and dimension.
#[derive(Clone, Debug)]
pub(crate) struct Vocabulary {
    metric: Metric,
    /// One unit vector per row.
    centroids: DMatrix<f32>,
}

impl Vocabulary {
    /// Trains a vocabulary on descriptors.
    ///
    /// Deterministic on machines of one kind: the initial centroids are descriptors at equal steps through the sample.
    ///
    /// # Arguments
    /// * `sample`: not empty.
    /// * `count`: number of words, at least 1; never more than there are descriptors.
    pub(crate) fn train(sample: DescriptorView<'_>, count: usize) -> Self {
        let count = count.clamp(1, sample.len().max(1));
        let first: Vec<usize> = (0..count).map(|word| word * sample.len() / count).collect();
        let dimension = dimension(&sample);
        let mut centroids = DMatrix::zeros(count, dimension);
        for (word, &index) in first.iter().enumerate() {
            let numbers = unit_numbers(sample.metric(), sample.get(index).unwrap_or_default());
            for (column, &number) in numbers.iter().enumerate() {
                centroids[(word, column)] = number;
            }
        }
        let mut vocabulary = Self { metric: sample.metric(), centroids };
        for _ in 0..ITERATIONS {
            let mut sums = DMatrix::<f32>::zeros(count, dimension);
            vocabulary.for_each_block(sample, |_, block, scores| {
                for (numbers, scores) in block.column_iter().zip(scores.column_iter()) {
                    let word = scores.imax();
                    for (column, &number) in numbers.iter().enumerate() {
                        sums[(word, column)] += number;
                    }
                }
            });
            for (mut row, sum) in vocabulary.centroids.row_iter_mut().zip(sums.row_iter()) {
                let norm = sum.norm();
                // The centroid of an empty cluster stays.
                if norm > 0.0 {
                    row.copy_from(&(sum / norm));
                }
            }
        }
        vocabulary
    }

    /// Number of words.
    pub(crate) fn len(&self) -> usize {
        self.centroids.nrows()
    }

    /// The `count` nearest words of every descriptor, nearest first: `count` (at most [`Self::len`]) word indices each.
    pub(crate) fn nearest(&self, descriptors: DescriptorView<'_>, count: usize) -> Vec<u32> {
        let count = count.min(self.len());
        let mut nearest = Vec::with_capacity(count * descriptors.len());
        let mut ranked: Vec<(f32, u32)> = Vec::with_capacity(count + 1);
        self.for_each_block(descriptors, |_, _, scores| {
            for column in scores.column_iter() {
                ranked.clear();
                let mut least = f32::NEG_INFINITY;
                for (word, &score) in column.iter().enumerate() {
                    if ranked.len() < count || score > least {
                        let at = ranked.partition_point(|&(better, _)| better >= score);
                        ranked.insert(at, (score, word as u32));
                        ranked.truncate(count);
                        least = ranked[ranked.len() - 1].0;
                    }
                }
                nearest.extend(ranked.iter().map(|&(_, word)| word));
            }
        });
        nearest
    }

    /// Calls `visit` for every block of descriptors: index of its first descriptor, the unit vectors (one per column),
    /// and the cosines with all words (one column per descriptor).
    fn for_each_block(
        &self,
        descriptors: DescriptorView<'_>,
        mut visit: impl FnMut(usize, &DMatrix<f32>, &DMatrix<f32>),
    ) {
        let dimension = self.centroids.ncols();
        for (number, chunk) in descriptors.bytes().chunks(BLOCK * descriptors.width()).enumerate() {
            let count = chunk.len() / descriptors.width();
            let numbers = chunk.chunks_exact(descriptors.width());
            let numbers: Vec<f32> = numbers.flat_map(|bytes| unit_numbers(self.metric, bytes)).collect();
            let block = DMatrix::from_vec(dimension, count, numbers);
            visit(number * BLOCK, &block, &(&self.centroids * &block));
        }
    }
}

/// Dimension of the descriptors as vectors.
fn dimension(view: &DescriptorView<'_>) -> usize {
    match view.metric() {
        Metric::Hamming => 8 * view.width(),
        Metric::Cosine | Metric::Euclidean => view.width() / 4,
        Metric::CosineInt8 => view.width(),
    }
}

/// A descriptor as a unit vector; a zero vector where its norm is zero or not finite.
fn unit_numbers(metric: Metric, bytes: &[u8]) -> Vec<f32> {
    let mut numbers: Vec<f32> = match metric {
        Metric::Hamming => {
            let bit = |byte: u8, bit: u8| if byte >> bit & 1 == 1 { 1.0 } else { -1.0 };
            bytes.iter().flat_map(|&byte| (0..8).map(move |at| bit(byte, at))).collect()
        }
        Metric::Cosine | Metric::Euclidean => floats(bytes).collect(),
        Metric::CosineInt8 => signed(bytes).collect(),
    };
    let norm = numbers.iter().map(|number| number * number).sum::<f32>().sqrt();
    let scale = if norm.is_finite() && norm > 0.0 { 1.0 / norm } else { 0.0 };
    for number in &mut numbers {
        *number = if scale > 0.0 { *number * scale } else { 0.0 };
    }
    numbers
}
