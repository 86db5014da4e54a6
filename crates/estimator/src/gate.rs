//! Chi-square gates.

use nalgebra::{DMatrix, DVector};
use statrs::distribution::{ChiSquared, ContinuousCDF as _};

/// Upper quantiles of the chi-square distribution at one confidence, by degrees of freedom.
#[derive(Clone, Debug)]
pub struct Gate {
    confidence: f64,
    table: Vec<f64>,
}

impl Gate {
    /// A gate that accepts the fraction `confidence` (0 to 1) of chi-square distributed values.
    pub fn new(confidence: f64) -> Self {
        let table = (1..=200).map(|rows| quantile(confidence, rows)).collect();
        Self { confidence, table }
    }

    /// Upper bound of a normalized innovation squared (NIS) with `rows` degrees of freedom.
    pub fn bound(&self, rows: usize) -> f64 {
        match rows {
            0 => 0.0,
            _ => self.table.get(rows - 1).copied().unwrap_or_else(|| quantile(self.confidence, rows)),
        }
    }

    /// Whether the NIS of whitened rows, `rᵀ (H P Hᵀ + I)⁻¹ r`, is below the bound.
    ///
    /// # Arguments
    /// * `covariance`: n x n, of the states that the columns of `jacobian` refer to.
    /// * `jacobian`: m x n, whitened.
    /// * `residual`: m, whitened.
    pub fn accepts_rows(
        &self,
        covariance: &DMatrix<f64>,
        jacobian: &DMatrix<f64>,
        residual: &DVector<f64>,
    ) -> bool {
        // The covariance of the state only decreases the NIS.
        if self.accepts(residual.norm_squared(), residual.len()) {
            return true;
        }
        let mut innovation = jacobian * (covariance * jacobian.transpose());
        for k in 0..innovation.nrows() {
            innovation[(k, k)] += 1.0;
        }
        innovation
            .cholesky()
            .is_some_and(|factor| self.accepts(residual.dot(&factor.solve(residual)), residual.len()))
    }

    /// Whether `nis` with `rows` degrees of freedom is below the bound. NaN is not.
    pub fn accepts(&self, nis: f64, rows: usize) -> bool {
        nis <= self.bound(rows)
    }
}

fn quantile(confidence: f64, rows: usize) -> f64 {
    // A distribution with a positive number of degrees of freedom always exists.
    ChiSquared::new(rows as f64).map_or(0.0, |distribution| distribution.inverse_cdf(confidence))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bounds_are_those_of_the_printed_tables() {
        let gate = Gate::new(0.95);
        for (rows, bound) in [(1, 3.841), (10, 18.307), (100, 124.342), (300, 341.395)] {
            assert!((gate.bound(rows) - bound).abs() < 2e-3);
        }
        assert!(gate.accepts(3.8, 1) && !gate.accepts(3.9, 1) && !gate.accepts(f64::NAN, 1));
    }
}
