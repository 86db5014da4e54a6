//! Gauss-Newton steps, each shortened until it lowers the cost.
//!
//! Damping holds what the measurements hardly determine where it is, for example the scale of a short trajectory, so that landmarks
//! seem to be outliers that are not. Without it such a direction moves as far as the measurements say.

use crate::bundle::Bundle;
use crate::problem::Problem;
use crate::sparse_system::SparseCholesky;

/// Maximum number of steps.
const MAX_STEPS: usize = 20;
/// Steps end when one lowers the cost by no more than this: the cost is half a squared Mahalanobis distance, so that what is left then
/// is a small part of a standard deviation in every direction.
const CONVERGED: f64 = 1e-2;
/// Parts of a step that are tried, longest first.
const PARTS: [f64; 5] = [1.0, 0.5, 0.25, 0.1, 0.03];

impl Problem<'_> {
    /// Minimizes the cost from an initial bundle without damping.
    ///
    /// # Arguments
    /// * `scale`: of the robust loss (standard deviations); infinite for least squares.
    pub fn minimize_undamped(&self, start: Bundle, scale: f64) -> Bundle {
        self.undamped_steps(start, scale, false, &mut SparseCholesky::default())
    }

    /// Undamped steps until one hardly lowers the cost.
    ///
    /// # Arguments
    /// * `holds_landmarks`: see [`Problem::lower`].
    pub(crate) fn undamped_steps(
        &self,
        start: Bundle,
        scale: f64,
        holds_landmarks: bool,
        cholesky: &mut SparseCholesky,
    ) -> Bundle {
        let mut bundle = start;
        let mut cost = self.cost(&bundle, scale);
        for _ in 0..MAX_STEPS {
            let Some(step) = self.equations(&bundle, scale, 0.0).solve_with(cholesky, 0.0) else { break };
            let before = cost;
            for part in PARTS {
                let candidate = self.stepped(&bundle, &step, part, scale);
                if let Some(lowered) = self.lower((&bundle, before), candidate, scale, holds_landmarks) {
                    (bundle, cost) = lowered;
                    break;
                }
            }
            if before - cost <= CONVERGED {
                break;
            }
        }
        bundle
    }
}
