//! Loops over many descriptors, compiled for the vector instructions that the processor has.
//!
//! A program for every x86-64 may use SSE2 only. [`pulp`] compiles what is inlined into [`NullaryFnOnce::call`] for AVX2 too,
//! and chooses when it runs. All of it is `inline(always)`: a function that is called instead would use SSE2.

use pulp::{Arch, NullaryFnOnce};

use super::descriptors::int8_distance;

#[cfg(target_arch = "x86_64")]
use super::avx2;

/// Compares one descriptor with others.
pub(super) trait Comparison {
    /// What descriptors consist of.
    type Element;

    /// The result for another descriptor of the same width.
    fn with(&self, other: &[Self::Element]) -> f32;
}

/// Replaces the contents of `row` by the results for each of `others`, of `width` elements each.
pub(super) fn compare_each<C: Comparison>(
    comparison: &C,
    others: &[C::Element],
    width: usize,
    row: &mut Vec<f32>,
) {
    Arch::new().dispatch(Row { comparison, others, width, results: row });
}

struct Row<'a, C: Comparison> {
    comparison: &'a C,
    others: &'a [C::Element],
    width: usize,
    results: &'a mut Vec<f32>,
}

impl<C: Comparison> NullaryFnOnce for Row<'_, C> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        self.results.clear();
        self.results.resize(self.others.len() / self.width, 0.0);
        // Where the compiler knows the width, it unrolls the loop over a descriptor.
        match self.width {
            4 => self.fill::<4>(),
            64 => self.fill::<64>(),
            128 => self.fill::<128>(),
            width => {
                for (result, other) in self.results.iter_mut().zip(self.others.chunks_exact(width)) {
                    *result = self.comparison.with(other);
                }
            }
        }
    }
}

impl<C: Comparison> Row<'_, C> {
    #[inline(always)]
    fn fill<const WIDTH: usize>(self) {
        for (result, other) in self.results.iter_mut().zip(self.others.as_chunks::<WIDTH>().0) {
            *result = self.comparison.with(other);
        }
    }
}

/// The number of bits that differ.
pub(super) struct FlippedBits<'a> {
    pub(super) own: &'a [u64],
}

impl Comparison for FlippedBits<'_> {
    type Element = u64;

    #[inline(always)]
    fn with(&self, other: &[u64]) -> f32 {
        let own = &self.own[..other.len()];
        own.iter().zip(other).map(|(x, y)| (x ^ y).count_ones()).sum::<u32>() as f32
    }
}

/// Turns numbers of bits into fractions of so many: by itself, since divisions one by one take longer than counting.
pub(super) fn fractions(counts: &mut [f32], bits: f32) {
    Arch::new().dispatch(Fractions { counts, bits });
}

struct Fractions<'a> {
    counts: &'a mut [f32],
    bits: f32,
}

impl NullaryFnOnce for Fractions<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        self.counts.iter_mut().for_each(|count| *count /= self.bits);
    }
}

/// Replaces the contents of `row` by the scalar products of signed bytes with each of `others`, exact up to 2^17 bytes. Those
/// of one side were widened before.
pub(super) fn int8_products(own: &[i16], others: &[u8], row: &mut Vec<f32>) {
    #[cfg(target_arch = "x86_64")]
    if avx2::int8_products(own, others, row) {
        return;
    }
    compare_each(&Int8DotProduct { own }, others, own.len(), row);
}

struct Int8DotProduct<'a> {
    own: &'a [i16],
}

impl Comparison for Int8DotProduct<'_> {
    type Element = u8;

    #[inline(always)]
    fn with(&self, other: &[u8]) -> f32 {
        int8_product(self.own, other) as f32
    }
}

#[inline(always)]
pub(super) fn int8_product(own: &[i16], other: &[u8]) -> i32 {
    let product = |(x, y): (&i16, &u8)| i32::from(*x) * i32::from(i16::from(y.cast_signed()));
    own.iter().zip(other).map(product).sum()
}

/// Turns scalar products of signed bytes into cosine distances, see [`super::descriptors::int8_distance`].
///
/// # Arguments
/// * `inverse_norm`, `inverse_norms`: of the one descriptor and of the others.
pub(super) fn int8_distances(products: &mut [f32], inverse_norm: f32, inverse_norms: &[f32]) {
    Arch::new().dispatch(Int8Distances { products, inverse_norm, inverse_norms });
}

struct Int8Distances<'a> {
    products: &'a mut [f32],
    inverse_norm: f32,
    inverse_norms: &'a [f32],
}

impl NullaryFnOnce for Int8Distances<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        for (product, norm) in self.products.iter_mut().zip(self.inverse_norms) {
            *product = int8_distance(*product, self.inverse_norm, *norm);
        }
    }
}

/// The smallest of many distances and the next, infinite where there is none. They are equal where two are.
pub(super) fn two_least(distances: &[f32]) -> (f32, f32) {
    Arch::new().dispatch(TwoLeast(distances))
}

struct TwoLeast<'a>(&'a [f32]);

impl NullaryFnOnce for TwoLeast<'_> {
    type Output = (f32, f32);

    #[inline(always)]
    fn call(self) -> (f32, f32) {
        let (blocks, rest) = self.0.as_chunks::<LANES>();
        let mut last = [f32::INFINITY; LANES];
        last[..rest.len()].copy_from_slice(rest);
        let mut both = ([f32::INFINITY; LANES], [f32::INFINITY; LANES]);
        for block in blocks {
            both = two_least_of(both, (*block, [f32::INFINITY; LANES]));
        }
        let (least, second) = two_least_of(both, (last, [f32::INFINITY; LANES]));
        // Halves are merged as vectors.
        let (least, second) = two_least_of(half::<LANES, 8>(0, least, second), half(1, least, second));
        let (least, second) = two_least_of(half::<8, 4>(0, least, second), half(1, least, second));
        let (least, second) = two_least_of(half::<4, 2>(0, least, second), half(1, least, second));
        let ([least], [second]) = two_least_of(half::<2, 1>(0, least, second), half(1, least, second));
        (least, second)
    }
}

/// By lane, the two least of four numbers, given by pairs whose first is not larger than the second. None of those in `old` is a
/// NaN, and of NaNs in `new` none is taken.
#[inline(always)]
fn two_least_of<const N: usize>(
    old: ([f32; N], [f32; N]),
    new: ([f32; N], [f32; N]),
) -> ([f32; N], [f32; N]) {
    let mut both = old;
    for lane in 0..N {
        let second = smaller(new.1[lane], old.1[lane]);
        both.1[lane] = smaller(larger(new.0[lane], old.0[lane]), second);
        both.0[lane] = smaller(new.0[lane], old.0[lane]);
    }
    both
}

/// The first or the second half of the lanes.
#[inline(always)]
fn half<const N: usize, const HALF: usize>(
    which: usize,
    least: [f32; N],
    second: [f32; N],
) -> ([f32; HALF], [f32; HALF]) {
    let mut both = ([0.0; HALF], [0.0; HALF]);
    both.0.copy_from_slice(&least[which * HALF..][..HALF]);
    both.1.copy_from_slice(&second[which * HALF..][..HALF]);
    both
}

/// Numbers in a vector of AVX2, twice: additions of one wait for those of the other.
const LANES: usize = 16;

/// Comparisons rather than `min` and `max`, which do not become one instruction.
#[inline(always)]
fn smaller(new: f32, old: f32) -> f32 {
    if new < old { new } else { old }
}

/// NaN for a NaN, which no comparison takes.
#[inline(always)]
fn larger(new: f32, old: f32) -> f32 {
    if new < old { old } else { new }
}

/// Where `row` is less than `least`, replaces that, and the index beside it by `index`.
pub(super) fn update_least(row: &[f32], index: u32, least: &mut [f32], indices: &mut [u32]) {
    Arch::new().dispatch(UpdateLeast { row, index, least, indices });
}

struct UpdateLeast<'a> {
    row: &'a [f32],
    index: u32,
    least: &'a mut [f32],
    indices: &'a mut [u32],
}

impl NullaryFnOnce for UpdateLeast<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let (rows, row) = self.row.as_chunks::<LANES>();
        let (leasts, least) = self.least.as_chunks_mut::<LANES>();
        let (indices, index) = self.indices.as_chunks_mut::<LANES>();
        for ((row, least), index) in rows.iter().zip(leasts).zip(indices) {
            // Copies: of a choice between two places the compiler makes no vector instruction.
            let (old, old_index) = (*least, *index);
            for lane in 0..LANES {
                least[lane] = smaller(row[lane], old[lane]);
                index[lane] = if row[lane] < old[lane] { self.index } else { old_index[lane] };
            }
        }
        for ((&distance, least), index) in row.iter().zip(least).zip(index) {
            if distance < *least {
                (*least, *index) = (distance, self.index);
            }
        }
    }
}

/// The scalar product.
pub(super) struct DotProduct<'a> {
    pub(super) own: &'a [f32],
}

impl Comparison for DotProduct<'_> {
    type Element = f32;

    #[inline(always)]
    fn with(&self, other: &[f32]) -> f32 {
        lanes(self.own, other, |x, y| x * y)
    }
}

/// The length of the difference.
pub(super) struct Euclidean<'a> {
    pub(super) own: &'a [f32],
}

impl Comparison for Euclidean<'_> {
    type Element = f32;

    #[inline(always)]
    fn with(&self, other: &[f32]) -> f32 {
        lanes(self.own, other, |x, y| (x - y) * (x - y)).sqrt()
    }
}

/// Sums in sixteen lanes, which become vectors (a plain sum of `f32` must keep its order).
#[inline(always)]
fn lanes(a: &[f32], b: &[f32], term: impl Fn(f32, f32) -> f32) -> f32 {
    let a = &a[..b.len()];
    let (blocks_a, rest_a) = a.as_chunks::<16>();
    let (blocks_b, rest_b) = b.as_chunks::<16>();
    let mut sums = [0.0; 16];
    for (x, y) in blocks_a.iter().zip(blocks_b) {
        for ((sum, x), y) in sums.iter_mut().zip(x).zip(y) {
            *sum += term(*x, *y);
        }
    }
    // Halves are added as vectors.
    let eight: [f32; 8] = std::array::from_fn(|lane| sums[lane] + sums[lane + 8]);
    let four: [f32; 4] = std::array::from_fn(|lane| eight[lane] + eight[lane + 4]);
    let sum = (four[0] + four[2]) + (four[1] + four[3]);
    sum + rest_a.iter().zip(rest_b).map(|(x, y)| term(*x, *y)).sum::<f32>()
}
