//! The pose from two points and the direction of gravity in both frames: yaw and position in closed form.

use super::PnpError;
use crate::pose::Pose;
use crate::rotation::{Rotation, exp};
use nalgebra::{Unit, UnitVector3, Vector2, Vector3};

/// Relative length below which a configuration is degenerate.
const DEGENERATE: f64 = 1e-9;

/// The direction of gravity in both frames. The lengths do not matter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gravity {
    /// In the world frame.
    pub in_world: Vector3<f64>,
    /// In the camera frame.
    pub in_camera: Vector3<f64>,
}

impl Gravity {
    /// Both directions as unit vectors; `None` where one is zero or not finite.
    pub(super) fn directions(&self) -> Option<(UnitVector3<f64>, UnitVector3<f64>)> {
        let unit = |v: &Vector3<f64>| {
            if v.iter().all(|value| value.is_finite()) { Unit::try_new(*v, 1e-12) } else { None }
        };
        Some((unit(&self.in_world)?, unit(&self.in_camera)?))
    }
}

/// Up to two poses `world_from_camera` from two points and the direction of gravity.
///
/// With both frames rotated so that gravity is z, only the yaw `psi` and the position are unknown:
///
/// ```text
/// P_1 - P_2 = Rz(psi) (d_1 b_1 - d_2 b_2)
/// ```
///
/// The z row is linear in the two depths, the length of the horizontal rows is quadratic; the horizontal directions then
/// give the yaw.
///
/// # Arguments
/// * `points`: in the world frame, metres.
/// * `bearings`: unit vectors in the camera frame.
/// * `gravity_in_world`, `gravity_in_camera`: the same direction in both frames.
///
/// # Errors
/// [`PnpError::Degenerate`] if the points are vertically aligned or coincide, or both rays are horizontal;
/// [`PnpError::NoSolution`] if no pose has both points in front of the camera; [`PnpError::InvalidInput`].
///
/// Source: own derivation; the problem is that of Kukelova, Bujnak & Pajdla, ACCV 2010.
pub fn gravity_two_point(
    points: &[Vector3<f64>; 2],
    bearings: &[UnitVector3<f64>; 2],
    gravity_in_world: &UnitVector3<f64>,
    gravity_in_camera: &UnitVector3<f64>,
) -> Result<Vec<Pose>, PnpError> {
    if !points
        .iter()
        .chain(bearings.iter().map(AsRef::as_ref))
        .all(|v| v.iter().all(|value| value.is_finite()))
    {
        return Err(PnpError::InvalidInput);
    }
    let level_from_world = level_from(gravity_in_world);
    let level_from_camera = level_from(gravity_in_camera);
    let level_points = points.map(|point| level_from_world * point);
    let rays = bearings.map(|bearing| level_from_camera * bearing.into_inner());

    let difference = level_points[0] - level_points[1];
    let horizontal = difference.xy();
    if horizontal.norm() <= DEGENERATE * (1.0 + difference.norm()) {
        return Err(PnpError::Degenerate);
    }
    let mut poses = Vec::with_capacity(2);
    for [d0, d1] in depths(&difference, &rays)? {
        if d0 <= 0.0 || d1 <= 0.0 {
            continue;
        }
        let observed: Vector2<f64> = (rays[0] * d0 - rays[1] * d1).xy();
        let yaw = observed.perp(&horizontal).atan2(observed.dot(&horizontal));
        let yaw_rotation = exp(&Vector3::new(0.0, 0.0, yaw));
        let translation = level_points[0] - yaw_rotation * (rays[0] * d0);
        let world_from_level = level_from_world.inverse();
        poses.push(Pose::new(
            world_from_level * yaw_rotation * level_from_camera,
            world_from_level * translation,
        ));
    }
    if poses.is_empty() { Err(PnpError::NoSolution) } else { Ok(poses) }
}

/// The depths along both rays: the points of the line `b_1z d_1 - b_2z d_2 = dz` that have the right horizontal length.
fn depths(difference: &Vector3<f64>, rays: &[Vector3<f64>; 2]) -> Result<Vec<[f64; 2]>, PnpError> {
    let (z0, z1) = (rays[0].z, rays[1].z);
    let slope_squared = z0 * z0 + z1 * z1;
    if slope_squared <= DEGENERATE * DEGENERATE || rays[0].cross(&rays[1]).norm() <= DEGENERATE {
        return Err(PnpError::Degenerate);
    }
    let foot = [difference.z * z0 / slope_squared, -difference.z * z1 / slope_squared];
    let along = [z1 / slope_squared.sqrt(), z0 / slope_squared.sqrt()];
    let constant = (rays[0] * foot[0] - rays[1] * foot[1]).xy();
    let linear = (rays[0] * along[0] - rays[1] * along[1]).xy();
    // |constant + s linear|^2 = |horizontal|^2
    let a = linear.norm_squared();
    let b = constant.dot(&linear);
    let c = constant.norm_squared() - difference.xy().norm_squared();
    if a <= DEGENERATE * DEGENERATE {
        return Err(PnpError::Degenerate);
    }
    let discriminant = b * b - a * c;
    if discriminant < 0.0 {
        // With noise a double root may vanish: take the closest approach.
        if -discriminant > 1e-4 * (b * b + (a * c).abs()) {
            return Err(PnpError::NoSolution);
        }
        let s = -b / a;
        return Ok(vec![[foot[0] + s * along[0], foot[1] + s * along[1]]]);
    }
    let q = -(b + discriminant.sqrt().copysign(b));
    let roots = if q == 0.0 { [0.0, 0.0] } else { [q / a, c / q] };
    Ok(roots.iter().map(|s| [foot[0] + s * along[0], foot[1] + s * along[1]]).collect())
}

/// The rotation that maps a direction to z.
fn level_from(direction: &UnitVector3<f64>) -> Rotation {
    Rotation::rotation_between_axis(direction, &Vector3::z_axis())
        .unwrap_or_else(|| exp(&Vector3::new(std::f64::consts::PI, 0.0, 0.0)))
}
