//! A landmark that two maps have: both say where it is, given the poses of their keyframes.
//!
//! What each map measured of the landmark is in the poses of its keyframes, as far as these are concerned, and in the landmark
//! given these poses (`landmark_prior`). Eliminating the landmark from both leaves the difference of the two, whose
//! covariance is the sum of theirs, so that each measurement is used once.

use std::collections::BTreeMap;

use geometry::pose::Pose;
use geometry::rotation::skew;
use nalgebra::{Matrix3, Matrix3x6, Matrix3xX, Vector3};
use types::LandmarkId;

use crate::bundle::Bundle;
use crate::camera::MIN_DEPTH;
use crate::factor::Factor;
use crate::landmark::InverseDepthLandmark;
use crate::landmark_prior::LandmarkPrior;
use crate::layout::POSE;
use crate::normal_equations::NormalEquations;

/// Squared residuals beyond this are of two landmarks: chi-square with 3 degrees of freedom, 99.99 %.
const GATE: f64 = 21.1;
/// Rows of the residual: ray and logarithm of the inverse depth.
const ROWS: f64 = 3.0;

/// A landmark of one map and the same of another.
#[derive(Clone, Debug)]
pub struct LandmarkTie {
    /// The view in whose camera the two are compared, and the landmark by its map.
    first: (usize, LandmarkPrior),
    /// The anchor of the other one, and the landmark by its map.
    second: (usize, LandmarkPrior),
    /// Inverse covariance of the residual.
    information: Matrix3<f64>,
}

impl LandmarkTie {
    /// Ties two landmarks.
    ///
    /// # Arguments
    /// * `first`, `second`: with their priors.
    /// * `poses`: of all views, in one frame.
    ///
    /// # Returns
    /// `None` where they cannot be compared, for example because one is too far away to have a depth.
    pub fn new(
        first: InverseDepthLandmark,
        second: InverseDepthLandmark,
        poses: &[Pose],
    ) -> Option<LandmarkTie> {
        let of = |landmark: InverseDepthLandmark| {
            let anchor = landmark.anchor_view();
            Some((anchor, landmark.prior.filter(|prior| prior.is_logarithmic)?))
        };
        let mut tie = LandmarkTie { first: of(first)?, second: of(second)?, information: Matrix3::zeros() };
        let compared = tie.compared(poses)?;
        let by_second = compared.by_parameters;
        let covariance =
            tie.first.1.covariance()? + by_second * tie.second.1.covariance()? * by_second.transpose();
        tie.information = covariance.try_inverse()?;
        Some(tie)
    }

    /// Ids of the landmark in both maps.
    pub fn ids(&self) -> [LandmarkId; 2] {
        [self.first.1.id, self.second.1.id]
    }

    /// Squared length of the residual, in standard deviations.
    fn distance(&self, poses: &[Pose]) -> f64 {
        let Some(compared) = self.compared(poses) else { return f64::INFINITY };
        compared.residual.dot(&(self.information * compared.residual))
    }

    /// Whether the two are one landmark.
    pub fn is_consistent(&self, poses: &[Pose]) -> bool {
        self.distance(poses) <= GATE
    }

    /// Where both maps together see the landmark, in the camera of the first one's anchor (m).
    pub fn position_in_anchor(&self, poses: &[Pose]) -> Option<Vector3<f64>> {
        let residual = self.compared(poses)?.residual;
        let gain = self.first.1.covariance()? * self.information;
        Some(inverted(&exponential(&(self.first.1.expected(poses) - gain * residual))))
    }

    /// The first minus the second, as ray and logarithm of the inverse depth in the first one's anchor.
    fn compared(&self, poses: &[Pose]) -> Option<Compared> {
        let ((anchor, first), (other_anchor, second)) = (&self.first, &self.second);
        let (pose, other) = (&poses[*anchor], &poses[*other_anchor]);
        let parameters = exponential(&second.expected(poses));
        let turned = other.rotation * inverted(&parameters);
        let apart = other.translation + turned - pose.translation;
        let to_first = pose.rotation.inverse().to_rotation_matrix().into_inner();
        let in_first = to_first * apart;
        if in_first.z < MIN_DEPTH {
            return None;
        }
        let expected = inverted(&in_first);
        let to_logarithm = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, expected.z.recip()));
        let of_logarithm = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, parameters.z));
        let by_global = to_logarithm * inverted_jacobian(&in_first) * to_first;
        let by_parameters = by_global
            * other.rotation.to_rotation_matrix().into_inner()
            * inverted_jacobian(&parameters)
            * of_logarithm;
        let mut by_pose: BTreeMap<usize, Matrix3x6<f64>> = BTreeMap::new();
        for (view, gain) in first.gains(poses) {
            *by_pose.entry(view).or_default() -= gain;
        }
        for (view, gain) in second.gains(poses) {
            *by_pose.entry(view).or_default() += by_parameters * gain;
        }
        let mut of_pose = |view: usize, lever: &Vector3<f64>, sign: f64| {
            let block = by_pose.entry(view).or_default();
            let mut by_rotation = block.fixed_columns_mut::<3>(0);
            by_rotation -= sign * by_global * skew(lever);
            let mut by_position = block.fixed_columns_mut::<3>(3);
            by_position += sign * by_global;
        };
        of_pose(*anchor, &apart, 1.0);
        of_pose(*other_anchor, &turned, -1.0);
        let residual = first.expected(poses) - expected.xy().push(expected.z.ln());
        Some(Compared { residual, by_pose, by_parameters })
    }
}

impl Factor for LandmarkTie {
    /// Cauchy's robust cost.
    fn cost(&self, bundle: &Bundle, scale: f64) -> f64 {
        let squared_scale = ROWS * scale * scale;
        0.5 * squared_scale * (self.distance(&bundle.poses).min(1e12) / squared_scale).ln_1p()
    }

    fn add_to(&self, equations: &mut NormalEquations, bundle: &Bundle, scale: f64) {
        let Some(compared) = self.compared(&bundle.poses) else { return };
        let residual = compared.residual;
        let distance = residual.dot(&(self.information * residual));
        let information = self.information / (1.0 + distance / (ROWS * scale * scale));
        let mut jacobian = Matrix3xX::zeros(POSE * compared.by_pose.len());
        for (at, block) in compared.by_pose.values().enumerate() {
            jacobian.fixed_columns_mut::<POSE>(POSE * at).copy_from(block);
        }
        let indices = compared.by_pose.keys().flat_map(|&view| bundle.layout().pose(view));
        equations.add_residual(indices, &jacobian, &information, &residual);
    }
}

/// Two landmarks beside each other.
struct Compared {
    residual: Vector3<f64>,
    /// Jacobian of the residual by the errors of the poses.
    by_pose: BTreeMap<usize, Matrix3x6<f64>>,
    /// Jacobian of the second landmark in the first one's anchor by its own parameters.
    by_parameters: Matrix3<f64>,
}

/// Ray and inverse depth of a ray and the logarithm of the inverse depth.
fn exponential(parameters: &Vector3<f64>) -> Vector3<f64> {
    parameters.xy().push(parameters.z.exp())
}

/// The point of a ray and an inverse depth, and the ray and the inverse depth of a point: `[x, y, 1] / z` is its own inverse.
fn inverted(vector: &Vector3<f64>) -> Vector3<f64> {
    vector.xy().push(1.0) / vector.z
}

/// The Jacobian of [`inverted`].
fn inverted_jacobian(vector: &Vector3<f64>) -> Matrix3<f64> {
    let (x, y, z) = (vector.x, vector.y, vector.z);
    Matrix3::new(1.0, 0.0, -x / z, 0.0, 1.0, -y / z, 0.0, 0.0, -1.0 / z) / z
}
