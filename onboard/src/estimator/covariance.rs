//! The joint covariance of the active state and the held keyframes, and the three things done to it:
//! carry it through a transition, re-arrange its rows, and take in a measurement.
//!
//! # The measurement update
//! Whitened rows `r = H e + n`, `n ~ N(0, I)`, touch only a few columns `C` (some clones, the
//! transform, some keyframes). All that the update needs of them is `Λ = HᵀH` and `b = Hᵀr`. With
//! `P_CC = L Lᵀ` and `B = I + Lᵀ Λ L`,
//! ```text
//! W = P_AC L⁻ᵀ          dx_A = W B⁻¹ Lᵀ b           P_AA -= W (I - B⁻¹) Wᵀ
//! G = W (I - B⁻¹) L⁻¹   P_AN -= G P_CN              x_N, P_NN untouched (Schmidt)
//! ```
//! which is the extended Kalman filter's update `K = P Hᵀ (H P Hᵀ + I)⁻¹` for the active part and
//! Schmidt's for the nuisance part (by the matrix inversion lemma; tested against the dense filter).
//! `0 <= I - B⁻¹ < I`, so `P_AA` stays positive definite where Joseph's form does.

use super::nuisance::HeldKeyframes;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// The columns that a measurement touches: indices into the active error, and slots of held keyframes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Columns {
    /// Indices into the active error.
    pub active: Vec<usize>,
    /// Slots of active held keyframes (6 columns each).
    pub keyframes: Vec<usize>,
}

impl Columns {
    /// Numbers in these columns.
    pub fn len(&self) -> usize {
        self.active.len() + 6 * self.keyframes.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// What whitened rows say about some columns.
#[derive(Clone, Debug)]
pub struct Information {
    /// The columns.
    pub columns: Columns,
    /// `HᵀH`.
    pub matrix: DMatrix<f64>,
    /// `Hᵀr`.
    pub vector: DVector<f64>,
    /// `rᵀr`.
    pub residual: f64,
    /// How many rows went in.
    pub rows: usize,
}

impl Information {
    /// Nothing known yet about `columns`.
    pub fn new(columns: Columns) -> Self {
        let n = columns.len();
        Self { columns, matrix: DMatrix::zeros(n, n), vector: DVector::zeros(n), residual: 0.0, rows: 0 }
    }

    /// Adds whitened rows over all the columns.
    pub fn add(&mut self, jacobian: &DMatrix<f64>, residual: &DVector<f64>) {
        // A transposed copy and a product are several times faster than a transposed product.
        let transposed = jacobian.transpose();
        self.matrix.gemm(1.0, &transposed, jacobian, 1.0);
        self.vector.gemv(1.0, &transposed, residual, 1.0);
        self.residual += residual.norm_squared();
        self.rows += residual.len();
    }
}

/// A measurement that fits no covariance: the filter is broken and says so.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the covariance is no longer positive definite; the filter has diverged and must be started again")]
pub struct NotPositiveDefinite;

/// Covariance of the active state, and of the keyframes beside it.
#[derive(Clone, Debug)]
pub struct JointCovariance {
    /// `P_AA`.
    pub active: DMatrix<f64>,
    /// `P_AN` and `P_NN`.
    pub held: HeldKeyframes,
}

impl JointCovariance {
    /// Without keyframes.
    pub fn new(active: DMatrix<f64>, max_active_keyframes: usize) -> Self {
        let held = HeldKeyframes::new(active.nrows(), max_active_keyframes);
        Self { active, held }
    }

    /// `P ← F P Fᵀ + Q`, where `F` and `Q` touch only the first rows and columns.
    pub fn time_update(&mut self, transition: &DMatrix<f64>, noise: &DMatrix<f64>) {
        let (n, dim) = (transition.nrows(), self.active.nrows());
        let rows = transition * self.active.rows(0, n);
        self.active.rows_mut(0, n).copy_from(&rows);
        let columns = self.active.columns(0, n) * transition.transpose();
        self.active.columns_mut(0, n).copy_from(&columns);
        let mut block = self.active.view_mut((0, 0), (n, n));
        block += noise;
        debug_assert_eq!(self.active.ncols(), dim);
        self.held.transform_rows(transition);
        self.symmetrize();
    }

    /// Re-arranges the active error: new row `i` is old row `source[i]`.
    ///
    /// Cloning repeats a source, marginalizing leaves one out.
    pub fn gather(&mut self, source: &[usize]) {
        let rows = self.active.select_rows(source);
        self.active = rows.select_columns(source);
        self.held.gather_rows(source);
    }

    /// Appends a block that is independent of everything else at `at` of the active error.
    pub fn insert_independent(&mut self, at: usize, block: &DMatrix<f64>) {
        let n = block.nrows();
        let active = std::mem::replace(&mut self.active, DMatrix::zeros(0, 0));
        self.active = active.insert_rows(at, n, 0.0).insert_columns(at, n, 0.0);
        self.active.view_mut((at, at), (n, n)).copy_from(block);
        self.held.insert_zero_rows(at, n);
    }

    /// `P_AC` and `P_CC`.
    fn columns(&self, columns: &Columns) -> (DMatrix<f64>, DMatrix<f64>) {
        let (n_active, n) = (columns.active.len(), columns.len());
        let dim = self.active.nrows();
        let mut of_active = DMatrix::zeros(dim, n);
        of_active.columns_mut(0, n_active).copy_from(&self.active.select_columns(&columns.active));
        for (k, &slot) in columns.keyframes.iter().enumerate() {
            of_active.columns_mut(n_active + 6 * k, 6).copy_from(&self.held.cross(slot));
        }
        let mut joint = DMatrix::zeros(n, n);
        for (row, &index) in columns.active.iter().enumerate() {
            joint.row_mut(row).copy_from(&of_active.row(index));
        }
        let n_keyframes = n - n_active;
        let corner = joint.view((0, n_active), (n_active, n_keyframes)).transpose();
        joint.view_mut((n_active, 0), (n_keyframes, n_active)).copy_from(&corner);
        joint
            .view_mut((n_active, n_active), (n_keyframes, n_keyframes))
            .copy_from(&self.held.covariance_of(&columns.keyframes));
        (of_active, joint)
    }

    /// `P_CC`, to gate single rows against.
    pub fn joint(&self, columns: &Columns) -> DMatrix<f64> {
        self.columns(columns).1
    }

    /// Normalized innovation squared of all the rows: `rᵀ (H P Hᵀ + I)⁻¹ r`.
    ///
    /// # Errors
    /// [`NotPositiveDefinite`] where the covariance of the columns is broken.
    pub fn innovation_squared(&self, information: &Information) -> Result<f64, NotPositiveDefinite> {
        let (_, joint) = self.columns(&information.columns);
        let factor = factorize(joint)?;
        let reduced = factor.transpose() * &information.vector;
        let inner = inner_factor(&factor, &information.matrix)?;
        Ok(information.residual - reduced.dot(&inner.solve(&reduced)))
    }

    /// Takes in a measurement; see the module's text.
    ///
    /// # Returns
    /// The correction of the active state.
    ///
    /// # Errors
    /// [`NotPositiveDefinite`]: nothing was changed.
    pub fn measurement_update(
        &mut self,
        information: &Information,
    ) -> Result<DVector<f64>, NotPositiveDefinite> {
        let (of_active, joint) = self.columns(&information.columns);
        let factor = factorize(joint)?;
        let inner = inner_factor(&factor, &information.matrix)?.unpack();
        let (factor_inverse, inner_inverse) = (lower_inverse(&factor), lower_inverse(&inner));

        // W = P_AC L⁻ᵀ is what the columns know of the state, V = W L_B⁻ᵀ what they know afterwards:
        // P_AA - W Wᵀ + V Vᵀ = P_AA - W (I - B⁻¹) Wᵀ.
        let before = &factor_inverse * of_active.transpose();
        let after = &inner_inverse * &before;
        let (before_transposed, after_transposed) = (before.transpose(), after.transpose());
        let correction = &after_transposed * (&inner_inverse * (factor.transpose() * &information.vector));
        self.active.gemm(-1.0, &before_transposed, &before, 1.0);
        self.active.gemm(1.0, &after_transposed, &after, 1.0);
        self.symmetrize();
        if !self.held.is_empty() {
            let gain = (before_transposed - after_transposed * &inner_inverse) * &factor_inverse;
            self.held.measurement_update(&gain, &information.columns);
        }
        Ok(correction)
    }

    fn symmetrize(&mut self) {
        let n = self.active.nrows();
        for column in 0..n {
            for row in 0..column {
                let mean = 0.5 * (self.active[(row, column)] + self.active[(column, row)]);
                self.active[(row, column)] = mean;
                self.active[(column, row)] = mean;
            }
        }
    }
}

/// What a keyframe that is known exactly is lifted to, rad^2 or m^2: a nanometre.
const LEAST_VARIANCE: f64 = 1e-18;

/// The lower Cholesky factor. A covariance that is singular to rounding (a robot at rest clones the
/// same pose again and again) is lifted by a 1e-12th of its diagonal.
fn factorize(mut joint: DMatrix<f64>) -> Result<DMatrix<f64>, NotPositiveDefinite> {
    for lift in [0.0, 1e-12, 1e-10] {
        if lift > 0.0 {
            for k in 0..joint.nrows() {
                joint[(k, k)] += lift * joint[(k, k)] + LEAST_VARIANCE;
            }
        }
        if let Some(factor) = Cholesky::new(joint.clone()) {
            return Ok(factor.unpack());
        }
    }
    Err(NotPositiveDefinite)
}

/// Cholesky of `B = I + Lᵀ Λ L`.
fn inner_factor(
    factor: &DMatrix<f64>,
    information: &DMatrix<f64>,
) -> Result<Cholesky<f64, Dyn>, NotPositiveDefinite> {
    let mut inner = factor.transpose() * (information * factor);
    for k in 0..inner.nrows() {
        inner[(k, k)] += 1.0;
    }
    Cholesky::new(inner).ok_or(NotPositiveDefinite)
}

/// The inverse of a lower triangular matrix with a positive diagonal, as Cholesky gives it.
///
/// Column by column, skipping the zeros above the diagonal: a third of the work of solving for the identity.
fn lower_inverse(factor: &DMatrix<f64>) -> DMatrix<f64> {
    let n = factor.nrows();
    let mut inverse = DMatrix::<f64>::identity(n, n);
    for column in 0..n {
        let mut solution = inverse.column_mut(column);
        for k in column..n {
            let value: f64 = solution[k] / factor[(k, k)];
            solution[k] = value;
            solution.rows_mut(k + 1, n - k - 1).axpy(
                -value,
                &factor.view((k + 1, k), (n - k - 1, 1)).column(0),
                1.0,
            );
        }
    }
    inverse
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_inverse_of_a_triangle_undoes_it() {
        let factor = DMatrix::from_fn(17, 17, |row, column| match row.cmp(&column) {
            std::cmp::Ordering::Less => 0.0,
            std::cmp::Ordering::Equal => 1.0 + row as f64,
            std::cmp::Ordering::Greater => ((row * 7 + column * 3) % 5) as f64 - 2.0,
        });
        assert!((lower_inverse(&factor) * &factor - DMatrix::identity(17, 17)).amax() < 1e-12);
    }
}
