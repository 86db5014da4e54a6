//! The PnP pose of the geometric verification as a measurement, for the map initialization.
//!
//! The rows of [`map_measurement`](crate::map_update::map_measurement) use the pixels of a landmark only, so a single keyframe
//! has no information on the distance to the camera. The PnP pose has it, from the positions of the landmarks. A map
//! initialization has no other source, so the PnP pose in the keyframe with the most inliers is one more measurement then:
//! ```text
//! z = KF_T_C = G_T_KF⁻¹ · G_T_L · L_T_I · I_T_C + n
//! ```
//! Its noise is larger than that of its pixels: the same pixels are used by the rows of the landmarks, and all landmarks of a
//! keyframe share a position error where the pose of the keyframe did not fit those that they were triangulated with, which
//! no residual shows. `solved_covariance` includes both.

use crate::map_update::map_answer::MapAnswer;
use crate::map_update::map_measurement::Linearization;
use crate::map_update::verification::VerifiedAnswer;
use crate::state::{POSE_DIM, rotation_adjoint};
use geometry::{Pose, PoseWithCovariance, median, rotation};
use nalgebra::{DMatrix, DVector, Matrix6};

/// Factor on the standard deviation of a PnP pose: its pixels are used by the rows of the landmarks, too, and with this
/// factor less than a ninth of their information is counted twice.
const SHARED_PIXELS_FACTOR: f64 = 3.0;

/// Median distance of the verified landmarks from their anchors, metres.
pub(crate) fn median_depth(answer: &MapAnswer, verified: &VerifiedAnswer) -> f64 {
    let mut depths: Vec<f64> =
        verified.inliers.iter().map(|&k| answer.landmarks[k].position_in_anchor.norm()).collect();
    median(&mut depths).unwrap_or(0.0)
}

/// Covariance of the PnP pose of a camera in a keyframe, in the keyframe's frame.
///
/// # Arguments
/// * `of_pixels`: its covariance for exact landmarks and a pixel noise of 1 px.
/// * `sigma_px`: noise of the pixels, px.
/// * `shift`: standard deviation of the common position error of the landmarks, metres per axis.
pub(crate) fn solved_covariance(of_pixels: &Matrix6<f64>, sigma_px: f64, shift: f64) -> Matrix6<f64> {
    let mut covariance = of_pixels * (SHARED_PIXELS_FACTOR * sigma_px).powi(2);
    for k in 3..POSE_DIM {
        covariance[(k, k)] += shift.powi(2);
    }
    covariance
}

/// Whitened rows of a PnP pose, over `[clone, transform, ..., keyframe, ...]`.
///
/// Linearized at the estimate, where `global_from_local` was initialized such that the residual is zero.
///
/// # Arguments
/// * `columns`: number of columns.
/// * `keyframe`: first of the keyframe's six columns; `None` where the map is exact.
/// * `solved`: pose of the camera in the keyframe.
///
/// # Returns
/// `None` where the covariance is not positive definite.
pub(crate) fn linearize_solved_pose(
    columns: usize,
    keyframe: Option<usize>,
    global_from_keyframe: &Pose,
    solved: &PoseWithCovariance,
    imu_from_camera: &Pose,
    point: &Linearization,
) -> Option<(DMatrix<f64>, DVector<f64>)> {
    let adjoint = rotation_adjoint(global_from_keyframe);
    let noise = (adjoint * solved.covariance * adjoint.transpose()).cholesky()?;

    // Error of the camera in G according to the state minus that according to the map.
    let (clone, transform) = (&point.estimate.local_from_imu, &point.estimate.global_from_local);
    let position = point.first_position.unwrap_or(clone.translation);
    let lever = clone.rotation * imu_from_camera.translation;
    let in_global = rotation_adjoint(transform);
    let mut wrt_clone = Matrix6::identity();
    wrt_clone.fixed_view_mut::<3, 3>(3, 0).copy_from(&-rotation::skew(&lever));
    let mut wrt_transform = Matrix6::identity();
    wrt_transform.fixed_view_mut::<3, 3>(3, 0).copy_from(&-rotation::skew(&(position + lever)));
    let mut jacobian = DMatrix::zeros(POSE_DIM, columns);
    jacobian.fixed_view_mut::<6, 6>(0, 0).copy_from(&(in_global * wrt_clone));
    jacobian.fixed_view_mut::<6, 6>(0, POSE_DIM).copy_from(&(in_global * wrt_transform));
    if let Some(begin) = keyframe {
        let mut wrt_keyframe = -Matrix6::identity();
        let arm = global_from_keyframe.rotation * solved.pose.translation;
        wrt_keyframe.fixed_view_mut::<3, 3>(3, 0).copy_from(&rotation::skew(&arm));
        jacobian.fixed_view_mut::<6, 6>(0, begin).copy_from(&wrt_keyframe);
    }
    let whitened = noise.l().solve_lower_triangular(&jacobian)?;
    Some((whitened, DVector::zeros(POSE_DIM)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::map_update::map_measurement::LinearizationPoint;
    use crate::state::retract_locally;
    use geometry::numeric::numeric_jacobian;
    use nalgebra::{Vector3, Vector6};

    const COLUMNS: usize = 20;
    const KEYFRAME: usize = 14;

    fn pose(turn: [f64; 3], shift: [f64; 3]) -> Pose {
        Pose::new(rotation::exp(&Vector3::from(turn)), Vector3::from(shift))
    }

    struct Scene {
        state: LinearizationPoint,
        keyframe: Pose,
        solved: PoseWithCovariance,
        imu_from_camera: Pose,
    }

    fn scene() -> Scene {
        let state = LinearizationPoint {
            local_from_imu: pose([0.1, -0.05, 0.4], [5.0, 2.0, 1.0]),
            global_from_local: pose([0.3, -0.2, 2.0], [20.0, -8.0, 3.0]),
        };
        let (keyframe, imu_from_camera) =
            (pose([-0.4, 1.0, 0.2], [17.0, -3.0, 4.0]), pose([0.2, 1.4, -0.3], [0.1, 0.05, -0.2]));
        let solved = keyframe.inverse() * state.global_from_local * state.local_from_imu * imu_from_camera;
        let root =
            Matrix6::from_fn(|i, j| 0.01 * ((i * 5 + j * 3) % 7) as f64 + if i == j { 0.05 } else { 0.0 });
        let solved = PoseWithCovariance::new(solved, root * root.transpose());
        Scene { state, keyframe, solved, imu_from_camera }
    }

    /// The residual of the PnP pose at poses with an error, in the keyframe's frame.
    fn residual_at(scene: &Scene, error: &Vector6<f64>, of: usize) -> Vector6<f64> {
        let (mut state, mut keyframe) = (scene.state, scene.keyframe);
        match of {
            0 => state.local_from_imu = state.local_from_imu.retract(error),
            POSE_DIM => state.global_from_local = retract_locally(&state.global_from_local, error),
            _ => keyframe = keyframe.retract(error),
        }
        let camera = state.global_from_local * state.local_from_imu * scene.imu_from_camera;
        scene.solved.pose.local(&(keyframe.inverse() * camera))
    }

    fn rows(scene: &Scene, first: Option<Vector3<f64>>) -> DMatrix<f64> {
        let point = Linearization { estimate: scene.state, at: scene.state, first_position: first };
        let (jacobian, residual) = linearize_solved_pose(
            COLUMNS,
            Some(KEYFRAME),
            &scene.keyframe,
            &scene.solved,
            &scene.imu_from_camera,
            &point,
        )
        .unwrap();
        assert!(residual.iter().all(|value| *value == 0.0));
        jacobian
    }

    #[test]
    fn rows_are_the_whitened_numeric_derivative() {
        let scene = scene();
        let rows = rows(&scene, None);
        let inverse = scene.solved.covariance.try_inverse().unwrap();
        let mut whole = DMatrix::zeros(POSE_DIM, COLUMNS);
        for begin in [0, POSE_DIM, KEYFRAME] {
            let numeric = numeric_jacobian(POSE_DIM, |error| {
                let error: Vector6<f64> = error.fixed_rows::<6>(0).into();
                DVector::from_column_slice(residual_at(&scene, &error, begin).as_slice())
            });
            whole.columns_mut(begin, POSE_DIM).copy_from(&numeric);
        }
        // Whitened rows are unique up to a rotation; their information is unique.
        let (analytic, expected) = (rows.transpose() * &rows, whole.transpose() * inverse * &whole);
        assert!((&analytic - &expected).amax() < 1e-6 * expected.amax(), "{}", (analytic - expected).amax());
    }

    #[test]
    fn rotation_about_gravity_and_translation_of_local_are_unobservable() {
        let scene = scene();
        let first = scene.state.local_from_imu.translation + Vector3::new(0.3, -0.2, 0.1);
        let rows = rows(&scene, Some(first));
        let up = Vector3::z();
        let mut turn = DVector::zeros(COLUMNS);
        turn.fixed_rows_mut::<3>(0).copy_from(&up);
        turn.fixed_rows_mut::<3>(3).copy_from(&up.cross(&first));
        turn.fixed_rows_mut::<3>(6).copy_from(&-up);
        assert!((&rows * turn).amax() < 1e-11 * rows.amax());
        for axis in 0..3 {
            let mut shift = DVector::zeros(COLUMNS);
            (shift[3 + axis], shift[9 + axis]) = (1.0, -1.0);
            assert!((&rows * shift).amax() < 1e-11 * rows.amax());
        }
    }
}
