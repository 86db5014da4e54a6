//! A vocabulary: the words that the descriptors of a map fall into.
//!
//! Words are unit vectors found by spherical k-means; a descriptor belongs to the word with which it has the largest
//! cosine. Bits count as +1 and -1: the cosine of two such vectors is `1 - 2 h`, `h` the fraction of bits that differ,
//! so near words are near in Hamming distance too.
//!
//! Sources: Sivic & Zisserman, "Video Google", ICCV 2003; Dhillon & Modha, "Concept decompositions for large sparse
//! text data using clustering", Machine Learning 2001 (spherical k-means).

use crate::descriptors::{DescriptorView, Metric, floats, signed};
use nalgebra::DMatrix;

/// Rounds of k-means. The assignment that follows looks into several words, so the last digit is of no use.
const ROUNDS: usize = 6;

/// Descriptors that one matrix product works on: 1024 x 256 numbers stay in the second-level cache.
const BLOCK: usize = 256;

/// Words of one metric and dimension.
#[derive(Clone, Debug)]
pub(crate) struct Words {
    metric: Metric,
    /// A unit vector a row.
    rows: DMatrix<f32>,
}

impl Words {
    /// Finds words among descriptors.
    ///
    /// The same descriptors give the same words on every machine of one kind: the first words are descriptors at equal
    /// steps through the list.
    ///
    /// # Arguments
    /// * `sample`: not empty.
    /// * `count`: number of words, at least 1; never more than there are descriptors.
    pub(crate) fn train(sample: DescriptorView<'_>, count: usize) -> Self {
        let count = count.clamp(1, sample.len().max(1));
        let first: Vec<usize> = (0..count).map(|word| word * sample.len() / count).collect();
        let dimension = dimension(&sample);
        let mut rows = DMatrix::zeros(count, dimension);
        for (word, &index) in first.iter().enumerate() {
            let numbers = unit_numbers(sample.metric(), sample.get(index).unwrap_or_default());
            for (column, &number) in numbers.iter().enumerate() {
                rows[(word, column)] = number;
            }
        }
        let mut words = Self { metric: sample.metric(), rows };
        for _ in 0..ROUNDS {
            let mut sums = DMatrix::<f32>::zeros(count, dimension);
            words.for_each_block(sample, |_, block, scores| {
                for (numbers, scores) in block.column_iter().zip(scores.column_iter()) {
                    let word = scores.imax();
                    for (column, &number) in numbers.iter().enumerate() {
                        sums[(word, column)] += number;
                    }
                }
            });
            for (mut row, sum) in words.rows.row_iter_mut().zip(sums.row_iter()) {
                let norm = sum.norm();
                // A word that nothing belongs to stays where it is.
                if norm > 0.0 {
                    row.copy_from(&(sum / norm));
                }
            }
        }
        words
    }

    /// Number of words.
    pub(crate) fn len(&self) -> usize {
        self.rows.nrows()
    }

    /// The `count` nearest words of every descriptor, nearest first: `count` (at most [`Self::len`]) numbers each.
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

    /// Calls with the index of the first descriptor of a block, the block (a column a descriptor) and the cosines
    /// with all words (a column a descriptor).
    fn for_each_block(
        &self,
        descriptors: DescriptorView<'_>,
        mut visit: impl FnMut(usize, &DMatrix<f32>, &DMatrix<f32>),
    ) {
        let dimension = self.rows.ncols();
        for (number, chunk) in descriptors.bytes().chunks(BLOCK * descriptors.width()).enumerate() {
            let count = chunk.len() / descriptors.width();
            let numbers = chunk.chunks_exact(descriptors.width());
            let numbers: Vec<f32> = numbers.flat_map(|bytes| unit_numbers(self.metric, bytes)).collect();
            let block = DMatrix::from_vec(dimension, count, numbers);
            visit(number * BLOCK, &block, &(&self.rows * &block));
        }
    }
}

/// Numbers a descriptor.
fn dimension(view: &DescriptorView<'_>) -> usize {
    match view.metric() {
        Metric::Hamming => 8 * view.width(),
        Metric::Cosine | Metric::Euclidean => view.width() / 4,
        Metric::CosineInt8 => view.width(),
    }
}

/// A descriptor as a vector of norm 1; zeros, and what holds numbers that are not finite, as zeros.
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
