//! What measurements say about some columns of the error: as rows, and summed up as information.

use crate::covariance::NotPositiveDefinite;
use crate::linear_algebra::dense::{Dense, Factorization};
use faer::linalg::matmul::triangular::BlockStructure;
use nalgebra::{DMatrix, DVector};
use std::ops::Range;

/// The columns that a measurement touches: ranges of the active error, and slots of held keyframes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Columns {
    /// Ranges of the active error.
    pub active: Vec<Range<usize>>,
    /// Slots of active held keyframes (6 columns each).
    pub keyframes: Vec<usize>,
}

impl Columns {
    /// Ranges of the active error only.
    pub fn of_active(ranges: impl IntoIterator<Item = Range<usize>>) -> Self {
        Self { active: ranges.into_iter().collect(), keyframes: Vec::new() }
    }

    /// Numbers in these columns.
    pub fn len(&self) -> usize {
        self.active_len() + 6 * self.keyframes.len()
    }

    /// Numbers in those of the active error.
    pub fn active_len(&self) -> usize {
        self.active.iter().map(Range::len).sum()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The ranges of the active error, each with the range of these columns that it stands in.
    pub fn runs(&self) -> impl Iterator<Item = (Range<usize>, Range<usize>)> + '_ {
        self.active.iter().scan(0, |begin, range| {
            let here = *begin..*begin + range.len();
            *begin = here.end;
            Some((range.clone(), here))
        })
    }
}

/// What is added to each number's own information before its root is taken, as a part of it.
///
/// A frame with few rows leaves most directions without information, and there a root of `HᵀH` divides rounding (1e-13 of
/// the diagonal, with the landmarks taken out) by its own root: one track once moved a bias by 14 deviations. What the
/// ridge claims is far below what any filter knows: 1e-11 of a pixel's information is a deviation of hundreds of radians
/// and of kilometres.
const RIDGE: f64 = 1e-11;

/// Whitened rows `r = H e + n`, `n ~ N(0, I)`.
#[derive(Clone, Debug, Default)]
pub struct Rows {
    /// The columns of `H`.
    pub columns: Columns,
    /// `H`.
    pub jacobian: Dense,
    /// `r`.
    pub residual: Vec<f64>,
    /// There are only zeros below the diagonal of `H`.
    pub upper_triangular: bool,
}

impl Rows {
    /// What is known of the zeros in `H`.
    pub fn shape(&self) -> BlockStructure {
        if self.upper_triangular && self.columns.active.len() == 1 && self.columns.keyframes.is_empty() {
            BlockStructure::TriangularUpper
        } else {
            BlockStructure::Rectangular
        }
    }
}

/// Sum of whitened rows over the same columns.
#[derive(Clone, Debug, Default)]
pub struct Information {
    /// The columns.
    pub columns: Columns,
    /// `HᵀH`; only its lower triangle counts.
    pub matrix: Dense,
    /// `Hᵀr`.
    pub vector: Vec<f64>,
    /// `rᵀr`.
    pub residual: f64,
    /// How many rows went in.
    pub rows: usize,
}

impl Information {
    /// Nothing known yet about `columns`.
    pub fn new(columns: Columns) -> Self {
        let mut information = Self { columns, ..Self::default() };
        information.clear();
        information
    }

    /// Forgets all but the columns.
    pub fn clear(&mut self) {
        let n = self.columns.len();
        self.matrix.reset(n, n);
        self.vector.clear();
        self.vector.resize(n, 0.0);
        (self.residual, self.rows) = (0.0, 0);
    }

    /// Adds whitened rows over all the columns.
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

    /// As few rows that say the same: the transposed root of `HᵀH`, into `rows`.
    ///
    /// # Returns
    /// The part of `rᵀr` that no error explains.
    ///
    /// # Errors
    /// [`NotPositiveDefinite`] where a number is NaN.
    pub fn compress(
        &self,
        rows: &mut Rows,
        factorization: &mut Factorization,
    ) -> Result<f64, NotPositiveDefinite> {
        rows.columns.active.clone_from(&self.columns.active);
        rows.columns.keyframes.clone_from(&self.columns.keyframes);
        rows.upper_triangular = true;
        let root = &mut rows.jacobian;
        root.copy_from(&self.matrix);
        for k in 0..root.nrows() {
            root[(k, k)] *= 1.0 + RIDGE;
        }
        factorization.semidefinite_cholesky(root)?;
        // Forward substitution: the root times the residual is `Hᵀr`.
        rows.residual.clone_from(&self.vector);
        for k in 0..rows.residual.len() {
            let pivot = root[(k, k)];
            let value = if pivot > 0.0 { rows.residual[k] / pivot } else { 0.0 };
            rows.residual[k] = value;
            for (rest, factor) in rows.residual[k + 1..].iter_mut().zip(&root.column(k)[k + 1..]) {
                *rest -= factor * value;
            }
        }
        root.transpose_lower();
        let explained: f64 = rows.residual.iter().map(|value| value * value).sum();
        Ok((self.residual - explained).max(0.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt as _, SeedableRng, rngs::StdRng};

    #[test]
    fn the_compressed_rows_say_the_same() {
        // 9 columns, of which the rows see only 7 directions.
        let mut rng = StdRng::seed_from_u64(4);
        let mut draw =
            |rows: usize, columns: usize| DMatrix::from_fn(rows, columns, |_, _| rng.random_range(-1.0..1.0));
        let basis = draw(30, 7);
        let jacobian = &basis * draw(7, 9);
        let residual = DVector::from_fn(30, |row, _| (row as f64).cos());
        let mut information = Information::new(Columns::of_active([2..5, 8..14]));
        information.add(&jacobian, &residual);
        let mut rows = Rows::default();
        let rest = information.compress(&mut rows, &mut Factorization::default()).unwrap();
        let compressed = rows.jacobian.view();
        let apart = (compressed.transpose() * compressed - jacobian.transpose() * &jacobian).amax();
        assert!(apart < 1e-9, "{apart}");
        let z = DVector::from_vec(rows.residual);
        assert!((compressed.transpose() * &z - jacobian.transpose() * &residual).amax() < 1e-9);
        let (q, _) = nalgebra::linalg::QR::new(basis).unpack();
        let unexplained = (&residual - &q * (q.transpose() * &residual)).norm_squared();
        assert!((rest - unexplained).abs() < 1e-9, "{rest} {unexplained}");
        assert!((compressed.lower_triangle() - DMatrix::from_diagonal(&compressed.diagonal())).amax() == 0.0);
    }
}
