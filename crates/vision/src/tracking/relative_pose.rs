//! Relative pose of two images from bearings, up to scale: residual and Gauss-Newton refinement.
//!
//! For unit bearings `f` (previous) and `g` (current) and `R` = `current_from_previous`, the current bearing lies on the
//! great half-circle from `R f` (a point at infinity) to `t` (the direction of the previous camera centre). The residual
//! is the angle between `g` and that half-circle. It never exceeds the angle between `g` and `R f`, so that any
//! direction explains the points under pure rotation.
//!
//! Source of the refinement: Lui & Drummond, "An iterative 5-pt algorithm for fast and robust essential
//! matrix estimation", BMVC 2013.

use geometry::Rotation;
use geometry::rotation::exp;
use nalgebra::{Matrix3, Matrix5, Unit, Vector3, Vector5};

/// Unit bearings of one point in two images.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BearingPair {
    /// In the previous camera frame.
    pub previous: Vector3<f64>,
    /// In the current camera frame.
    pub current: Vector3<f64>,
}

/// A relative pose up to the length of its translation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RelativePose {
    /// Takes vectors of the previous camera frame to the current one.
    pub current_from_previous: Rotation,
    /// Unit vector towards the previous camera centre, in the current camera frame. Arbitrary without translation.
    pub direction: Vector3<f64>,
}

/// Settings of [`RelativePose::refined`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RefinementOptions {
    /// Scale of the robust loss (Geman-McClure), radians; infinite for least squares.
    pub scale: f64,
    /// Standard deviation of a bearing, radians.
    pub sigma_bearing_rad: f64,
    /// Prior standard deviation of the rotation, radians; infinite without a prior.
    pub sigma_rotation_rad: f64,
    /// Gauss-Newton iterations.
    pub iterations: usize,
}

/// The pure rotation `current_from_previous` that best aligns the bearings: robust least squares on the sphere.
///
/// # Arguments
/// * `scale`: scale of the Geman-McClure loss, radians.
/// * `iterations`: Gauss-Newton iterations.
pub fn rotation_between(pairs: &[BearingPair], scale: f64, iterations: usize) -> Rotation {
    let mut rotation = Rotation::identity();
    for _ in 0..iterations {
        let mut normal = Matrix3::<f64>::zeros();
        let mut right = Vector3::zeros();
        for pair in pairs {
            let turned = rotation * pair.previous;
            let off = pair.current - turned;
            let weight = 1.0 / (1.0 + off.norm_squared() / (scale * scale)).powi(2);
            normal += (Matrix3::identity() - turned * turned.transpose()) * weight;
            right += turned.cross(&off) * weight;
        }
        let Some(step) = normal.cholesky().map(|factor| factor.solve(&right)) else { break };
        rotation = exp(&step) * rotation;
    }
    rotation
}

impl RelativePose {
    /// Angle between the current bearing and its epipolar half-circle, radians.
    pub fn residual(&self, pair: &BearingPair) -> f64 {
        let far = self.current_from_previous * pair.previous;
        let moved = pair.current - far;
        let along = self.direction - far * far.dot(&self.direction);
        let normal = self.direction.cross(&far);
        let length = normal.norm();
        if length < 1e-9 || moved.dot(&along) < 0.0 {
            // Behind the half-circle: its nearest point is the bearing at infinity.
            return moved.norm();
        }
        (pair.current.dot(&normal) / length).abs().min(moved.norm())
    }

    /// Minimizes the angles to the epipolar planes by Gauss-Newton, starting from this pose.
    ///
    /// # Returns
    /// `None` if the normal equations are singular.
    pub fn refined(&self, pairs: &[BearingPair], options: &RefinementOptions) -> Option<Self> {
        // Damps the direction without translation: a parallax of a tenth of the noise has no influence.
        let damping = 1e-2 * options.sigma_bearing_rad * options.sigma_bearing_rad;
        let prior = (options.sigma_bearing_rad / options.sigma_rotation_rad).powi(2);
        let mut pose = *self;
        let mut correction = Vector3::zeros();
        for _ in 0..options.iterations {
            let [across, upward] = tangents(&pose.direction);
            let mut normal = Matrix5::<f64>::zeros();
            let mut right = Vector5::<f64>::zeros();
            for pair in pairs {
                let far = pose.current_from_previous * pair.previous;
                let plane = pose.direction.cross(&far);
                let length = plane.norm().max(1e-3);
                let residual = pair.current.dot(&plane) / length;
                let by_turn = far.cross(&pair.current.cross(&pose.direction)) / length;
                let by_direction = far.cross(&pair.current) / length;
                let ratio = residual / options.scale;
                let weight = 1.0 / (1.0 + ratio * ratio).powi(2);
                let row = Vector5::new(
                    by_turn.x,
                    by_turn.y,
                    by_turn.z,
                    by_direction.dot(&across),
                    by_direction.dot(&upward),
                );
                normal.ger(weight, &row, &row, 1.0);
                right.axpy(-weight * residual, &row, 1.0);
            }
            for i in 0..3 {
                normal[(i, i)] += prior;
                right[i] -= prior * correction[i];
            }
            normal[(3, 3)] += damping;
            normal[(4, 4)] += damping;
            let step = normal.cholesky()?.solve(&right);
            let turn = step.fixed_rows::<3>(0).into_owned();
            correction += turn;
            pose.current_from_previous = exp(&turn) * pose.current_from_previous;
            pose.direction = (pose.direction + across * step[3] + upward * step[4]).try_normalize(1e-12)?;
        }
        pose.direction.iter().all(|value| value.is_finite()).then_some(pose)
    }
}

/// Two unit vectors that complete a unit vector to an orthogonal frame.
fn tangents(direction: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let other = if direction.x.abs() < 0.6 { Vector3::x() } else { Vector3::y() };
    let first = Unit::new_normalize(direction.cross(&other)).into_inner();
    [first, direction.cross(&first)]
}
