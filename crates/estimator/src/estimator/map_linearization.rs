//! Linearization of an answer of the map: the keyframes it needs, and its gated landmarks.

use super::Estimator;
use crate::KeyframeId;
use crate::config::MapMode;
use crate::map_update::map_answer::{MapAnswer, MatchedLandmark};
use crate::map_update::map_measurement::{
    Linearization, LinearizationPoint, MapMeasurementSettings, linearize_landmark,
};
use crate::map_update::verification::VerifiedAnswer;
use crate::measurement::{Information, StateBlocks};
use crate::noise_adaptation::MatchNoise;
use crate::propagation::IMU_DIM;
use crate::state::{Block, CloneId, POSE_DIM};
use geometry::Pose;
use nalgebra::{DMatrix, DVector};

/// The linearized measurements of an answer.
pub(super) struct LinearizedMapUpdate {
    pub(super) information: Information,
    /// Number of landmarks that passed the gate.
    pub(super) used: usize,
    /// Number of landmarks within the contradiction confidence.
    pub(super) plausible: usize,
}

/// The linearized measurement of one landmark, landmark eliminated.
#[derive(Clone, Debug)]
pub(super) struct LandmarkRows {
    jacobian: DMatrix<f64>,
    residual: DVector<f64>,
}

impl Estimator {
    /// The keyframes that the measurements depend on, in the order of the answer. None where the map is exact.
    pub(super) fn keyframes_of(&self, landmarks: &[&MatchedLandmark], answer: &MapAnswer) -> Vec<KeyframeId> {
        if self.config.mode == MapMode::MapConst {
            return Vec::new();
        }
        let used = |id: KeyframeId| {
            landmarks.iter().any(|landmark| {
                landmark.anchor == id || landmark.observations.iter().any(|(observer, _)| *observer == id)
            })
        };
        answer.keyframes.iter().map(|keyframe| keyframe.id).filter(|&id| used(id)).collect()
    }

    /// Pulls keyframes into the state, and returns the state blocks of the measurements.
    pub(super) fn pull_keyframes(
        &mut self,
        clone: CloneId,
        keyframes: &[KeyframeId],
        answer: &MapAnswer,
    ) -> StateBlocks {
        self.covariance.held.activate(keyframes);
        for keyframe in answer.keyframes.iter().filter(|keyframe| keyframes.contains(&keyframe.id)) {
            self.covariance.held.activate_or_insert(
                keyframe.id,
                &keyframe.global_from_keyframe,
                &keyframe.common_error,
                &keyframe.cross_covariances,
            );
        }
        let slots = keyframes.iter().filter_map(|id| self.covariance.held.slot_of(*id)).collect();
        let pose = self.state.clone_index(clone).map_or(Block::ImuPose, Block::Clone);
        let poses = [pose, Block::Transform].into_iter().filter_map(|block| self.state.range(block));
        let camera = self.state.calibration.camera_range(answer.camera);
        let camera = IMU_DIM + camera.start..IMU_DIM + camera.end;
        let active = poses.chain(std::iter::once(camera).filter(|range| !range.is_empty())).collect();
        StateBlocks { active, keyframes: slots }
    }

    /// Linearizes all landmarks, whitened by the stated noise.
    pub(super) fn linearize(
        &self,
        landmarks: &[&MatchedLandmark],
        answer: &MapAnswer,
        keyframes: &[KeyframeId],
        point: &Linearization,
    ) -> Vec<LandmarkRows> {
        let valid = answer.sigma_map_px.is_finite() && answer.sigma_map_px > 0.0;
        let stated_sigma = if valid { answer.sigma_map_px } else { self.config.sigma_match_px };
        let settings = MapMeasurementSettings {
            sigma_match_px: self.config.sigma_match_px,
            sigma_map_px: self.config.sigma_map_px.unwrap_or(stated_sigma),
            map_is_exact: self.config.mode == MapMode::MapConst,
        };
        let poses = |id: KeyframeId| self.pose_of(id, answer);
        let calibration = &self.state.calibration;
        let linearized = landmarks.iter().filter_map(|landmark| {
            linearize_landmark(landmark, answer, keyframes, &poses, calibration, point, &settings)
        });
        linearized.map(|(jacobian, residual)| LandmarkRows { jacobian, residual }).collect()
    }

    /// The noise of the matches of an answer.
    pub(super) fn noise_of_matches(
        &self,
        landmarks: &[LandmarkRows],
        columns: &StateBlocks,
        verified: &VerifiedAnswer,
    ) -> MatchNoise {
        let count = landmarks.iter().map(|rows| rows.residual.len()).sum();
        let mut jacobian = DMatrix::zeros(count, columns.len());
        let mut residual = DVector::zeros(count);
        let mut begin = 0;
        for rows in landmarks {
            let len = rows.residual.len();
            jacobian.rows_mut(begin, len).copy_from(&rows.jacobian);
            residual.rows_mut(begin, len).copy_from(&rows.residual);
            begin += len;
        }
        let reprojection = verified.mean_error_px / self.config.sigma_match_px;
        self.noise.of_matches(&jacobian, &residual, 2 * POSE_DIM, landmarks.len(), reprojection)
    }

    /// Whitens all landmarks by the learned noise, gates them, and sums up those that pass.
    ///
    /// # Arguments
    /// * `sigma_factor`: factor on the stated noise.
    pub(super) fn gate(
        &self,
        landmarks: &[LandmarkRows],
        columns: &StateBlocks,
        sigma_factor: f64,
    ) -> LinearizedMapUpdate {
        let whiten = 1.0 / sigma_factor;
        let joint = self.covariance.joint(columns);
        let mut linearized =
            LinearizedMapUpdate { information: Information::new(columns.clone()), used: 0, plausible: 0 };
        for rows in landmarks {
            let (jacobian, residual) = (&rows.jacobian * whiten, &rows.residual * whiten);
            if self.landmark_gate.accepts_rows(&joint, &jacobian, &residual) {
                linearized.information.add(&jacobian, &residual);
                linearized.used += 1;
                linearized.plausible += 1;
            } else if self.contradiction_gate.accepts_rows(&joint, &jacobian, &residual) {
                linearized.plausible += 1;
            }
        }
        linearized
    }

    /// Linearization point of a keyframe's pose: the one with which it was pulled first.
    pub(super) fn pose_of(&self, id: KeyframeId, answer: &MapAnswer) -> Option<Pose> {
        let held = self.covariance.held.slot_of(id).map(|slot| self.covariance.held.get(slot));
        held.map(|keyframe| keyframe.global_from_keyframe.pose)
            .or_else(|| answer.keyframe(id).map(|keyframe| keyframe.global_from_keyframe.pose))
    }

    /// Mean reprojection error of the inliers, px; `None` where one of them does not project.
    pub(super) fn mean_reprojection(
        &self,
        answer: &MapAnswer,
        verified: &VerifiedAnswer,
        point: &LinearizationPoint,
    ) -> Option<f64> {
        let calibrated = self.camera_of(answer);
        let global_from_camera = point.global_from_local * point.local_from_imu * calibrated.imu_from_camera;
        let mut sum = 0.0;
        for &k in &verified.inliers {
            let landmark = &answer.landmarks[k];
            let in_global = self.pose_of(landmark.anchor, answer)?.transform(&landmark.position_in_anchor);
            let pixel = calibrated.camera.project(&global_from_camera.inverse_transform(&in_global)).ok()?;
            sum += (pixel - landmark.pixel).norm();
        }
        Some(sum / verified.inliers.len().max(1) as f64)
    }
}
