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
    /// Accepts `confidence` (0..1) of what truly follows the distribution.
    pub fn new(confidence: f64) -> Self {
        let table = (1..=200).map(|rows| quantile(confidence, rows)).collect();
        Self { confidence, table }
    }

    /// The largest acceptable normalized innovation squared over `rows` rows.
    pub fn bound(&self, rows: usize) -> f64 {
        match rows {
            0 => 0.0,
            _ => self.table.get(rows - 1).copied().unwrap_or_else(|| quantile(self.confidence, rows)),
        }
    }

    /// Whether whitened rows are plausible: `rᵀ (H P Hᵀ + I)⁻¹ r`.
    ///
    /// # Arguments
    /// * `covariance`: of the columns of `jacobian`.
    pub fn accepts_rows(
        &self,
        covariance: &DMatrix<f64>,
        jacobian: &DMatrix<f64>,
        residual: &DVector<f64>,
    ) -> bool {
        // The state's uncertainty only makes a residual more plausible.
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

    /// Whether `innovation_squared` over `rows` rows is plausible. NaN is not.
    pub fn accepts(&self, innovation_squared: f64, rows: usize) -> bool {
        innovation_squared <= self.bound(rows)
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
