//! The first fix: `global_from_local` enters, and what the places of the map's landmarks say about it.
//!
//! The rows of `map_rows` use a landmark's pixels only, so one keyframe says nothing about the distance to the camera. The
//! pose that the matches were verified with knows it from where the map says the landmarks are. A first fix has nothing
//! else to tell it, so that pose, in the keyframe that explains most, is one more measurement then:
//! ```text
//! z = KF_T_C = G_T_KF⁻¹ · G_T_L · L_T_I · I_T_C + n
//! ```
//! Its errors are not those of the pixels alone: the same pixels have rows of their own, and all landmarks of a keyframe
//! are off together where its pose did not fit the ones that they were triangulated with, which shows in no residual.
//! [`solved_covariance`] states both.

use crate::Estimator;
use crate::KeyframeId;
use crate::linear_algebra::dense::Dense;
use crate::map_update::map_answer::MapAnswer;
use crate::map_update::map_rows::Linearization;
use crate::map_update::verification::Verified;
use crate::measurement::{Information, StateBlocks};
use crate::state::{Block, POSE_DIM, turned};
use geometry::{Pose, PoseWithCovariance, rotation};
use nalgebra::{DMatrix, DVector, Matrix6};

/// How many times as uncertain as its pixels make it a solved pose is taken to be: the pixels are used by the landmarks'
/// rows too, and what is counted twice of them is less than a ninth then.
const PIXELS_USED_TWICE: f64 = 3.0;

impl Estimator {
    /// `global_from_local` enters at the PnP solution, with a prior so wide that the update decides all
    /// that it can see.
    pub(crate) fn insert_transform(&mut self, transform: Pose, depth: f64) {
        let rotation = self.config.transform_sigma_rotation.powi(2);
        let position = (self.config.transform_sigma_depth_fraction * depth)
            .max(self.config.transform_sigma_position)
            .powi(2);
        let sigmas = DVector::from_fn(POSE_DIM, |k, _| if k < 3 { rotation } else { position });
        let independent = Dense::zeros(POSE_DIM, 0);
        let noise = std::iter::once(DMatrix::from_diagonal(&sigmas));
        self.covariance.insert(self.state.transform_begin(), &StateBlocks::default(), &independent, noise);
        self.state.transform = Some(transform);
    }

    /// Forgets `global_from_local`; what the filter knows of L stays.
    pub(crate) fn remove_transform(&mut self) {
        if let Some(range) = self.state.range(Block::Transform) {
            self.covariance.gather(&[0..range.start, range.end..self.state.dim()]);
            self.state.transform = None;
        }
    }

    /// What the landmarks' places say about a first fix.
    pub(crate) fn add_solved_pose(
        &self,
        information: &mut Information,
        answer: &MapAnswer,
        verified: &Verified,
        keyframes: &[KeyframeId],
        point: &Linearization,
    ) {
        let Some(global_from_keyframe) = self.pose_of(verified.best, answer) else { return };
        let columns = &information.blocks;
        let place = keyframes.iter().position(|&id| id == verified.best);
        let sigma_px = self.config.sigma_match_px.max(verified.mean_error_px);
        let depth = median_depth(answer, verified);
        let solved = PoseWithCovariance {
            covariance: solved_covariance(
                &verified.best_from_camera.covariance,
                sigma_px,
                self.config.sigma_map_shift * depth,
            ),
            ..verified.best_from_camera
        };
        let rows = solved_pose_rows(
            columns.len(),
            place.map(|place| columns.active_len() + POSE_DIM * place),
            &global_from_keyframe,
            &solved,
            &self.first_camera().imu_from_camera,
            point,
        );
        if let Some((jacobian, residual)) = rows {
            information.add(&jacobian, &residual);
        }
    }
}

/// Median depth of the verified landmarks in their anchors, metres.
pub(crate) fn median_depth(answer: &MapAnswer, verified: &Verified) -> f64 {
    let mut depths: Vec<f64> =
        verified.inliers.iter().map(|&k| answer.landmarks[k].position_in_anchor.norm()).collect();
    depths.sort_by(f64::total_cmp);
    depths.get(depths.len() / 2).copied().unwrap_or(0.0)
}

/// Covariance of a camera pose in a keyframe that was solved from matches, in the keyframe's frame.
///
/// # Arguments
/// * `of_pixels`: its covariance where the landmarks are exact and pixels have one px of noise.
/// * `sigma_px`: noise of the pixels, px.
/// * `shift`: how far the landmarks are off together in each direction, metres.
fn solved_covariance(of_pixels: &Matrix6<f64>, sigma_px: f64, shift: f64) -> Matrix6<f64> {
    let mut covariance = of_pixels * (PIXELS_USED_TWICE * sigma_px).powi(2);
    for k in 3..POSE_DIM {
        covariance[(k, k)] += shift.powi(2);
    }
    covariance
}

/// Whitened rows of a solved pose, over `[clone, transform, ..., keyframe, ...]`.
///
/// They stand at the estimate, where `global_from_local` was put so that the residual is zero.
///
/// # Arguments
/// * `columns`: numbers in the columns.
/// * `keyframe`: where the keyframe's six columns begin, and its pose in G; `None` where the map is exact.
/// * `solved`: the first camera in the keyframe.
///
/// # Returns
/// `None` where the covariance is not positive definite.
fn solved_pose_rows(
    columns: usize,
    keyframe: Option<usize>,
    global_from_keyframe: &Pose,
    solved: &PoseWithCovariance,
    imu_from_camera: &Pose,
    point: &Linearization,
) -> Option<(DMatrix<f64>, DVector<f64>)> {
    let of_solved = turned(global_from_keyframe);
    let noise = (of_solved * solved.covariance * of_solved.transpose()).cholesky()?;

    // Errors of the camera in G, by the state less by the map.
    let (clone, transform) = (&point.estimate.local_from_imu, &point.estimate.global_from_local);
    let position = point.first_position.unwrap_or(clone.translation);
    let lever = clone.rotation * imu_from_camera.translation;
    let in_global = turned(transform);
    let mut of_clone = Matrix6::identity();
    of_clone.fixed_view_mut::<3, 3>(3, 0).copy_from(&-rotation::skew(&lever));
    let mut of_transform = Matrix6::identity();
    of_transform.fixed_view_mut::<3, 3>(3, 0).copy_from(&-rotation::skew(&(position + lever)));
    let mut jacobian = DMatrix::zeros(POSE_DIM, columns);
    jacobian.fixed_view_mut::<6, 6>(0, 0).copy_from(&(in_global * of_clone));
    jacobian.fixed_view_mut::<6, 6>(0, POSE_DIM).copy_from(&(in_global * of_transform));
    if let Some(begin) = keyframe {
        let mut of_keyframe = -Matrix6::identity();
        let arm = global_from_keyframe.rotation * solved.pose.translation;
        of_keyframe.fixed_view_mut::<3, 3>(3, 0).copy_from(&rotation::skew(&arm));
        jacobian.fixed_view_mut::<6, 6>(0, begin).copy_from(&of_keyframe);
    }
    let whitened = noise.l().solve_lower_triangular(&jacobian)?;
    Some((whitened, DVector::zeros(POSE_DIM)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::map_update::map_rows::MapPoint;
    use crate::state::retract_locally;
    use geometry::numeric::numeric_jacobian;
    use nalgebra::{Vector3, Vector6};

    const COLUMNS: usize = 20;
    const KEYFRAME: usize = 14;

    fn pose(turn: [f64; 3], shift: [f64; 3]) -> Pose {
        Pose::new(rotation::exp(&Vector3::from(turn)), Vector3::from(shift))
    }

    struct Scene {
        state: MapPoint,
        keyframe: Pose,
        solved: PoseWithCovariance,
        imu_from_camera: Pose,
    }

    fn scene() -> Scene {
        let state = MapPoint {
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

    /// Where the solved pose is off from what the poses with these errors say, in the keyframe's frame.
    fn misfit(scene: &Scene, error: &Vector6<f64>, of: usize) -> Vector6<f64> {
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
        let (jacobian, residual) = solved_pose_rows(
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
    fn rows_are_the_derivative_weighed_by_the_covariance() {
        let scene = scene();
        let rows = rows(&scene, None);
        let inverse = scene.solved.covariance.try_inverse().unwrap();
        let mut whole = DMatrix::zeros(POSE_DIM, COLUMNS);
        for begin in [0, POSE_DIM, KEYFRAME] {
            let numeric = numeric_jacobian(POSE_DIM, |error| {
                let error: Vector6<f64> = error.fixed_rows::<6>(0).into();
                DVector::from_column_slice(misfit(&scene, &error, begin).as_slice())
            });
            whole.columns_mut(begin, POSE_DIM).copy_from(&numeric);
        }
        // Whitened rows are defined but for a turn; their information is not.
        let (said, wanted) = (rows.transpose() * &rows, whole.transpose() * inverse * &whole);
        assert!((&said - &wanted).amax() < 1e-6 * wanted.amax(), "{}", (said - wanted).amax());
    }

    #[test]
    fn turning_and_moving_local_about_gravity_is_invisible() {
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
