//! Linearized measurements: whitened rows over a few blocks of the state, or summed up in information form.

use crate::linear_algebra::NotPositiveDefinite;
use crate::linear_algebra::dense::{Dense, Factorization};
use faer::linalg::matmul::triangular::BlockStructure;
use nalgebra::{DMatrix, DVector, SMatrix, SVector};
use std::ops::Range;

/// The blocks of the error state that a measurement depends on. Its Jacobian has their columns, in this order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StateBlocks {
    /// Ranges of the active error state.
    pub active: Vec<Range<usize>>,
    /// Slots of active keyframes, 6 columns each.
    pub keyframes: Vec<usize>,
}

impl StateBlocks {
    /// Without keyframes.
    pub fn of_active(ranges: impl IntoIterator<Item = Range<usize>>) -> Self {
        Self { active: ranges.into_iter().collect(), keyframes: Vec::new() }
    }

    /// Columns of the Jacobian.
    pub fn len(&self) -> usize {
        self.active_len() + 6 * self.keyframes.len()
    }

    /// Columns that belong to the active error state; those of the keyframes follow.
    pub fn active_len(&self) -> usize {
        self.active.iter().map(Range::len).sum()
    }

    /// Whether the measurement depends on nothing.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The ranges of the active error state, each with its range of columns in the Jacobian.
    pub fn ranges(&self) -> impl Iterator<Item = (Range<usize>, Range<usize>)> + '_ {
        self.active.iter().scan(0, |begin, range| {
            let here = *begin..*begin + range.len();
            *begin = here.end;
            Some((range.clone(), here))
        })
    }
}

/// Regularization of `HᵀH` before its Cholesky factorization, relative to its diagonal.
///
/// With few rows most directions carry no information, and the factor of `HᵀH` there is rounding (1e-13 of the diagonal)
/// divided by its own square root: a single track once moved a bias by 14 sigma. The information that is added is
/// negligible: 1e-11 of a pixel's corresponds to hundreds of radians and to kilometres.
const RIDGE: f64 = 1e-11;

/// A whitened, linearized measurement `r = H e + n`, `n ~ N(0, I)`.
#[derive(Clone, Debug, Default)]
pub struct LinearizedMeasurement {
    /// The blocks of `e`.
    pub blocks: StateBlocks,
    /// `H`.
    pub jacobian: Dense,
    /// `r`.
    pub residual: Vec<f64>,
    /// Whether `H` is zero below its diagonal.
    pub upper_triangular: bool,
}

impl LinearizedMeasurement {
    /// Takes in a small measurement of active blocks, whitened by its covariance; `false` where that is not positive definite.
    ///
    /// # Arguments
    /// * `jacobian`: with the columns of the blocks; further ones are not used.
    pub fn set_whitened<const ROWS: usize, const COLUMNS: usize>(
        &mut self,
        active: &[Range<usize>],
        jacobian: &SMatrix<f64, ROWS, COLUMNS>,
        residual: &SVector<f64, ROWS>,
        covariance: SMatrix<f64, ROWS, ROWS>,
    ) -> bool {
        let Some(root) = covariance.cholesky().and_then(|factor| factor.l().try_inverse()) else {
            return false;
        };
        let jacobian = root * jacobian;
        self.blocks.keyframes.clear();
        self.blocks.active.clear();
        self.blocks.active.extend(active.iter().cloned());
        self.upper_triangular = false;
        let columns = self.blocks.active_len();
        self.jacobian.reset(ROWS, columns);
        for column in 0..columns {
            self.jacobian.column_mut(column).copy_from_slice(jacobian.column(column).as_slice());
        }
        self.residual.clear();
        self.residual.extend((root * residual).iter());
        true
    }

    /// Structure of `H` that a product can exploit.
    pub fn shape(&self) -> BlockStructure {
        if self.upper_triangular && self.blocks.active.len() == 1 && self.blocks.keyframes.is_empty() {
            BlockStructure::TriangularUpper
        } else {
            BlockStructure::Rectangular
        }
    }
}

/// Whitened measurements of the same blocks, in information form.
#[derive(Clone, Debug, Default)]
pub struct Information {
    /// The blocks.
    pub blocks: StateBlocks,
    /// `HᵀH`; only the lower triangle is read.
    pub matrix: Dense,
    /// `Hᵀr`.
    pub vector: Vec<f64>,
    /// `rᵀr`.
    pub residual: f64,
    /// Number of rows that were added.
    pub rows: usize,
}

impl Information {
    /// Zero information about `blocks`.
    pub fn new(blocks: StateBlocks) -> Self {
        let mut information = Self { blocks, ..Self::default() };
        information.clear();
        information
    }

    /// Back to zero information; takes the size of `blocks`.
    pub fn clear(&mut self) {
        let n = self.blocks.len();
        self.matrix.reset(n, n);
        self.vector.clear();
        self.vector.resize(n, 0.0);
        (self.residual, self.rows) = (0.0, 0);
    }

    /// Makes it count so many times.
    pub fn scale(&mut self, weight: f64) {
        self.matrix.view_mut().scale_mut(weight);
        self.vector.iter_mut().for_each(|value| *value *= weight);
        self.residual *= weight;
    }

    /// Adds whitened rows.
    ///
    /// # Arguments
    /// * `jacobian`: rows x [`StateBlocks::len`].
    pub fn add(&mut self, jacobian: &DMatrix<f64>, residual: &DVector<f64>) {
        // A transposed copy and a product are several times faster than a transposed product.
        let transposed = jacobian.transpose();
        self.matrix.view_mut().gemm(1.0, &transposed, jacobian, 1.0);
        for (sum, column) in self.vector.iter_mut().zip(jacobian.column_iter()) {
            *sum += column.dot(residual);
        }
        self.residual += residual.norm_squared();
        self.rows += residual.len();
    }

    /// The equivalent measurement with as many rows as columns: the transposed Cholesky factor of `HᵀH`.
    ///
    /// # Returns
    /// The part of `rᵀr` that no error state explains.
    ///
    /// # Errors
    /// [`NotPositiveDefinite`] where a number is NaN.
    pub fn compress(
        &self,
        compressed: &mut LinearizedMeasurement,
        factorization: &mut Factorization,
    ) -> Result<f64, NotPositiveDefinite> {
        compressed.blocks.active.clone_from(&self.blocks.active);
        compressed.blocks.keyframes.clone_from(&self.blocks.keyframes);
        compressed.upper_triangular = true;
        let root = &mut compressed.jacobian;
        root.copy_from(&self.matrix);
        for k in 0..root.nrows() {
            root[(k, k)] *= 1.0 + RIDGE;
        }
        factorization.semidefinite_cholesky(root)?;
        // Forward substitution: the root times the residual is `Hᵀr`.
        compressed.residual.clone_from(&self.vector);
        for k in 0..compressed.residual.len() {
            let pivot = root[(k, k)];
            let value = if pivot > 0.0 { compressed.residual[k] / pivot } else { 0.0 };
            compressed.residual[k] = value;
            for (rest, factor) in compressed.residual[k + 1..].iter_mut().zip(&root.column(k)[k + 1..]) {
                *rest -= factor * value;
            }
        }
        root.transpose_lower();
        let explained: f64 = compressed.residual.iter().map(|value| value * value).sum();
        Ok((self.residual - explained).max(0.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt as _, SeedableRng, rngs::StdRng};

    #[test]
    fn the_compressed_measurement_is_equivalent() {
        // 9 columns of rank 7.
        let mut rng = StdRng::seed_from_u64(4);
        let mut draw =
            |rows: usize, columns: usize| DMatrix::from_fn(rows, columns, |_, _| rng.random_range(-1.0..1.0));
        let basis = draw(30, 7);
        let jacobian = &basis * draw(7, 9);
        let residual = DVector::from_fn(30, |row, _| (row as f64).cos());
        let mut information = Information::new(StateBlocks::of_active([2..5, 8..14]));
        information.add(&jacobian, &residual);
        let mut compressed = LinearizedMeasurement::default();
        let rest = information.compress(&mut compressed, &mut Factorization::default()).unwrap();
        let root = compressed.jacobian.view();
        let apart = (root.transpose() * root - jacobian.transpose() * &jacobian).amax();
        assert!(apart < 1e-9, "{apart}");
        let z = DVector::from_vec(compressed.residual);
        assert!((root.transpose() * &z - jacobian.transpose() * &residual).amax() < 1e-9);
        let (q, _) = nalgebra::linalg::QR::new(basis).unpack();
        let unexplained = (&residual - &q * (q.transpose() * &residual)).norm_squared();
        assert!((rest - unexplained).abs() < 1e-9, "{rest} {unexplained}");
        assert!((root.lower_triangle() - DMatrix::from_diagonal(&root.diagonal())).amax() == 0.0);
    }
}
