//! Map initialization: `global_from_local` is added to the state, or marginalized.

use super::Estimator;
use crate::KeyframeId;
use crate::linear_algebra::dense::Dense;
use crate::map_update::fixed_pose::FixedPose;
use crate::map_update::map_answer::MapAnswer;
use crate::map_update::map_initializer::{Decision, Fix};
use crate::map_update::map_measurement::Linearization;
use crate::map_update::map_report::{MapReport, Rejection};
use crate::map_update::solved_pose::{linearize_solved_pose, median_depth, solved_covariance};
use crate::map_update::verification::VerifiedAnswer;
use crate::measurement::{Information, StateBlocks};
use crate::state::{Block, POSE_DIM, rotation_adjoint};
use geometry::{Pose, PoseWithCovariance};
use nalgebra::{DMatrix, Matrix6, Vector6};

impl Estimator {
    /// Adds `global_from_local` to the state at the PnP solution, with a prior so wide that the update determines whatever it
    /// observes.
    ///
    /// # Arguments
    /// * `depth`: median distance of the landmarks, metres.
    pub(super) fn insert_solved_transform(&mut self, transform: Pose, depth: f64) {
        let rotation = self.config.sigma_transform_rotation_rad.powi(2);
        let position = (self.config.sigma_transform_depth_fraction * depth)
            .max(self.config.sigma_transform_position_m)
            .powi(2);
        let variances = Vector6::from_fn(|k, _| if k < 3 { rotation } else { position });
        self.insert_transform(&PoseWithCovariance::new(transform, Matrix6::from_diagonal(&variances)));
    }

    /// Adds `global_from_local` to the state, independent of all else, with the covariance of its error in the axes of L.
    pub(super) fn insert_transform(&mut self, transform: &PoseWithCovariance) {
        let independent = Dense::zeros(POSE_DIM, 0);
        let noise =
            std::iter::once(DMatrix::from_fn(POSE_DIM, POSE_DIM, |i, k| transform.covariance[(i, k)]));
        self.covariance.insert(self.state.transform_begin(), &StateBlocks::default(), &independent, noise);
        self.state.transform = Some(transform.pose);
    }

    /// Marginalizes `global_from_local`.
    pub(super) fn remove_transform(&mut self) {
        if let Some(range) = self.state.range(Block::Transform) {
            self.covariance.gather(&[0..range.start, range.end..self.state.dim()]);
            self.state.transform = None;
            self.known_in_map = false;
            self.repeated_views.clear();
        }
    }

    /// Marginalizes `global_from_local`, which the map contradicts: what GNSS measured before would bring the same one back.
    pub(super) fn refute_transform(&mut self) {
        self.remove_transform();
        self.forget_located();
    }

    /// Tells where the robot is, as an operator says: no measurement, but evidence for the first answer of the map that agrees
    /// with it.
    ///
    /// # Arguments
    /// * `global_from_imu`: where the IMU is now; its covariance says how sure the operator is.
    pub fn expect_pose(&mut self, global_from_imu: &PoseWithCovariance) {
        let local_from_imu = self.state.imu.local_from_imu;
        self.map_initializer.expect(FixedPose::new(global_from_imu, &local_from_imu));
    }

    /// Forgets what [`Self::expect_pose`] told.
    pub fn forget_expected_pose(&mut self) {
        self.map_initializer.forget_expected();
    }

    /// Whether an answer may initialize `global_from_local`: its hypothesis has enough evidence.
    ///
    /// # Arguments
    /// * `measured`: the camera of the answer in G according to the answer, noise of its matches included.
    ///
    /// # Errors
    /// [`Rejection::NotDistinctive`]: it waits for more.
    pub(super) fn admit_map_initialization(
        &mut self,
        local_from_imu: &Pose,
        answer: &MapAnswer,
        verified: &VerifiedAnswer,
        measured: &PoseWithCovariance,
        report: &mut MapReport,
    ) -> Result<(), Rejection> {
        let global_from_imu = measured.change_of_child(&self.camera_of(answer).imu_from_camera.inverse());
        let fix = Fix {
            pose: FixedPose::new(&global_from_imu, local_from_imu),
            seen: self.seen_place(answer, verified),
        };
        let decision = self.map_initializer.add(answer.map_version, fix);
        report.hypotheses_dropped += self.map_initializer.take_dropped();
        match decision {
            Decision::Initialize(evidence) => {
                self.support = evidence;
                Ok(())
            }
            Decision::Wait(waiting) => Err(Rejection::NotDistinctive(waiting)),
        }
    }

    /// The PnP pose of the camera of an answer in the best keyframe, with its covariance.
    fn solved_pose(&self, answer: &MapAnswer, verified: &VerifiedAnswer) -> PoseWithCovariance {
        let sigma_px = self.config.sigma_match_px.max(verified.mean_error_px);
        let shift = self.config.sigma_map_shift_fraction * median_depth(answer, verified);
        let covariance = solved_covariance(&verified.best_from_camera.covariance, sigma_px, shift);
        PoseWithCovariance { covariance, ..verified.best_from_camera }
    }

    /// The pose of the camera of an answer in G by it, with the errors of the keyframe and of PnP.
    ///
    /// # Arguments
    /// * `measured`: the same with the error of the keyframe only.
    pub(super) fn with_pnp_noise(
        &self,
        answer: &MapAnswer,
        verified: &VerifiedAnswer,
        measured: &PoseWithCovariance,
    ) -> PoseWithCovariance {
        let Some(global_from_keyframe) = self.pose_of(verified.best, answer) else { return *measured };
        let adjoint = rotation_adjoint(&global_from_keyframe);
        let noise = adjoint * self.solved_pose(answer, verified).covariance * adjoint.transpose();
        PoseWithCovariance::new(measured.pose, measured.covariance + noise)
    }

    /// Adds the PnP pose to the measurements of a map initialization.
    pub(super) fn add_solved_pose(
        &self,
        information: &mut Information,
        answer: &MapAnswer,
        verified: &VerifiedAnswer,
        keyframes: &[KeyframeId],
        point: &Linearization,
    ) {
        let Some(global_from_keyframe) = self.pose_of(verified.best, answer) else { return };
        let columns = &information.blocks;
        let index = keyframes.iter().position(|&id| id == verified.best);
        let solved = self.solved_pose(answer, verified);
        let rows = linearize_solved_pose(
            columns.len(),
            index.map(|index| columns.active_len() + POSE_DIM * index),
            &global_from_keyframe,
            &solved,
            &self.camera_of(answer).imu_from_camera,
            point,
        );
        if let Some((jacobian, residual)) = rows {
            information.add(&jacobian, &residual);
        }
    }
}
