//! Products of a matrix with many vectors: layers at single cells.

use super::multiply_add;
use pulp::{Arch, Scalar128b, Simd, WithSimd};

/// Vectors that are multiplied together.
const TOGETHER: usize = 4;
/// Outputs that are computed together.
const BLOCK: usize = 16;

/// A matrix, and a bias of each row.
#[derive(Clone, Debug)]
pub struct Matrix {
    inputs: usize,
    outputs: usize,
    /// Of each block of outputs the weights of each input.
    weights: Vec<[f32; BLOCK]>,
    bias: Vec<[f32; BLOCK]>,
}

impl Matrix {
    /// Arranges a matrix of which each row holds the weights of an output.
    ///
    /// # Panics
    /// If there are not as many rows as biases, or their number is no multiple of 16.
    pub fn new(rows: &[f32], bias: &[f32]) -> Self {
        let (outputs, inputs) = (bias.len(), rows.len() / bias.len());
        assert!(outputs.is_multiple_of(BLOCK) && rows.len() == outputs * inputs, "blocks of {BLOCK} outputs");
        let weights = (0..outputs / BLOCK * inputs).map(|at| {
            let (first, input) = (at / inputs * BLOCK, at % inputs);
            std::array::from_fn(|output| rows[(first + output) * inputs + input])
        });
        let weights = weights.collect();
        Self { inputs, outputs, weights, bias: bias.as_chunks().0.to_vec() }
    }

    /// Number of outputs.
    pub fn outputs(&self) -> usize {
        self.outputs
    }

    /// Multiplies vectors that stand one after the other, and adds the bias; the products replace `products`.
    pub fn multiply(&self, vectors: &[f32], products: &mut Vec<f32>) {
        products.clear();
        products.resize(vectors.len() / self.inputs * self.outputs, 0.0);
        let work = Work { matrix: self, vectors, products };
        match Arch::new() {
            Arch::Scalar => Scalar128b.vectorize(Product::<false>(work)),
            arch => arch.dispatch(Product::<true>(work)),
        }
    }
}

struct Work<'a> {
    matrix: &'a Matrix,
    vectors: &'a [f32],
    products: &'a mut [f32],
}

struct Product<'a, const FUSED: bool>(Work<'a>);

impl<const FUSED: bool> WithSimd for Product<'_, FUSED> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Work { matrix, vectors, products } = self.0;
        let (inputs, outputs) = (matrix.inputs, matrix.outputs);
        let step = 2 * S::F32_LANES;
        let groups = vectors.chunks(TOGETHER * inputs).zip(products.chunks_mut(TOGETHER * outputs));
        for (vectors, products) in groups {
            let count = vectors.len() / inputs;
            // Fewer than four vectors: the first in place of those that are missing.
            let of = |number: usize| &vectors[if number < count { number * inputs } else { 0 }..][..inputs];
            let (a, b, c, d) = (of(0), of(1), of(2), of(3));
            for (block, bias) in matrix.bias.iter().enumerate() {
                let weights = &matrix.weights[block * inputs..][..inputs];
                for first in (0..BLOCK).step_by(step) {
                    let (bias, _) = S::as_simd_f32s(&bias[first..first + step]);
                    let mut sums = [[bias[0], bias[1]]; TOGETHER];
                    for ((((weights, a), b), c), d) in weights.iter().zip(a).zip(b).zip(c).zip(d) {
                        let (weights, _) = S::as_simd_f32s(&weights[first..first + step]);
                        for (sums, &number) in sums.iter_mut().zip([a, b, c, d]) {
                            let number = simd.splat_f32s(number);
                            sums[0] = multiply_add::<FUSED, S>(simd, number, weights[0], sums[0]);
                            sums[1] = multiply_add::<FUSED, S>(simd, number, weights[1], sums[1]);
                        }
                    }
                    let rows = products.chunks_exact_mut(outputs).zip(sums);
                    for (row, sums) in rows {
                        let (row, _) = S::as_mut_simd_f32s(&mut row[block * BLOCK + first..][..step]);
                        row.copy_from_slice(&sums);
                    }
                }
            }
        }
    }
}
