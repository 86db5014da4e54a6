//! The measurement of one landmark of the map ("global observation" in the paper), with its Jacobians.
//!
//! ```text
//! current image:     z1 = π( C_T_I · L_T_I⁻¹ · G_T_L⁻¹ · G_T_KF1 · f )
//! anchor keyframe:   z2 = π( f )
//! further keyframe:  z3 = π( G_T_KFj⁻¹ · G_T_KF1 · f )
//! ```
//! `f` is the landmark in its anchor KF1. It is eliminated by null-space projection, so its map position is used as
//! linearization point only. Errors of keyframes and clones are left errors `[δθ, δp]` in the parent frame.
//! Source: the paper, equations of the global observation function.

use crate::KeyframeId;
use crate::calibration::Calibration;
use crate::linear_algebra::null_space::project_out;
use crate::map_update::map_answer::{MapAnswer, MatchedLandmark};
use crate::state::{POSE_DIM, local_error, rotation_adjoint};
use geometry::{Pose, rotation};
use nalgebra::{DMatrix, DVector, Matrix6, Vector3, Vector6};

/// The poses of the active state that a map measurement depends on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearizationPoint {
    /// The clone of the image.
    pub local_from_imu: Pose,
    /// `G_T_L`.
    pub global_from_local: Pose,
}

impl LinearizationPoint {
    /// `self ⊟ from`: errors of `[clone, transform]`.
    fn minus(&self, from: &Self) -> [Vector6<f64>; 2] {
        let clone = from.local_from_imu.local(&self.local_from_imu);
        [clone, local_error(&from.global_from_local, &self.global_from_local)]
    }
}

/// Estimate and linearization point of a map measurement.
#[derive(Clone, Copy, Debug)]
pub struct Linearization {
    /// Newest estimate.
    pub estimate: LinearizationPoint,
    /// Linearization point; the residual is transferred to the estimate.
    pub at: LinearizationPoint,
    /// First estimate of the position of the clone in L, for first-estimates Jacobians: the unobservable rotation of L about
    /// gravity must have the same direction as in propagation and SLAM feature updates.
    pub first_position: Option<Vector3<f64>>,
}

/// Noise model of map measurements.
#[derive(Clone, Copy, Debug)]
pub struct MapMeasurementSettings {
    /// Noise of pixels in the current image, px.
    pub sigma_match_px: f64,
    /// Noise of pixels in keyframes, px.
    pub sigma_map_px: f64,
    /// Treat keyframe poses and landmarks as exact.
    pub map_is_exact: bool,
}

/// First columns of the state blocks: clone, transform, camera of the answer (as far as estimated), keyframes in the given order.
const CLONE: usize = 0;
const TRANSFORM: usize = POSE_DIM;
const CAMERA: usize = 2 * POSE_DIM;

/// Whitened rows of one landmark over `[clone, transform, camera of the answer, keyframes...]`, landmark eliminated.
///
/// # Arguments
/// * `keyframes`: the keyframes with columns. Observations in others are not used.
/// * `poses`: linearization point of a keyframe's pose in G.
///
/// # Returns
/// Jacobian and residual; `None` where the landmark does not project at the linearization point, or no row remains.
pub fn linearize_landmark(
    landmark: &MatchedLandmark,
    answer: &MapAnswer,
    keyframes: &[KeyframeId],
    poses: &dyn Fn(KeyframeId) -> Option<Pose>,
    calibration: &Calibration,
    point: &Linearization,
    settings: &MapMeasurementSettings,
) -> Option<(DMatrix<f64>, DVector<f64>)> {
    let anchor_pose = poses(landmark.anchor)?;
    let position = &landmark.position_in_anchor;
    let in_global = anchor_pose.transform(position);
    let (wrt_anchor_pose, wrt_position) = anchor_pose.transform_jacobians(position);
    let camera_dim = calibration.camera_range(answer.camera).len();
    let first_keyframe = CAMERA + camera_dim;
    let column_of =
        |id: KeyframeId| Some(first_keyframe + POSE_DIM * keyframes.iter().position(|held| *held == id)?);

    let observed: Vec<_> = landmark
        .observations
        .iter()
        .filter(|(id, _)| !settings.map_is_exact && column_of(*id).is_some())
        .collect();
    let rows = 2 + 2 * observed.len();
    let columns = first_keyframe + if settings.map_is_exact { 0 } else { POSE_DIM * keyframes.len() };
    let mut jacobian = DMatrix::zeros(rows, columns);
    let mut wrt_landmark = DMatrix::zeros(rows, 3);
    let mut residual = DVector::zeros(rows);

    // Current image.
    let in_local = point.at.global_from_local.inverse_transform(&in_global);
    let (wrt_transform, wrt_global) = point.at.global_from_local.inverse_transform_jacobians(&in_global);
    let projection = calibration
        .cameras
        .get(answer.camera)?
        .predict_with_jacobians(&point.at.local_from_imu, &in_local)?;
    let (pixel, wrt_local) = (projection.pixel, projection.wrt_landmark);
    let [clone_step, transform_step] = point.at.minus(&point.estimate);
    let mut wrt_clone = projection.wrt_body;
    if let Some(first) = point.first_position {
        let mut of_rotation = wrt_clone.fixed_columns_mut::<3>(0);
        of_rotation += wrt_local * rotation::skew(&(point.at.local_from_imu.translation - first));
    }
    let wrt_clone = wrt_clone * error_transfer(&clone_step);
    let wrt_transform = wrt_local
        * wrt_transform
        * rotation_adjoint(&point.at.global_from_local)
        * local_error_transfer(&transform_step);
    let whiten = 1.0 / settings.sigma_match_px;
    jacobian.fixed_view_mut::<2, 6>(0, CLONE).copy_from(&(wrt_clone * whiten));
    jacobian.fixed_view_mut::<2, 6>(0, TRANSFORM).copy_from(&(wrt_transform * whiten));
    if camera_dim > 0 {
        let wrt_camera = calibration.camera_jacobian(answer.camera, &projection) * whiten;
        jacobian.view_mut((0, CAMERA), (2, camera_dim)).copy_from(&wrt_camera.columns(0, camera_dim));
    }
    let transferred = landmark.pixel - pixel + wrt_clone * clone_step + wrt_transform * transform_step;
    residual.fixed_rows_mut::<2>(0).copy_from(&(transferred * whiten));
    let wrt_global = wrt_local * wrt_global;
    if settings.map_is_exact {
        return Some((jacobian, residual));
    }
    let anchor_column = column_of(landmark.anchor)?;
    jacobian.fixed_view_mut::<2, 6>(0, anchor_column).copy_from(&(wrt_global * wrt_anchor_pose * whiten));
    wrt_landmark.fixed_view_mut::<2, 3>(0, 0).copy_from(&(wrt_global * wrt_position * whiten));

    // Keyframes.
    let whiten = 1.0 / settings.sigma_map_px;
    for (k, (id, measured)) in observed.iter().enumerate() {
        let row = 2 + 2 * k;
        let camera = &answer.keyframe(*id)?.camera;
        if *id == landmark.anchor {
            let (pixel, wrt_ray) = camera.project_with_jacobian(position).ok()?;
            wrt_landmark.fixed_view_mut::<2, 3>(row, 0).copy_from(&(wrt_ray * whiten));
            residual.fixed_rows_mut::<2>(row).copy_from(&((measured - pixel) * whiten));
            continue;
        }
        let pose = poses(*id)?;
        let (of_pose, of_point) = pose.inverse_transform_jacobians(&in_global);
        let (pixel, wrt_ray) = camera.project_with_jacobian(&pose.inverse_transform(&in_global)).ok()?;
        let wrt_global = wrt_ray * of_point;
        let column = column_of(*id)?;
        jacobian.fixed_view_mut::<2, 6>(row, column).copy_from(&(wrt_ray * of_pose * whiten));
        jacobian
            .fixed_view_mut::<2, 6>(row, anchor_column)
            .copy_from(&(wrt_global * wrt_anchor_pose * whiten));
        wrt_landmark.fixed_view_mut::<2, 3>(row, 0).copy_from(&(wrt_global * wrt_position * whiten));
        residual.fixed_rows_mut::<2>(row).copy_from(&((measured - pixel) * whiten));
    }
    if rows <= 3 {
        return None;
    }
    Some(project_out(wrt_landmark, jacobian, residual))
}

/// Jacobian of the error at the linearization point with respect to the error at the estimate, `step` between them:
/// `Exp(e) = Exp(e_lin) Exp(step)`, so `e_lin = J_l(step) (e - step)`.
fn error_transfer(step: &Vector6<f64>) -> Matrix6<f64> {
    let mut transfer = Matrix6::identity();
    let rotation_step = step.fixed_rows::<3>(0).into_owned();
    transfer.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation::left_jacobian(&rotation_step));
    transfer
}

/// The same for an error in L, `R = R̂ Exp(e)` and `p = p̂ + R̂ e_p`: `e_lin = J_r(step) (e - step)` for the
/// rotation, `Exp(-step) (e_p - step_p)` for the position.
fn local_error_transfer(step: &Vector6<f64>) -> Matrix6<f64> {
    let mut transfer = Matrix6::zeros();
    let rotation_step = step.fixed_rows::<3>(0).into_owned();
    transfer.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation::right_jacobian(&rotation_step));
    let back = rotation::exp(&-rotation_step).to_rotation_matrix().into_inner();
    transfer.fixed_view_mut::<3, 3>(3, 3).copy_from(&back);
    transfer
}
