//! What all lengths of a map may be wrong by in common.
//!
//! Every length is measured by one baseline or one accelerometer, with the same error however many measurements there are. The adjustment
//! takes the errors of measurements for independent, so that the scale of a long drive comes out as known to 1e-4; it is known as well as
//! the sensors are calibrated.
//!
//! Derivation: `docs/src/derivations/joint-covariance.md`.

use adjustment::parallel;
use nalgebra::{Matrix6, Vector3, Vector6};

/// What all lengths that one rig measures may be wrong by in common, as a share: as well as baselines and accelerometers are calibrated.
pub(crate) const SCALE_SIGMA: f64 = 1e-3;

/// The scale of a map is not known better than this.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ScaleFloor {
    /// Standard deviation of the scale, as a share.
    pub(crate) sigma: f64,
    /// The point about which the map is too large or too small (m).
    pub(crate) centre: Vector3<f64>,
}

impl ScaleFloor {
    /// The errors `[δθ, δp]` of each pose, common to all of them, that bring the standard deviation of the scale up to the floor; zeros
    /// where it is above.
    ///
    /// # Arguments
    /// * `positions`: of the poses (m).
    /// * `column`: `P_:j`, a block for each pose.
    pub(crate) fn errors(
        &self,
        positions: &[Vector3<f64>],
        column: impl Fn(usize) -> Vec<Matrix6<f64>> + Sync,
    ) -> Vec<Vector6<f64>> {
        // Without extent there is no scale, and its variance is NaN.
        let missing = (self.sigma.powi(2) - scale_variance(positions, column)).max(0.0).sqrt();
        let error = |position: &Vector3<f64>| {
            let mut error = Vector6::zeros();
            error.fixed_rows_mut::<3>(3).copy_from(&((position - self.centre) * missing));
            error
        };
        positions.iter().map(error).collect()
    }
}

/// Variance of the scale that fits the positions to the true ones best, in the sense of least squares.
fn scale_variance(positions: &[Vector3<f64>], column: impl Fn(usize) -> Vec<Matrix6<f64>> + Sync) -> f64 {
    let mean = positions.iter().sum::<Vector3<f64>>() / positions.len().max(1) as f64;
    let moment: f64 = positions.iter().map(|position| (position - mean).norm_squared()).sum();
    let weights: Vec<Vector3<f64>> = positions.iter().map(|position| (position - mean) / moment).collect();
    let (mut variance, mut next) = (0.0, 0);
    parallel::for_each(positions.len(), column, |blocks: Vec<Matrix6<f64>>| {
        let with_all: Vector3<f64> = weights
            .iter()
            .zip(&blocks)
            .map(|(weight, block)| block.fixed_view::<3, 3>(3, 3).tr_mul(weight))
            .sum();
        variance += with_all.dot(&weights[next]);
        next += 1;
    });
    variance
}

/// Adds to the column `P_:j` what an error that is common to all poses adds: a covariance stays one.
///
/// # Arguments
/// * `errors`: of each pose where the common error is one standard deviation; empty without one.
pub(super) fn with_common_error(
    mut column: Vec<Matrix6<f64>>,
    errors: &[Vector6<f64>],
    j: usize,
) -> Vec<Matrix6<f64>> {
    for (block, error) in column.iter_mut().zip(errors) {
        *block += error * errors[j].transpose();
    }
    column
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DMatrix;

    const COUNT: usize = 6;

    fn positions() -> Vec<Vector3<f64>> {
        let at =
            |k: usize| Vector3::new(2.0 * k as f64, (1.3 * k as f64).sin() * 4.0, (0.7 * k as f64).cos());
        (0..COUNT).map(at).collect()
    }

    /// Standard deviation of the scale before and after a floor, and the covariance after.
    fn floored(size: f64, sigma: f64) -> ([f64; 2], DMatrix<f64>) {
        let positions = positions();
        let root = DMatrix::from_fn(6 * COUNT, 6 * COUNT, |i, j| ((3 * i + 5 * j + i * j) as f64).sin());
        let covariance = &root * root.transpose() * size;
        let column = |j: usize| -> Vec<Matrix6<f64>> {
            (0..COUNT).map(|i| covariance.fixed_view::<6, 6>(6 * i, 6 * j).into_owned()).collect()
        };
        let floor = ScaleFloor { sigma, centre: Vector3::new(1.0, -2.0, 0.5) };
        let errors = floor.errors(&positions, column);
        let after = |j: usize| with_common_error(column(j), &errors, j);
        let mut whole = DMatrix::zeros(6 * COUNT, 6 * COUNT);
        for j in 0..COUNT {
            for (i, block) in after(j).iter().enumerate() {
                whole.fixed_view_mut::<6, 6>(6 * i, 6 * j).copy_from(block);
            }
        }
        let sigmas = [scale_variance(&positions, column), scale_variance(&positions, after)].map(f64::sqrt);
        (sigmas, whole)
    }

    #[test]
    fn the_scale_of_a_map_that_takes_it_for_known_has_the_floor_and_that_of_another_stays() {
        let ([before, after], covariance) = floored(1e-12, 1e-3);
        assert!(before < 1e-4 && (after - 1e-3).abs() < 1e-9, "{before} {after}");
        assert!((&covariance - covariance.transpose()).amax() < 1e-15);
        assert!(covariance.symmetric_eigenvalues().min() > -1e-15);
        let ([before, after], _) = floored(1e-2, 1e-3);
        assert!(before > 1e-3 && (after - before).abs() < 1e-12, "{before} {after}");
    }

    #[test]
    fn poses_at_one_place_have_no_scale() {
        let column = |_: usize| vec![Matrix6::identity(); 3];
        let floor = ScaleFloor { sigma: SCALE_SIGMA, centre: Vector3::zeros() };
        let errors = floor.errors(&[Vector3::repeat(2.0); 3], column);
        assert!(errors.iter().all(|error| *error == Vector6::zeros()));
    }
}
