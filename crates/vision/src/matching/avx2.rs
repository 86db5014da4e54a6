//! Scalar products of signed bytes by the instructions of AVX2.
//!
//! Of the portable loop the compiler makes instructions half as wide; 500 x 300 products of 64 bytes took 0.38 ms that way,
//! and take 0.20 ms here.

use core::arch::x86_64::{__m128i, __m256i};

use pulp::x86::V3;
use pulp::{NullaryFnOnce, cast};

use super::kernels::int8_product;

/// Bytes in a vector.
const LANES: usize = 16;
/// Descriptors whose sums are added across their lanes together.
const TOGETHER: usize = 4;

/// See [`super::kernels::int8_products`].
///
/// # Returns
/// `false`, with nothing done, where the processor has no AVX2 or the width is no multiple of 16 bytes.
pub(super) fn int8_products(own: &[i16], others: &[u8], row: &mut Vec<f32>) -> bool {
    let (blocks, []) = own.as_chunks::<LANES>() else { return false };
    let Some(simd) = V3::try_new() else { return false };
    row.clear();
    row.resize(others.len() / own.len(), 0.0);
    simd.vectorize(Products { simd, own: blocks, others, row });
    let (_, last) = row.as_chunks_mut::<TOGETHER>();
    let first = others.len() - last.len() * own.len();
    for (product, other) in last.iter_mut().zip(others[first..].chunks_exact(own.len())) {
        *product = int8_product(own, other) as f32;
    }
    true
}

struct Products<'a> {
    simd: V3,
    own: &'a [[i16; LANES]],
    others: &'a [u8],
    row: &'a mut [f32],
}

impl NullaryFnOnce for Products<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let (avx, avx2) = (self.simd.avx, self.simd.avx2);
        let width = self.own.len();
        let (blocks, _) = self.others.as_chunks::<LANES>();
        let (products, _) = self.row.as_chunks_mut::<TOGETHER>();
        for (products, others) in products.iter_mut().zip(blocks.chunks_exact(TOGETHER * width)) {
            let mut sums = [avx._mm256_setzero_si256(); TOGETHER];
            for (at, own) in self.own.iter().enumerate() {
                let own: __m256i = cast(*own);
                for (number, sum) in sums.iter_mut().enumerate() {
                    let other: __m128i = cast(others[number * width + at]);
                    let pairs = avx2._mm256_madd_epi16(own, avx2._mm256_cvtepi8_epi16(other));
                    *sum = avx2._mm256_add_epi32(*sum, pairs);
                }
            }
            let [a, b, c, d] = sums;
            let halves = avx2._mm256_hadd_epi32(avx2._mm256_hadd_epi32(a, b), avx2._mm256_hadd_epi32(c, d));
            let halves: [i32; 2 * TOGETHER] = cast(halves);
            for (lane, product) in products.iter_mut().enumerate() {
                *product = (halves[lane] + halves[lane + TOGETHER]) as f32;
            }
        }
    }
}
