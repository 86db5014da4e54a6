//! Measured poses and positions as terms of the adjustment, with a robust loss against wrong ones.

use geometry::median;
use geometry::pose::Pose;
use geometry::rotation::{left_jacobian_inverse, log, skew};
use nalgebra::{Matrix6, UnitQuaternion, Vector3, Vector6};

use crate::bundle::Bundle;
use crate::factor::Factor;
use crate::normal_equations::NormalEquations;

/// Squared residuals beyond these are wrong measurements: chi-square with 3 and 6 degrees of freedom, 99.99 %.
const GATES: [f64; 2] = [21.1, 27.9];

/// A measured position of a point that is fixed to a view, with a measured rotation where there is one.
#[derive(Clone, Debug)]
pub struct MeasuredPose {
    /// The view.
    pub view: usize,
    /// The point in the frame of the body (m).
    pub point_in_body: Vector3<f64>,
    /// Its measured position in G (m).
    pub position: Vector3<f64>,
    /// Measured rotation of `global_from_body`.
    pub rotation: Option<UnitQuaternion<f64>>,
    /// Inverse covariance of the residual; zero for a rotation that was not measured.
    pub information: Matrix6<f64>,
}

impl MeasuredPose {
    /// Estimated minus measured, `[δθ, δp]` in G.
    fn residual(&self, poses: &[Pose]) -> Vector6<f64> {
        let pose = &poses[self.view];
        let turned = |measured: UnitQuaternion<f64>| log(&(pose.rotation * measured.inverse()));
        let rotation = self.rotation.map_or(Vector3::zeros(), turned);
        let position = pose.transform(&self.point_in_body) - self.position;
        Vector6::new(rotation.x, rotation.y, rotation.z, position.x, position.y, position.z)
    }

    /// The Jacobian of the residual by the error `[δθ, δp]` of the pose in G.
    fn jacobian(&self, poses: &[Pose], residual: &Vector6<f64>) -> Matrix6<f64> {
        let lever = poses[self.view].rotation * self.point_in_body;
        let mut jacobian = Matrix6::identity();
        let by_rotation = left_jacobian_inverse(&residual.fixed_rows::<3>(0).into_owned());
        jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&by_rotation);
        jacobian.fixed_view_mut::<3, 3>(3, 0).copy_from(&-skew(&lever));
        jacobian
    }

    /// Squared length of the residual, in standard deviations.
    fn distance(&self, poses: &[Pose]) -> f64 {
        let residual = self.residual(poses);
        residual.dot(&(self.information * residual))
    }

    fn freedom(&self) -> f64 {
        if self.rotation.is_some() { 6.0 } else { 3.0 }
    }

    fn is_consistent(&self, poses: &[Pose]) -> bool {
        self.distance(poses) <= GATES[usize::from(self.rotation.is_some())]
    }
}

/// All of them.
#[derive(Clone, Debug, Default)]
pub struct MeasuredPoses {
    factors: Vec<MeasuredPose>,
    /// Factor on the scale of the robust loss.
    spread: f64,
}

impl MeasuredPoses {
    /// Factors for an adjustment that begins at some poses. Where the trajectory has drifted away from most of them, the
    /// loss is as wide as it has drifted, for otherwise all would be taken for wrong.
    pub fn new(factors: &[MeasuredPose], poses: &[Pose]) -> MeasuredPoses {
        let relative = |factor: &MeasuredPose| (factor.distance(poses) / factor.freedom()).sqrt();
        let mut distances: Vec<f64> = factors.iter().map(relative).collect();
        let spread = median(&mut distances).unwrap_or(0.0).max(1.0);
        MeasuredPoses { factors: factors.to_vec(), spread }
    }

    /// The same share of correct residuals is attenuated whatever their dimension.
    fn squared_scale(&self, factor: &MeasuredPose, scale: f64) -> f64 {
        factor.freedom() * (scale * self.spread).powi(2)
    }
}

impl Factor for MeasuredPoses {
    /// Cauchy's robust cost.
    fn cost(&self, bundle: &Bundle, scale: f64) -> f64 {
        let robust = |factor: &MeasuredPose| {
            let scale = self.squared_scale(factor, scale);
            0.5 * scale * (factor.distance(&bundle.poses) / scale).ln_1p()
        };
        self.factors.iter().map(robust).sum()
    }

    fn add_to(&self, equations: &mut NormalEquations, bundle: &Bundle, scale: f64) {
        for factor in &self.factors {
            let residual = factor.residual(&bundle.poses);
            let jacobian = factor.jacobian(&bundle.poses, &residual);
            let scale = self.squared_scale(factor, scale);
            let weight = (1.0 + residual.dot(&(factor.information * residual)) / scale).recip();
            let information = factor.information * weight;
            equations.add_residual(bundle.layout().pose(factor.view), &jacobian, &information, &residual);
        }
    }
}

/// Removes measurements that a trajectory contradicts.
///
/// # Returns
/// Their number.
pub fn remove_wrong(factors: &mut Vec<MeasuredPose>, poses: &[Pose]) -> usize {
    let before = factors.len();
    factors.retain(|factor| factor.is_consistent(poses));
    before - factors.len()
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::rotation::exp;

    #[test]
    fn the_jacobian_is_the_numeric_derivative() {
        let pose = Pose::new(exp(&Vector3::new(0.3, -0.5, 1.2)), Vector3::new(4.0, 2.0, -1.0));
        let measured = exp(&Vector3::new(0.1, 0.2, -0.3)) * pose.rotation;
        for rotation in [None, Some(measured)] {
            let factor = MeasuredPose {
                view: 0,
                point_in_body: Vector3::new(0.5, -2.0, 1.0),
                position: Vector3::new(1.0, 2.0, 3.0),
                rotation,
                information: Matrix6::identity(),
            };
            let stated = factor.jacobian(&[pose], &factor.residual(&[pose]));
            for column in 0..6 {
                let moved = |step: f64| {
                    let mut error = Vector6::zeros();
                    error[column] = step;
                    factor.residual(&[pose.retract(&error)])
                };
                let numeric = (moved(1e-6) - moved(-1e-6)) / 2e-6;
                let first = if rotation.is_some() { 0 } else { 3 };
                let difference = numeric - stated.column(column);
                assert!(difference.rows(first, 6 - first).amax() < 1e-8, "column {column}");
            }
        }
    }
}
