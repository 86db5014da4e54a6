//! Whether a recording agrees with the map: the map moves its poses relative to each other as far as both state.

use adjustment::{POSE, StateCovariance, parallel, pose_errors};
use geometry::pose::Pose;
use nalgebra::{DMatrix, DVector, Matrix3, Matrix6, SymmetricEigen, Vector3};

use crate::places::turned_about_vertical;

/// Poses that are compared, at most: their covariance is decomposed.
const MOST_COMPARED: usize = 40;
/// Directions count in which the map gives this part of what is known then: others did not move, whatever the map says.
const MIN_PART: f64 = 0.05;
/// Standard deviations of yaw (rad) and position (m) of a recording by itself: nothing is known of them.
const FREE_SIGMAS: [f64; 2] = [1.0, 100.0];
/// Yaw and position.
const FREE: usize = 4;

/// Poses of a recording as it gives them by itself, in a frame of its own with z up.
pub(super) struct OwnPoses {
    views: Vec<usize>,
    poses: Vec<Pose>,
    covariance: DMatrix<f64>,
}

impl OwnPoses {
    /// # Arguments
    /// * `keyframes`: views, in order.
    /// * `poses`: of all views.
    /// * `covariance`: of all states at these.
    pub(super) fn new(keyframes: &[usize], poses: &[Pose], covariance: &StateCovariance) -> OwnPoses {
        let step = keyframes.len().div_ceil(MOST_COMPARED).max(1);
        let views: Vec<usize> = keyframes.iter().copied().step_by(step).collect();
        let covariance = joint(covariance, &views);
        OwnPoses { poses: views.iter().map(|&view| poses[view]).collect(), views, covariance }
    }

    /// How far the map moves them, squared, in units of what is to be expected, and the degrees of freedom of that.
    ///
    /// Where recording and map are as certain as they state, the motion `e` has the covariance `P - P⁺`, with `P` that of the recording by
    /// itself and `P⁺` that of both, so that `eᵀ (P - P⁺)⁻¹ e` is chi-square distributed. With `P = L Lᵀ`, eigenvalues `λ` and eigenvectors `v`
    /// of `I - L⁻¹ P⁺ L⁻ᵀ`, it is the sum of `(vᵀ L⁻¹ e)² / λ`. Yaw and position, of which the recording says nothing, add nothing to it.
    ///
    /// # Arguments
    /// * `poses`: of all views in G, adjusted together with the map.
    /// * `covariance`: of all states at these.
    ///
    /// # Returns
    /// Zeros without poses; `None` where a covariance is not positive definite, so that they cannot be compared.
    pub(super) fn moved(&self, poses: &[Pose], covariance: &StateCovariance) -> Option<[f64; 2]> {
        let together: Vec<Pose> = self.views.iter().map(|&view| poses[view]).collect();
        let (Some(first), Some(own)) = (together.first(), self.poses.first()) else {
            return Some([0.0; 2]);
        };
        let global_from_own = turned_about_vertical(first, own);
        let means: Vec<Pose> = self.poses.iter().map(|pose| global_from_own.compose(pose)).collect();
        let error = pose_errors(&means, together.iter());
        let before = self.covariance_in_global(&global_from_own, &means);
        let [sum, freedom] = chi_square(&error, before, &joint(covariance, &self.views))?;
        Some([sum, (freedom - FREE as f64).max(0.0)])
    }

    /// The covariance in G, with yaw and position unknown.
    fn covariance_in_global(&self, global_from_own: &Pose, means: &[Pose]) -> DMatrix<f64> {
        let turn: Matrix3<f64> = global_from_own.rotation.to_rotation_matrix().into_inner();
        let mut covariance = self.covariance.clone();
        for row in 0..2 * means.len() {
            let turned = turn * covariance.fixed_rows::<3>(3 * row);
            covariance.fixed_rows_mut::<3>(3 * row).copy_from(&turned);
        }
        for column in 0..2 * means.len() {
            let turned = covariance.fixed_columns::<3>(3 * column) * turn.transpose();
            covariance.fixed_columns_mut::<3>(3 * column).copy_from(&turned);
        }
        let mut free = DMatrix::zeros(covariance.nrows(), FREE);
        let [sigma_yaw, sigma_p] = FREE_SIGMAS;
        for (at, pose) in means.iter().enumerate() {
            let from_first = pose.translation - means[0].translation;
            free[(POSE * at + 2, 0)] = sigma_yaw;
            free.fixed_view_mut::<3, 1>(POSE * at + 3, 0)
                .copy_from(&(Vector3::z().cross(&from_first) * sigma_yaw));
            let position = Matrix3::identity() * sigma_p;
            free.fixed_view_mut::<3, 3>(POSE * at + 3, 1).copy_from(&position);
        }
        covariance + &free * free.transpose()
    }
}

/// The joint covariance of some poses.
fn joint(covariance: &StateCovariance, views: &[usize]) -> DMatrix<f64> {
    let mut joint = DMatrix::zeros(POSE * views.len(), POSE * views.len());
    let mut column = 0;
    let blocks = |at: usize| covariance.blocks(views.iter().copied(), views[at]);
    parallel::for_each(views.len(), blocks, |blocks: Vec<Matrix6<f64>>| {
        for (row, block) in blocks.iter().enumerate() {
            joint.fixed_view_mut::<POSE, POSE>(POSE * row, POSE * column).copy_from(block);
        }
        column += 1;
    });
    joint
}

/// `eᵀ (P - P⁺)⁻¹ e` and its degrees of freedom, see [`OwnPoses::moved`].
fn chi_square(error: &DVector<f64>, before: DMatrix<f64>, after: &DMatrix<f64>) -> Option<[f64; 2]> {
    let root = before.cholesky()?.l();
    let half = root.solve_lower_triangular(after)?;
    let (error, after) =
        (root.solve_lower_triangular(error)?, root.solve_lower_triangular(&half.transpose())?);
    // NaN passes every comparison that follows.
    if !error.iter().chain(&after).all(|value| value.is_finite()) {
        return None;
    }
    let part = DMatrix::identity(after.nrows(), after.ncols()) - (&after + after.transpose()) * 0.5;
    let SymmetricEigen { eigenvalues, eigenvectors } = part.symmetric_eigen();
    let along = eigenvectors.tr_mul(&error);
    let counted = eigenvalues.iter().zip(along.iter()).filter(|(value, _)| **value > MIN_PART);
    let add =
        |[sum, freedom]: [f64; 2], (value, along): (&f64, &f64)| [sum + along * along / value, freedom + 1.0];
    Some(counted.fold([0.0; 2], add))
}

#[cfg(test)]
mod tests {
    use rand::rngs::StdRng;
    use rand::{RngExt as _, SeedableRng as _};

    use super::*;

    /// A Kalman update moves a state by as much as the law says, whatever part of it is measured.
    #[test]
    fn what_an_update_moves_is_chi_square_distributed() {
        let mut rng = StdRng::seed_from_u64(3);
        let mut random =
            |rows, columns| DMatrix::from_fn(rows, columns, |_, _| rng.random_range(-1.0..1.0_f64));
        let (size, measured) = (12, 5);
        let root = random(size, size) + DMatrix::identity(size, size);
        let before = &root * root.transpose();
        let jacobian = random(measured, size);
        let innovation =
            &jacobian * &before * jacobian.transpose() + DMatrix::identity(measured, measured) * 0.5;
        let gain = &before * jacobian.transpose() * innovation.clone().try_inverse().unwrap();
        let after = &before - &gain * &jacobian * &before;
        let root_of_innovation = innovation.cholesky().unwrap().l();
        let (mut sum, runs) = (0.0, 4000);
        let mut rng = StdRng::seed_from_u64(4);
        for _ in 0..runs {
            let normal = DVector::from_fn(measured, |_, _| crate::tests::normal(&mut rng));
            let [chi_square, freedom] =
                chi_square(&(&gain * &root_of_innovation * normal), before.clone(), &after).unwrap();
            assert!(freedom <= measured as f64 && freedom >= 3.0, "{freedom}");
            sum += chi_square / freedom;
        }
        // The standard deviation of the mean is 0.01.
        assert!((sum / f64::from(runs) - 1.0).abs() < 0.04, "{}", sum / f64::from(runs));
    }
}
