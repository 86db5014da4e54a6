//! Scalar products of signed bytes, all of one set with all of another, by the instructions of AVX2.
//!
//! Descriptors of one set are interleaved so that a vector holds the same two numbers of eight of them: sums need not be added
//! across their lanes, and what was loaded serves several descriptors of the other set.

use core::arch::x86_64::__m256i;

use pulp::x86::V3;
use pulp::{NullaryFnOnce, cast};

/// Descriptors whose numbers are in one vector.
const LANES: usize = 8;
/// Descriptors that are interleaved together: two vectors.
const GROUP: usize = 2 * LANES;
/// Descriptors of the other set that are compared at once.
const ROWS: usize = 4;

/// Descriptors of signed bytes, interleaved; and memory for comparing them, which is allocated once.
pub(super) struct Interleaved {
    simd: V3,
    /// Bytes in a descriptor, an even number.
    width: usize,
    /// Number of descriptors.
    count: usize,
    /// By group, then by pair of numbers: those of the first eight descriptors, those of the next eight. The last group is
    /// filled with zeros.
    pairs: Vec<[[i16; GROUP]; 2]>,
    /// Of the descriptors that are compared with these, by pair of numbers.
    own: Vec<[i32; ROWS]>,
    /// The results of each of them.
    rows: [Vec<f32>; ROWS],
}

impl Interleaved {
    /// For descriptors of `width` bytes.
    ///
    /// # Returns
    /// `None` where the processor has no AVX2 or the width is odd.
    pub(super) fn new(width: usize) -> Option<Interleaved> {
        let simd = V3::try_new().filter(|_| width.is_multiple_of(2))?;
        let (pairs, rows) = (Vec::new(), [(); ROWS].map(|()| Vec::new()));
        Some(Interleaved { simd, width, count: 0, pairs, own: vec![[0; ROWS]; width / 2], rows })
    }

    /// Replaces the descriptors.
    pub(super) fn fill(&mut self, bytes: &[u8]) {
        let width = self.width;
        self.count = bytes.len() / width;
        self.pairs.clear();
        self.pairs.resize(self.count.div_ceil(GROUP) * width / 2, [[0; GROUP]; 2]);
        for row in &mut self.rows {
            row.resize(self.count.next_multiple_of(GROUP), 0.0);
        }
        for (group, descriptors) in self.pairs.chunks_exact_mut(width / 2).zip(bytes.chunks(GROUP * width)) {
            for (at, descriptor) in descriptors.chunks_exact(width).enumerate() {
                let (half, lane) = (at / LANES, at % LANES);
                for (pair, &[first, second]) in group.iter_mut().zip(descriptor.as_chunks().0) {
                    pair[half][2 * lane] = first.cast_signed().into();
                    pair[half][2 * lane + 1] = second.cast_signed().into();
                }
            }
        }
    }

    /// Calls `visit` with the index of each descriptor of another set, in order, and its scalar products with all of these,
    /// which are exact up to 2^17 bytes.
    ///
    /// # Arguments
    /// * `others`: descriptors of the same width, one after the other.
    pub(super) fn for_each_row(&mut self, others: &[u8], mut visit: impl FnMut(usize, &mut [f32])) {
        let Interleaved { simd, width, count, pairs, own, rows } = self;
        for (block, descriptors) in others.chunks(ROWS * *width).enumerate() {
            for (row, descriptor) in descriptors.chunks_exact(*width).enumerate() {
                for (own, &pair) in own.iter_mut().zip(descriptor.as_chunks().0) {
                    own[row] = packed(pair);
                }
            }
            simd.vectorize(Products { simd: *simd, own, pairs, rows });
            // Of a last block that is not full, the other rows are those of descriptors before.
            let present = descriptors.len() / *width;
            for (row, products) in rows.iter_mut().take(present).enumerate() {
                visit(block * ROWS + row, &mut products[..*count]);
            }
        }
    }
}

/// Two signed bytes as two numbers of 16 bits.
fn packed(pair: [u8; 2]) -> i32 {
    let [first, second] = pair.map(|byte| i16::from(byte.cast_signed()));
    cast([first, second])
}

struct Products<'a> {
    simd: V3,
    /// By pair of numbers, those of each descriptor.
    own: &'a [[i32; ROWS]],
    pairs: &'a [[[i16; GROUP]; 2]],
    rows: &'a mut [Vec<f32>; ROWS],
}

impl NullaryFnOnce for Products<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let (avx, avx2) = (self.simd.avx, self.simd.avx2);
        for (number, group) in self.pairs.chunks_exact(self.own.len()).enumerate() {
            let mut sums = [[avx._mm256_setzero_si256(); 2]; ROWS];
            for (own, others) in self.own.iter().zip(group) {
                let [left, right]: [__m256i; 2] = [cast(others[0]), cast(others[1])];
                for row in 0..ROWS {
                    let own = avx._mm256_set1_epi32(own[row]);
                    let [of_left, of_right] = sums[row];
                    sums[row] = [
                        avx2._mm256_add_epi32(of_left, avx2._mm256_madd_epi16(own, left)),
                        avx2._mm256_add_epi32(of_right, avx2._mm256_madd_epi16(own, right)),
                    ];
                }
            }
            for (row, [left, right]) in self.rows.iter_mut().zip(sums) {
                let (products, _) = row[number * GROUP..].as_chunks_mut::<LANES>();
                products[0] = cast(avx._mm256_cvtepi32_ps(left));
                products[1] = cast(avx._mm256_cvtepi32_ps(right));
            }
        }
    }
}
