//! Levenberg-Marquardt with a robust loss whose scale decreases, then undamped steps.
//!
//! Source: Triggs, McLauchlan, Hartley & Fitzgibbon, "Bundle adjustment: a modern synthesis", 2000; for the scale Yang,
//! Antonante, Tzoumas & Carlone, "Graduated non-convexity for robust spatial perception", RA-L 2020.

use crate::bundle::Bundle;
use crate::problem::Problem;
use crate::sparse_system::SparseCholesky;

/// Factor between the scales of two iterations (graduated non-convexity): wide first, so that inliers correct bad poses.
const SCALE_FACTOR: f64 = 0.6;
/// Maximum number of iterations: the scale reaches its end after 4, the others are for convergence.
const MAX_STEPS: usize = 25;
/// Damped steps end when one lowers the cost by less than this part.
const CONVERGED: f64 = 1e-4;
/// Damping of the first step, and its limits.
const DAMPING: [f64; 3] = [1e-4, 1e-8, 1e4];

impl Problem<'_> {
    /// Minimizes the cost from an initial bundle: Levenberg-Marquardt, then undamped steps.
    ///
    /// # Arguments
    /// * `scales`: of the robust loss (standard deviations) in the first iteration and in the end.
    /// * `progress`: called with the iterations done and their maximum.
    pub fn minimize(
        &self,
        start: Bundle,
        [first_scale, last_scale]: [f64; 2],
        mut progress: impl FnMut(usize, usize),
    ) -> Bundle {
        let mut bundle = start;
        let mut scale = first_scale;
        let [mut damping, least, most] = DAMPING;
        let mut accepted_scale = f64::INFINITY;
        let mut cholesky = SparseCholesky::default();
        for step in 0..MAX_STEPS {
            progress(step, MAX_STEPS);
            let before = self.cost(&bundle, scale);
            let candidate = self.step(&bundle, scale, damping, &mut cholesky);
            let lowered =
                candidate.and_then(|candidate| self.lower((&bundle, before), candidate, scale, true));
            let after = lowered.as_ref().map_or(f64::INFINITY, |(_, after)| *after);
            if let Some((candidate, _)) = lowered {
                bundle = candidate;
                damping = (damping / 3.0).max(least);
                accepted_scale = scale;
            } else {
                damping *= 10.0;
            }
            let converged = accepted_scale <= last_scale && before - after < CONVERGED * before;
            if (converged && after < before) || damping > most {
                break;
            }
            scale = (scale * SCALE_FACTOR).max(last_scale);
        }
        progress(MAX_STEPS, MAX_STEPS);
        // Neighbouring poses are known to millimetres and the shape of a long trajectory to decimetres: damped steps, which are relative
        // to the diagonal, hardly move the whole, and end some standard deviations from the minimum.
        self.undamped_steps(bundle, last_scale, true, &mut cholesky)
    }
}
