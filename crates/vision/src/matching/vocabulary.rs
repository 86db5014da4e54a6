//! Visual vocabulary: descriptors quantized to visual words, found through groups of words.
//!
//! Words are unit vectors found by spherical k-means; a descriptor is assigned to the word of largest cosine
//! similarity. Bits are mapped to +1 and -1: the cosine of two such vectors is `1 - 2 h`, with `h` the fraction of bits
//! that differ, so the order is that of the Hamming distance.
//!
//! Comparing a descriptor with each of 2048 words costs more than all else in a query. So the words themselves are grouped
//! by k-means, and only those of the [`GROUP_PROBES`] nearest groups are compared.
//!
//! Sources: Sivic & Zisserman, "Video Google", ICCV 2003; Dhillon & Modha, "Concept decompositions for large sparse
//! text data using clustering", Machine Learning 2001 (spherical k-means); Nister & Stewenius, "Scalable recognition with a
//! vocabulary tree", CVPR 2006.

use std::ops::Range;

use nalgebra::{DMatrix, DMatrixView};
use serde::{Deserialize, Serialize};

use super::descriptors::{DescriptorView, Metric, floats, inverse_norm_int8, normalize, signed};
use super::kernels::int8_products;

/// Iterations of k-means. Queries probe several words, so full convergence brings nothing.
const ITERATIONS: usize = 6;
/// Descriptors per matrix product: 1024 x 256 numbers stay in the second-level cache.
const BLOCK: usize = 256;
/// Groups of words whose words are compared with a descriptor.
const GROUP_PROBES: usize = 8;

/// Visual words of one metric and dimension.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Vocabulary {
    metric: Metric,
    /// Each with at least one word.
    groups: RoundedVectors,
    /// The words of group `at` are `starts[at]..starts[at + 1]`.
    starts: Vec<u32>,
    words: RoundedVectors,
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
        let mut vectors = Centroids { dimension: dimension(&sample), numbers: Vec::new() };
        for descriptor in &sample {
            push_unit_numbers(sample.metric(), descriptor, &mut vectors.numbers);
        }
        let words = k_means(&vectors, count.clamp(1, sample.len().max(1)));
        let groups = k_means(&words, words.len().isqrt().max(1));
        let group_of = nearest_centroids(&groups, &words);
        let mut order: Vec<u32> = (0..words.len() as u32).collect();
        order.sort_by_key(|&word| group_of[word as usize]);
        let mut starts = vec![0];
        let mut vocabulary = Self {
            metric: sample.metric(),
            groups: RoundedVectors::new(words.dimension),
            starts: Vec::new(),
            words: RoundedVectors::new(words.dimension),
        };
        for members in order.chunk_by(|&a, &b| group_of[a as usize] == group_of[b as usize]) {
            vocabulary.groups.push(groups.get(group_of[members[0] as usize] as usize));
            for &word in members {
                vocabulary.words.push(words.get(word as usize));
            }
            starts.push(vocabulary.words.len() as u32);
        }
        vocabulary.starts = starts;
        vocabulary
    }

    /// Number of words.
    pub(crate) fn len(&self) -> usize {
        self.words.len()
    }

    /// Finds the `count` nearest words of every descriptor, among those of the nearest groups.
    ///
    /// # Arguments
    /// * `visit`: called for each descriptor in order with its index and the indices of at most `count` words, nearest first.
    pub(crate) fn for_each_nearest(
        &self,
        descriptors: DescriptorView<'_>,
        count: usize,
        mut visit: impl FnMut(usize, &[u32]),
    ) {
        let (mut numbers, mut rounded, mut cosines) = (Vec::new(), Vec::new(), Vec::new());
        let (mut groups, mut words) = (Nearest::new(GROUP_PROBES), Nearest::new(count));
        let mut nearest = Vec::with_capacity(count);
        for (index, descriptor) in descriptors.iter().enumerate() {
            rounded.clear();
            if self.metric == Metric::Hamming {
                rounded.extend(descriptor.iter().flat_map(|&byte| SIGNS_OF_BITS[usize::from(byte)]));
            } else {
                numbers.clear();
                push_unit_numbers(self.metric, descriptor, &mut numbers);
                rounded.extend(round(&numbers).map(i16::from));
            }
            groups.ranked.clear();
            self.groups.cosines(0..self.groups.len(), &rounded, &mut cosines);
            groups.add(&cosines, 0);
            words.ranked.clear();
            for &(_, group) in &groups.ranked {
                let [first, end] = [group, group + 1].map(|at| self.starts[at as usize]);
                self.words.cosines(first as usize..end as usize, &rounded, &mut cosines);
                words.add(&cosines, first);
            }
            nearest.clear();
            nearest.extend(words.ranked.iter().map(|&(_, word)| word));
            visit(index, &nearest);
        }
    }
}

/// Vectors rounded to signed bytes, which are compared four times as fast.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct RoundedVectors {
    dimension: usize,
    #[serde(with = "serde_bytes")]
    bytes: Vec<u8>,
    /// 1 over the norm of each.
    inverse_norms: Vec<f32>,
}

impl RoundedVectors {
    fn new(dimension: usize) -> Self {
        Self { dimension, bytes: Vec::new(), inverse_norms: Vec::new() }
    }

    fn push(&mut self, vector: &[f32]) {
        let start = self.bytes.len();
        self.bytes.extend(round(vector).map(i8::cast_unsigned));
        self.inverse_norms.push(inverse_norm_int8(&self.bytes[start..]));
    }

    fn len(&self) -> usize {
        self.inverse_norms.len()
    }

    /// The cosines of some of them with another vector, times a factor that is the same for all.
    fn cosines(&self, range: Range<usize>, vector: &[i16], cosines: &mut Vec<f32>) {
        let bytes = &self.bytes[range.start * self.dimension..range.end * self.dimension];
        int8_products(vector, bytes, cosines);
        cosines.iter_mut().zip(&self.inverse_norms[range]).for_each(|(cosine, norm)| *cosine *= norm);
    }
}

/// Scales a vector so that its largest number is 127, and rounds it.
fn round(vector: &[f32]) -> impl Iterator<Item = i8> {
    let largest = vector.iter().fold(0.0_f32, |largest, number| largest.max(number.abs()));
    let scale = if largest > 0.0 { 127.0 / largest } else { 0.0 };
    // Not `round`, which is a function call where the processor may be of any kind.
    vector.iter().map(move |number| (number * scale + 0.5_f32.copysign(*number)) as i8)
}

/// The eight bits of a byte as what [`round`] makes of their unit vector.
static SIGNS_OF_BITS: [[i16; 8]; 256] = signs_of_bits();

const fn signs_of_bits() -> [[i16; 8]; 256] {
    let mut signs = [[-127; 8]; 256];
    let mut at = 0;
    while at < 8 * 256 {
        if (at / 8) >> (at % 8) & 1 == 1 {
            signs[at / 8][at % 8] = 127;
        }
        at += 1;
    }
    signs
}

/// Unit vectors, one after the other.
struct Centroids {
    dimension: usize,
    numbers: Vec<f32>,
}

impl Centroids {
    fn len(&self) -> usize {
        self.numbers.len() / self.dimension
    }

    fn get(&self, at: usize) -> &[f32] {
        &self.numbers[at * self.dimension..(at + 1) * self.dimension]
    }
}

/// The largest cosines so far with their indices, largest first; of equal ones the first that was added.
struct Nearest {
    count: usize,
    ranked: Vec<(f32, u32)>,
}

impl Nearest {
    fn new(count: usize) -> Self {
        Self { count, ranked: Vec::with_capacity(count + 1) }
    }

    /// Adds cosines whose indices begin with `first`.
    fn add(&mut self, cosines: &[f32], first: u32) {
        let mut least = self.least();
        for (index, &cosine) in (first..).zip(cosines) {
            if cosine > least {
                let at = self.ranked.partition_point(|&(better, _)| better >= cosine);
                self.ranked.insert(at, (cosine, index));
                self.ranked.truncate(self.count);
                least = self.least();
            }
        }
    }

    /// What a cosine must exceed.
    fn least(&self) -> f32 {
        if self.ranked.len() < self.count { f32::NEG_INFINITY } else { self.ranked[self.count - 1].0 }
    }
}

/// Spherical k-means: `count` unit vectors, the means of the vectors that are nearest to them.
///
/// # Arguments
/// * `vectors`: at least `count`.
fn k_means(vectors: &Centroids, count: usize) -> Centroids {
    let dimension = vectors.dimension;
    let first = (0..count).flat_map(|word| vectors.get(word * vectors.len() / count));
    let mut centroids = Centroids { dimension, numbers: first.copied().collect() };
    for _ in 0..ITERATIONS {
        let mut sums = vec![0.0_f32; centroids.numbers.len()];
        let nearest = nearest_centroids(&centroids, vectors);
        for (vector, nearest) in vectors.numbers.chunks_exact(dimension).zip(nearest) {
            let sum = &mut sums[nearest as usize * dimension..][..dimension];
            sum.iter_mut().zip(vector).for_each(|(sum, number)| *sum += number);
        }
        for (centroid, sum) in
            centroids.numbers.chunks_exact_mut(dimension).zip(sums.chunks_exact_mut(dimension))
        {
            // The centroid of an empty cluster stays.
            if sum.iter().any(|&number| number != 0.0) {
                normalize(sum);
                centroid.copy_from_slice(sum);
            }
        }
    }
    centroids
}

/// Index of the nearest centroid of each vector.
fn nearest_centroids(centroids: &Centroids, vectors: &Centroids) -> Vec<u32> {
    let dimension = centroids.dimension;
    let by_row = DMatrixView::from_slice(&centroids.numbers, dimension, centroids.len()).transpose();
    let mut nearest = Vec::with_capacity(vectors.len());
    for block in vectors.numbers.chunks(BLOCK * dimension) {
        let block = DMatrixView::from_slice(block, dimension, block.len() / dimension);
        let cosines: DMatrix<f32> = &by_row * block;
        nearest.extend(cosines.column_iter().map(|column| column.imax() as u32));
    }
    nearest
}

/// Dimension of the descriptors as vectors.
fn dimension(view: &DescriptorView<'_>) -> usize {
    match view.metric() {
        Metric::Hamming => 8 * view.width(),
        Metric::Cosine | Metric::Euclidean => view.width() / 4,
        Metric::CosineInt8 => view.width(),
    }
}

/// Appends a descriptor as a unit vector; as a zero vector where its norm is zero or not finite.
fn push_unit_numbers(metric: Metric, bytes: &[u8], numbers: &mut Vec<f32>) {
    let start = numbers.len();
    match metric {
        Metric::Hamming => {
            let bit = |byte: u8, bit: u8| if byte >> bit & 1 == 1 { 1.0 } else { -1.0 };
            numbers.extend(bytes.iter().flat_map(|&byte| (0..8).map(move |at| bit(byte, at))));
        }
        Metric::Cosine | Metric::Euclidean => numbers.extend(floats(bytes)),
        Metric::CosineInt8 => numbers.extend(signed(bytes)),
    }
    let numbers = &mut numbers[start..];
    let norm = numbers.iter().map(|number| number * number).sum::<f32>().sqrt();
    let scale = if norm.is_finite() && norm > 0.0 { 1.0 / norm } else { 0.0 };
    for number in numbers {
        *number = if scale > 0.0 { *number * scale } else { 0.0 };
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng, rngs::StdRng};

    use super::*;

    /// Descriptors around words that are themselves in groups, as textures are.
    fn textures(count: usize) -> Vec<u8> {
        let mut random = StdRng::seed_from_u64(8);
        let mut vector =
            |size: f32| -> Vec<f32> { (0..64).map(|_| random.random_range(-size..size)).collect() };
        let kinds: Vec<Vec<f32>> = (0..600).map(|_| vector(60.0)).collect();
        let near = (0..count).flat_map(|at| {
            let noise = vector(40.0);
            kinds[at % kinds.len()].iter().zip(noise).map(|(x, y)| (x + y) as i8).collect::<Vec<_>>()
        });
        near.map(i8::cast_unsigned).collect()
    }

    #[test]
    fn the_words_found_through_groups_are_mostly_the_nearest_of_all() {
        let bytes = textures(12_000);
        let view = DescriptorView::new(Metric::CosineInt8, 64, &bytes).unwrap();
        let vocabulary = Vocabulary::train(view, 400);
        assert!(vocabulary.len() == 400 && vocabulary.groups.len() > GROUP_PROBES);
        let (mut first, mut both) = (0, 0);
        vocabulary.for_each_nearest(view, 2, |index, found| {
            let own: Vec<i16> = view.get(index).unwrap().iter().map(|x| x.cast_signed().into()).collect();
            let mut cosines = Vec::new();
            vocabulary.words.cosines(0..400, &own, &mut cosines);
            let mut all: Vec<u32> = (0..400).collect();
            all.sort_by(|&a, &b| cosines[b as usize].total_cmp(&cosines[a as usize]));
            first += usize::from(found[0] == all[0]);
            both += usize::from(found[..2] == all[..2]);
        });
        // The descriptors of a kind are spread over words of several groups.
        assert!(first >= 11_400 && both >= 9_000, "{first} and {both} of 12000");
    }
}
