//! The paper's global observation of one landmark, with its Jacobians.
//!
//! ```text
//! current image:     z1 = π( C_T_I · L_T_I⁻¹ · G_T_L⁻¹ · G_T_KF1 · f )
//! anchor keyframe:   z2 = π( f )
//! further keyframe:  z3 = π( G_T_KFj⁻¹ · G_T_KF1 · f )
//! ```
//! `f` is the landmark in its anchor KF1. It is projected out, so its map position serves only to
//! linearize at. Source: the paper, equations of the global observation function; all errors are
//! left errors `[δθ, δp]` in the parent frame.

use crate::KeyframeId;
use crate::calibration::Calibration;
use crate::linear_algebra::null_space::project_out;
use crate::map_update::map_answer::{MapAnswer, MatchedLandmark};
use crate::state::{POSE_DIM, local_error, turned};
use geometry::{Pose, rotation};
use nalgebra::{DMatrix, DVector, Matrix6, Vector3, Vector6};

/// The active poses that a map observation depends on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapPoint {
    /// The clone that saw the image.
    pub local_from_imu: Pose,
    /// `G_T_L`.
    pub global_from_local: Pose,
}

impl MapPoint {
    /// `self ⊟ from`: errors of `[clone, transform]` that lead from `from` to here.
    fn minus(&self, from: &Self) -> [Vector6<f64>; 2] {
        let clone = from.local_from_imu.local(&self.local_from_imu);
        [clone, local_error(&from.global_from_local, &self.global_from_local)]
    }
}

/// Where the rows are linearized and what the estimate is.
#[derive(Clone, Copy, Debug)]
pub struct Linearization {
    /// Newest estimate.
    pub estimate: MapPoint,
    /// Linearization point; the residual follows it.
    pub at: MapPoint,
    /// Where the clone was first believed to be, with first-estimates Jacobians: the direction in which
    /// turning L about gravity moves the clone must be the one that tracks and propagation know.
    pub first_position: Option<Vector3<f64>>,
}

/// Noise and treatment of the map's pixels.
#[derive(Clone, Copy, Debug)]
pub struct RowSettings {
    /// Noise of the pixel in the current image, px.
    pub sigma_match_px: f64,
    /// Noise of pixels in keyframes, px.
    pub sigma_map_px: f64,
    /// Take keyframe poses and landmarks for exact.
    pub map_is_exact: bool,
}

/// First columns of the rows: the clone, then the transform, then what is estimated of the first camera, then the
/// keyframes in the order asked for.
const CLONE: usize = 0;
const TRANSFORM: usize = POSE_DIM;
const CAMERA: usize = 2 * POSE_DIM;

/// Whitened rows of one landmark over `[clone, transform, first camera, keyframes...]`, free of the landmark.
///
/// # Arguments
/// * `keyframes`: the keyframes that have columns. Observations in others are left out.
///
/// # Returns
/// `None` where the landmark cannot be seen from the linearization point, or nothing is left of it.
pub fn landmark_rows(
    landmark: &MatchedLandmark,
    answer: &MapAnswer,
    keyframes: &[KeyframeId],
    poses: &dyn Fn(KeyframeId) -> Option<Pose>,
    calibration: &Calibration,
    point: &Linearization,
    settings: &RowSettings,
) -> Option<(DMatrix<f64>, DVector<f64>)> {
    let anchor_pose = poses(landmark.anchor)?;
    let position = &landmark.position_in_anchor;
    let in_global = anchor_pose.transform(position);
    let (of_anchor_pose, of_position) = anchor_pose.transform_jacobians(position);
    let camera_dim = calibration.camera_range(0).len();
    let first_keyframe = CAMERA + camera_dim;
    let column_of =
        |id: KeyframeId| Some(first_keyframe + POSE_DIM * keyframes.iter().position(|held| *held == id)?);

    let seen: Vec<_> = landmark
        .observations
        .iter()
        .filter(|(id, _)| !settings.map_is_exact && column_of(*id).is_some())
        .collect();
    let rows = 2 + 2 * seen.len();
    let columns = first_keyframe + if settings.map_is_exact { 0 } else { POSE_DIM * keyframes.len() };
    let mut jacobian = DMatrix::zeros(rows, columns);
    let mut of_landmark = DMatrix::zeros(rows, 3);
    let mut residual = DVector::zeros(rows);

    // Current image.
    let in_local = point.at.global_from_local.inverse_transform(&in_global);
    let (of_transform, of_global) = point.at.global_from_local.inverse_transform_jacobians(&in_global);
    let observation = calibration.rig.first()?.observe(&point.at.local_from_imu, &in_local)?;
    let (pixel, of_local) = (observation.pixel, observation.of_landmark);
    let [clone_step, transform_step] = point.at.minus(&point.estimate);
    let mut of_clone = observation.of_body;
    if let Some(first) = point.first_position {
        let mut of_rotation = of_clone.fixed_columns_mut::<3>(0);
        of_rotation += of_local * rotation::skew(&(point.at.local_from_imu.translation - first));
    }
    let of_clone = of_clone * error_change(&clone_step);
    let of_transform =
        of_local * of_transform * turned(&point.at.global_from_local) * local_error_change(&transform_step);
    let whiten = 1.0 / settings.sigma_match_px;
    jacobian.fixed_view_mut::<2, 6>(0, CLONE).copy_from(&(of_clone * whiten));
    jacobian.fixed_view_mut::<2, 6>(0, TRANSFORM).copy_from(&(of_transform * whiten));
    if camera_dim > 0 {
        let of_camera = calibration.camera_jacobian(0, &observation) * whiten;
        jacobian.view_mut((0, CAMERA), (2, camera_dim)).copy_from(&of_camera.columns(0, camera_dim));
    }
    let followed = landmark.pixel - pixel + of_clone * clone_step + of_transform * transform_step;
    residual.fixed_rows_mut::<2>(0).copy_from(&(followed * whiten));
    let of_global = of_local * of_global;
    if settings.map_is_exact {
        return Some((jacobian, residual));
    }
    let anchor_column = column_of(landmark.anchor)?;
    jacobian.fixed_view_mut::<2, 6>(0, anchor_column).copy_from(&(of_global * of_anchor_pose * whiten));
    of_landmark.fixed_view_mut::<2, 3>(0, 0).copy_from(&(of_global * of_position * whiten));

    // Keyframes.
    let whiten = 1.0 / settings.sigma_map_px;
    for (k, (id, seen_at)) in seen.iter().enumerate() {
        let row = 2 + 2 * k;
        let camera = &answer.keyframe(*id)?.camera;
        if *id == landmark.anchor {
            let (pixel, of_ray) = camera.project_with_jacobian(position).ok()?;
            of_landmark.fixed_view_mut::<2, 3>(row, 0).copy_from(&(of_ray * whiten));
            residual.fixed_rows_mut::<2>(row).copy_from(&((seen_at - pixel) * whiten));
            continue;
        }
        let pose = poses(*id)?;
        let (of_pose, of_point) = pose.inverse_transform_jacobians(&in_global);
        let (pixel, of_ray) = camera.project_with_jacobian(&pose.inverse_transform(&in_global)).ok()?;
        let of_global = of_ray * of_point;
        let column = column_of(*id)?;
        jacobian.fixed_view_mut::<2, 6>(row, column).copy_from(&(of_ray * of_pose * whiten));
        jacobian.fixed_view_mut::<2, 6>(row, anchor_column).copy_from(&(of_global * of_anchor_pose * whiten));
        of_landmark.fixed_view_mut::<2, 3>(row, 0).copy_from(&(of_global * of_position * whiten));
        residual.fixed_rows_mut::<2>(row).copy_from(&((seen_at - pixel) * whiten));
    }
    if rows <= 3 {
        return None;
    }
    Some(project_out(of_landmark, jacobian, residual))
}

/// How an error about the linearization point depends on the error about the estimate, `step` away:
/// `Exp(e) = Exp(e_lin) Exp(step)`, so `e_lin = J_l(step) (e - step)`.
fn error_change(step: &Vector6<f64>) -> Matrix6<f64> {
    let mut change = Matrix6::identity();
    let rotation_step = step.fixed_rows::<3>(0).into_owned();
    change.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation::left_jacobian(&rotation_step));
    change
}

/// The same with the error in L, `R = R̂ Exp(e)` and `p = p̂ + R̂ e_p`: `e_lin = J_r(step) (e - step)` for the
/// rotation, `Exp(-step) (e_p - step_p)` for the position.
fn local_error_change(step: &Vector6<f64>) -> Matrix6<f64> {
    let mut change = Matrix6::zeros();
    let rotation_step = step.fixed_rows::<3>(0).into_owned();
    change.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation::right_jacobian(&rotation_step));
    let back = rotation::exp(&-rotation_step).to_rotation_matrix().into_inner();
    change.fixed_view_mut::<3, 3>(3, 3).copy_from(&back);
    change
}
