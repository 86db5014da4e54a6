//! Reprojection of a landmark in inverse-depth parametrization, with its Jacobians.
//!
//! ```text
//! h = M ( w + ρ (p_A - p_B) ) - ρ R_Eᵀ t_E,     w = R_A (R_a (x, y, 1) + ρ t_a),     M = R_Eᵀ R_Bᵀ
//! ```
//! A is the body at the first observation with its camera a, B the body at this one with its camera E; `h` is the point in
//! that camera times ρ, well defined for distant points (Civera et al., T-RO 2008).

use super::window::WindowObservation;
use crate::calibration::CalibratedCamera;
use crate::propagation::ImuState;
use geometry::{Pose, rotation::skew};
use nalgebra::{Matrix2x3, Matrix2x6, Matrix3, Vector2, Vector3};

/// A landmark in the camera frame of its first observation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InverseDepthLandmark {
    /// `x / z` and `y / z`.
    pub normalized: Vector2<f64>,
    /// `1 / z`, 1/m.
    pub inverse_depth: f64,
}

impl InverseDepthLandmark {
    /// Adds an error `(x, y, ρ)`.
    #[must_use]
    pub fn retract(&self, error: &Vector3<f64>) -> Self {
        Self { normalized: self.normalized + error.xy(), inverse_depth: self.inverse_depth + error.z }
    }
}

/// A linearized observation: the residual, and the Jacobians of the prediction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearizedObservation {
    /// Measured minus predicted pixel, px.
    pub residual: Vector2<f64>,
    /// With respect to the pose error of the body at the first observation.
    pub wrt_anchor: Matrix2x6<f64>,
    /// With respect to the pose error of the body at this observation; if both are the same body, the sum of the two.
    pub wrt_body: Matrix2x6<f64>,
    /// With respect to `(x, y, ρ)`.
    pub wrt_landmark: Matrix2x3<f64>,
}

/// Pose of the body at the first observation, and the point relative to it times the inverse depth, in the axes of L.
fn scaled_in_local(
    landmark: &InverseDepthLandmark,
    anchor: &WindowObservation,
    states: &[ImuState],
    cameras: &[CalibratedCamera],
) -> (Pose, Vector3<f64>) {
    let calibrated = &cameras[anchor.camera].imu_from_camera;
    let body = states[anchor.image].local_from_imu;
    let ray = calibrated.rotation * Vector3::new(landmark.normalized.x, landmark.normalized.y, 1.0);
    (body, body.rotation * (ray + calibrated.translation * landmark.inverse_depth))
}

/// Measured minus predicted pixel; `None` where the landmark does not project.
pub fn residual(
    landmark: &InverseDepthLandmark,
    anchor: &WindowObservation,
    observation: &WindowObservation,
    states: &[ImuState],
    cameras: &[CalibratedCamera],
) -> Option<Vector2<f64>> {
    let (anchor_body, from_anchor) = scaled_in_local(landmark, anchor, states, cameras);
    let body = &states[observation.image].local_from_imu;
    let calibrated = &cameras[observation.camera];
    let offset = from_anchor + (anchor_body.translation - body.translation) * landmark.inverse_depth;
    let in_body =
        body.rotation.inverse() * offset - calibrated.imu_from_camera.translation * landmark.inverse_depth;
    let in_camera = calibrated.imu_from_camera.rotation.inverse() * in_body;
    calibrated.camera.project(&in_camera).ok().map(|pixel| observation.pixel - pixel)
}

/// [`residual`] with its Jacobians.
pub fn linearize(
    landmark: &InverseDepthLandmark,
    anchor: &WindowObservation,
    observation: &WindowObservation,
    states: &[ImuState],
    cameras: &[CalibratedCamera],
) -> Option<LinearizedObservation> {
    let rho = landmark.inverse_depth;
    let (anchor_body, from_anchor) = scaled_in_local(landmark, anchor, states, cameras);
    let body = &states[observation.image].local_from_imu;
    let calibrated = &cameras[observation.camera];
    let baseline = anchor_body.translation - body.translation;
    let offset = from_anchor + baseline * rho;
    let camera_from_local = (body.rotation * calibrated.imu_from_camera.rotation).inverse();
    let camera_from_imu = calibrated.imu_from_camera.rotation.inverse();
    let in_camera =
        camera_from_local * offset - camera_from_imu * (calibrated.imu_from_camera.translation * rho);
    let (pixel, by_point) = calibrated.camera.project_with_jacobian(&in_camera).ok()?;
    let wrt_offset: Matrix2x3<f64> = by_point * camera_from_local.to_rotation_matrix().into_inner();

    let mut wrt_anchor = Matrix2x6::zeros();
    wrt_anchor.fixed_view_mut::<2, 3>(0, 0).copy_from(&(-wrt_offset * skew(&from_anchor)));
    wrt_anchor.fixed_view_mut::<2, 3>(0, 3).copy_from(&(wrt_offset * rho));
    let mut wrt_body = Matrix2x6::zeros();
    wrt_body.fixed_view_mut::<2, 3>(0, 0).copy_from(&(wrt_offset * skew(&offset)));
    wrt_body.fixed_view_mut::<2, 3>(0, 3).copy_from(&(wrt_offset * -rho));

    let anchor_extrinsics = &cameras[anchor.camera].imu_from_camera;
    let local_from_anchor_camera: Matrix3<f64> =
        (anchor_body.rotation * anchor_extrinsics.rotation).to_rotation_matrix().into_inner();
    let mut wrt_landmark = wrt_offset * local_from_anchor_camera;
    let wrt_inverse_depth = wrt_offset * (anchor_body.rotation * anchor_extrinsics.translation + baseline)
        - by_point * (camera_from_imu * calibrated.imu_from_camera.translation);
    wrt_landmark.set_column(2, &wrt_inverse_depth);
    Some(LinearizedObservation { residual: observation.pixel - pixel, wrt_anchor, wrt_body, wrt_landmark })
}
