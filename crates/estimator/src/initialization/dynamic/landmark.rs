//! A landmark of the window by its inverse depth, and how a sighting depends on it and on two poses.
//!
//! ```text
//! h = M ( w + ρ (p_A - p_B) ) - ρ R_Eᵀ t_E,     w = R_A (R_a (x, y, 1) + ρ t_a),     M = R_Eᵀ R_Bᵀ
//! ```
//! A is the body at the first sighting with its camera a, B the body at this one with its camera E; `h` is
//! the point in that camera times ρ, so that far points are as good as near ones (Civera et al., T-RO 2008).

use super::window::StartSighting;
use crate::calibration::CalibratedCamera;
use crate::propagation::ImuState;
use geometry::{Pose, rotation::skew};
use nalgebra::{Matrix2x3, Matrix2x6, Matrix3, Vector2, Vector3};

/// A landmark in the camera of its first sighting.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Landmark {
    /// `x / z` and `y / z`.
    pub normalized: Vector2<f64>,
    /// `1 / z`, 1/m.
    pub inverse_depth: f64,
}

impl Landmark {
    /// Adds an error `(x, y, ρ)`.
    pub fn moved(&self, error: &Vector3<f64>) -> Self {
        Self { normalized: self.normalized + error.xy(), inverse_depth: self.inverse_depth + error.z }
    }
}

/// A linearized sighting: residual (seen minus predicted, px) and the prediction's derivatives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SightingRow {
    /// Seen minus predicted, px.
    pub residual: Vector2<f64>,
    /// By the pose error of the body at the first sighting.
    pub by_anchor: Matrix2x6<f64>,
    /// By the pose error of the body at this sighting; where both are the same body, the two add up.
    pub by_body: Matrix2x6<f64>,
    /// By `(x, y, ρ)`.
    pub by_landmark: Matrix2x3<f64>,
}

/// The point times its inverse depth in the axes of L, from the body of the first sighting, and that body.
fn scaled_in_local(
    landmark: &Landmark,
    anchor: &StartSighting,
    states: &[ImuState],
    rig: &[CalibratedCamera],
) -> (Pose, Vector3<f64>) {
    let eye = &rig[anchor.camera].imu_from_camera;
    let body = states[anchor.image].local_from_imu;
    let ray = eye.rotation * Vector3::new(landmark.normalized.x, landmark.normalized.y, 1.0);
    (body, body.rotation * (ray + eye.translation * landmark.inverse_depth))
}

/// Seen minus predicted pixel; `None` where the landmark has no pixel in the camera.
pub fn residual(
    landmark: &Landmark,
    anchor: &StartSighting,
    sighting: &StartSighting,
    states: &[ImuState],
    rig: &[CalibratedCamera],
) -> Option<Vector2<f64>> {
    let (anchor_body, from_anchor) = scaled_in_local(landmark, anchor, states, rig);
    let body = &states[sighting.image].local_from_imu;
    let eye = &rig[sighting.camera];
    let way = from_anchor + (anchor_body.translation - body.translation) * landmark.inverse_depth;
    let in_body = body.rotation.inverse() * way - eye.imu_from_camera.translation * landmark.inverse_depth;
    let in_camera = eye.imu_from_camera.rotation.inverse() * in_body;
    eye.camera.project(&in_camera).ok().map(|pixel| sighting.pixel - pixel)
}

/// [`residual`] with its derivatives.
pub fn linearize(
    landmark: &Landmark,
    anchor: &StartSighting,
    sighting: &StartSighting,
    states: &[ImuState],
    rig: &[CalibratedCamera],
) -> Option<SightingRow> {
    let rho = landmark.inverse_depth;
    let (anchor_body, from_anchor) = scaled_in_local(landmark, anchor, states, rig);
    let body = &states[sighting.image].local_from_imu;
    let eye = &rig[sighting.camera];
    let apart = anchor_body.translation - body.translation;
    let way = from_anchor + apart * rho;
    let camera_from_local = (body.rotation * eye.imu_from_camera.rotation).inverse();
    let camera_from_imu = eye.imu_from_camera.rotation.inverse();
    let in_camera = camera_from_local * way - camera_from_imu * (eye.imu_from_camera.translation * rho);
    let (pixel, by_point) = eye.camera.project_with_jacobian(&in_camera).ok()?;
    let by_way: Matrix2x3<f64> = by_point * camera_from_local.to_rotation_matrix().into_inner();

    let mut by_anchor = Matrix2x6::zeros();
    by_anchor.fixed_view_mut::<2, 3>(0, 0).copy_from(&(-by_way * skew(&from_anchor)));
    by_anchor.fixed_view_mut::<2, 3>(0, 3).copy_from(&(by_way * rho));
    let mut by_body = Matrix2x6::zeros();
    by_body.fixed_view_mut::<2, 3>(0, 0).copy_from(&(by_way * skew(&way)));
    by_body.fixed_view_mut::<2, 3>(0, 3).copy_from(&(by_way * -rho));

    let anchor_eye = &rig[anchor.camera].imu_from_camera;
    let local_from_anchor_camera: Matrix3<f64> =
        (anchor_body.rotation * anchor_eye.rotation).to_rotation_matrix().into_inner();
    let mut by_landmark = by_way * local_from_anchor_camera;
    let by_depth = by_way * (anchor_body.rotation * anchor_eye.translation + apart)
        - by_point * (camera_from_imu * eye.imu_from_camera.translation);
    by_landmark.set_column(2, &by_depth);
    Some(SightingRow { residual: sighting.pixel - pixel, by_anchor, by_body, by_landmark })
}
