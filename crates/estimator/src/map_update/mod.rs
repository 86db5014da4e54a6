//! Takes an answer of the map into the filter: verify, initialize, linearize, gate, update.

mod contradiction;
pub mod map_answer;
mod map_initialization;
pub mod map_report;
pub mod map_rows;
pub mod map_version;
pub mod verification;

use crate::KeyframeId;
use crate::config::{MapMode, Relinearization};
use crate::map_update::map_answer::{MapAnswer, MatchedLandmark};
use crate::map_update::map_initialization::median_depth;
use crate::map_update::map_report::{MapReport, Rejection};
use crate::map_update::map_rows::{Linearization, MapPoint, RowSettings, landmark_rows};
use crate::map_update::verification::{VerificationSettings, Verified, verify};
use crate::measurement::{Information, StateBlocks};
use crate::state::{Block, CloneId};
use crate::{Estimator, EstimatorError, propagation::IMU_DIM};
use geometry::{Pose, PoseWithCovariance};
use nalgebra::Vector3;

/// An update that is ready to be made.
struct Prepared {
    information: Information,
    /// Landmarks that passed their gate.
    accepted: usize,
    /// Landmarks that are at least not out of the question.
    plausible: usize,
}

impl Estimator {
    /// Corrects the state by the map's answer to the image of `clone`.
    ///
    /// A rejected answer is a report, not an error, and leaves the state as it was.
    ///
    /// # Errors
    /// [`EstimatorError::Diverged`] when the filter itself is broken.
    pub fn map_update(&mut self, clone: CloneId, answer: &MapAnswer) -> Result<MapReport, EstimatorError> {
        let same_map = self.map_version.held == Some(answer.map_version);
        let answer = self
            .restrict(answer)
            .sound(&|id| if same_map { self.covariance.held.map_covariance(id) } else { None });
        let mut report = MapReport {
            keyframes: answer.keyframes.len(),
            matches: answer.landmarks.len(),
            verified: 0,
            accepted: 0,
            mean_reprojection_px: None,
            relinearized: false,
            initialized: false,
            innovation: None,
            rejection: None,
        };
        report.rejection = self.in_map_version(clone, &answer, &mut report)?.err();
        match &report.rejection {
            None => {
                self.rejections_in_a_row = 0;
                self.lost = None;
                self.last_map_update_ns = Some(self.state.stamp_ns);
            }
            Some(
                Rejection::Implausible { .. }
                | Rejection::FewLandmarks { .. }
                | Rejection::Contradicts { .. },
            ) => self.note_contradiction(),
            Some(_) => {}
        }
        self.covariance.held.deactivate_unused();
        self.covariance.evict(self.config.max_held_keyframes);
        Ok(report)
    }

    /// What the mode lets through, and of which it is known how it depends on what is held.
    fn restrict(&self, answer: &MapAnswer) -> MapAnswer {
        let mut restricted = answer.clone();
        let depends = self.covariance.held.has_correlations()
            || answer.keyframes.iter().any(|keyframe| !keyframe.cross_covariances.is_empty());
        if depends && self.map_version.held == Some(answer.map_version) {
            restricted = restricted.with_known_relations(&self.held_keyframes());
        }
        if self.config.mode == MapMode::Single {
            restricted.keyframes.truncate(1);
        }
        let known = |id: KeyframeId| restricted.keyframes.iter().any(|keyframe| keyframe.id == id);
        restricted.landmarks.retain(|landmark| known(landmark.anchor));
        for landmark in &mut restricted.landmarks {
            landmark.observations.retain(|(id, _)| known(*id));
        }
        restricted
    }

    pub(crate) fn try_map_update(
        &mut self,
        clone: CloneId,
        answer: &MapAnswer,
        report: &mut MapReport,
    ) -> Result<Result<(), Rejection>, EstimatorError> {
        if self.config.mode == MapMode::Odometry {
            return Ok(Err(Rejection::Odometry));
        }
        let Some(place) = self.state.place_of(clone) else { return Ok(Err(Rejection::TooLate)) };
        let local_from_imu = self.state.clones[place].local_from_imu;
        let first_position =
            self.config.first_estimates.then_some(self.state.clones[place].first_estimate.translation);
        let settings = VerificationSettings {
            angle: self.config.verify_angle,
            min_inliers: self.config.min_inliers,
            gravity_in_camera: Some(self.gravity_in_camera(&local_from_imu)),
        };
        let verified = match verify(answer, self.first_camera(), &settings) {
            Ok(verified) => verified,
            Err(rejection) => return Ok(Err(rejection.into())),
        };
        report.verified = verified.inliers.len();

        let Some(best) = answer.keyframe(verified.best) else { return Ok(Err(Rejection::TooLate)) };
        let global_from_imu = self.pose_of(best.id, answer).unwrap_or(best.global_from_keyframe.pose)
            * verified.best_from_camera.pose
            * self.first_camera().imu_from_camera.inverse();
        let solved_transform = global_from_imu * local_from_imu.inverse();
        report.initialized = self.state.transform.is_none();
        let transform = self.state.transform.unwrap_or(solved_transform);
        let estimate = MapPoint { local_from_imu, global_from_local: transform };

        let mean_error = self.mean_reprojection(answer, &verified, &estimate);
        report.mean_reprojection_px = mean_error;
        // A landmark that the prediction cannot even see is an infinite error.
        let moves = mean_error.is_none_or(|error| error > self.config.relinearize_above_px);
        let mut at = estimate;
        if moves && !report.initialized {
            match self.config.relinearization {
                Relinearization::Off => {}
                Relinearization::Transform => at.global_from_local = solved_transform,
                Relinearization::Clone => at.local_from_imu = transform.inverse() * global_from_imu,
            }
            report.relinearized = at != estimate;
        }

        if report.initialized {
            self.insert_transform(solved_transform, median_depth(answer, &verified));
        }
        let said = best.global_from_keyframe.change_of_child(&verified.best_from_camera.pose);
        let point = Linearization { estimate, at, first_position };
        let outcome = self.iterate(clone, answer, &verified, point, &said, report)?;
        if outcome.is_err() && report.initialized {
            self.remove_transform();
            report.initialized = false;
        }
        Ok(outcome)
    }

    /// Gauss-Newton on the map rows, then the update at the last linearization point.
    fn iterate(
        &mut self,
        clone: CloneId,
        answer: &MapAnswer,
        verified: &Verified,
        mut point: Linearization,
        said: &PoseWithCovariance,
        report: &mut MapReport,
    ) -> Result<Result<(), Rejection>, EstimatorError> {
        let inliers: Vec<&MatchedLandmark> = verified.inliers.iter().map(|&k| &answer.landmarks[k]).collect();
        let keyframes = self.keyframes_of(&inliers, answer);
        let new: Vec<KeyframeId> = keyframes
            .iter()
            .copied()
            .filter(|&id| self.covariance.held.map_covariance(id).is_none())
            .collect();
        let columns = self.map_columns(clone, &keyframes, answer);
        let exact = self.config.mode == MapMode::MapConst;
        for iteration in 1..=self.config.map_iterations {
            let mut prepared = self.prepare(&inliers, answer, &keyframes, &columns, &point);
            if report.initialized {
                self.add_solved_pose(&mut prepared.information, answer, verified, &keyframes, &point);
            }
            report.accepted = prepared.accepted;
            let agrees = exact || 2 * prepared.plausible >= inliers.len();
            let believable = iteration > 1 || self.is_believable(agrees, clone, said);
            let need = self.config.min_inliers.div_ceil(2);
            if prepared.accepted < need {
                let (accepted, verified) = (prepared.accepted, inliers.len());
                return Ok(Err(self.give_up(&new, Rejection::FewLandmarks { accepted, verified, need })));
            }
            if !believable {
                let (plausible, verified) = (prepared.plausible, inliers.len());
                return Ok(Err(self.give_up(&new, Rejection::Contradicts { plausible, verified })));
            }
            let rows = prepared.information.rows;
            let Ok(innovation) = self.covariance.information_nis(&prepared.information) else {
                return Ok(Err(self.give_up(&new, Rejection::UnsoundMap)));
            };
            report.innovation = Some((innovation, rows));
            // Taking the map for exact contradicts itself all the time; its gate is the landmarks'.
            if !exact && !self.frame_gate.accepts(innovation, rows) {
                let bound = self.frame_gate.bound(rows);
                return Ok(Err(self.give_up(&new, Rejection::Implausible { innovation, rows, bound })));
            }
            if iteration < self.config.map_iterations {
                point.at = self.next_point(clone, &prepared.information, &point)?;
                continue;
            }
            self.covariance.information_update(&prepared.information, &mut self.correction)?;
            self.state.retract(&self.correction);
            self.check_health()?;
        }
        Ok(Ok(()))
    }

    /// What a rejected answer brought along leaves no trace.
    fn give_up(&mut self, new: &[KeyframeId], why: Rejection) -> Rejection {
        self.covariance.held.remove_unused(new);
        why
    }

    /// Where one Gauss-Newton step leads the clone and the transform, without changing the filter.
    fn next_point(
        &mut self,
        clone: CloneId,
        information: &Information,
        point: &Linearization,
    ) -> Result<MapPoint, EstimatorError> {
        self.covariance.information_correction(information, &mut self.correction)?;
        let mut moved = self.state.clone();
        moved.retract(&self.correction);
        let local_from_imu =
            moved.place_of(clone).map_or(point.at.local_from_imu, |place| moved.clones[place].local_from_imu);
        Ok(MapPoint {
            local_from_imu,
            global_from_local: moved.transform.unwrap_or(point.at.global_from_local),
        })
    }

    /// The keyframes that rows will refer to, best first. None where the map is taken for exact.
    fn keyframes_of(&self, landmarks: &[&MatchedLandmark], answer: &MapAnswer) -> Vec<KeyframeId> {
        if self.config.mode == MapMode::MapConst {
            return Vec::new();
        }
        let used = |id: KeyframeId| {
            landmarks.iter().any(|landmark| {
                landmark.anchor == id || landmark.observations.iter().any(|(seen, _)| *seen == id)
            })
        };
        answer.keyframes.iter().map(|keyframe| keyframe.id).filter(|&id| used(id)).collect()
    }

    /// Pulls the keyframes into the state and names all columns of the rows.
    fn map_columns(&mut self, clone: CloneId, keyframes: &[KeyframeId], answer: &MapAnswer) -> StateBlocks {
        self.covariance.held.activate(keyframes);
        for keyframe in answer.keyframes.iter().filter(|keyframe| keyframes.contains(&keyframe.id)) {
            self.covariance.held.activate_or_insert(
                keyframe.id,
                &keyframe.global_from_keyframe,
                &keyframe.cross_covariances,
            );
        }
        let slots = keyframes.iter().filter_map(|id| self.covariance.held.slot_of(*id)).collect();
        let place = self.state.place_of(clone).map_or(Block::ImuPose, Block::Clone);
        let poses = [place, Block::Transform].into_iter().filter_map(|block| self.state.range(block));
        let camera = self.state.calibration.camera_range(0);
        let camera = IMU_DIM + camera.start..IMU_DIM + camera.end;
        let active = poses.chain(std::iter::once(camera).filter(|range| !range.is_empty())).collect();
        StateBlocks { active, keyframes: slots }
    }

    /// Rows of all landmarks that pass their own gate.
    fn prepare(
        &self,
        landmarks: &[&MatchedLandmark],
        answer: &MapAnswer,
        keyframes: &[KeyframeId],
        columns: &StateBlocks,
        point: &Linearization,
    ) -> Prepared {
        let usable = answer.sigma_map_px.is_finite() && answer.sigma_map_px > 0.0;
        let stated_sigma = if usable { answer.sigma_map_px } else { self.config.sigma_match_px };
        let settings = RowSettings {
            sigma_match_px: self.config.sigma_match_px,
            sigma_map_px: self.config.sigma_map_px.unwrap_or(stated_sigma),
            map_is_exact: self.config.mode == MapMode::MapConst,
        };
        let joint = self.covariance.joint(columns);
        let poses = |id: KeyframeId| self.pose_of(id, answer);
        let mut prepared =
            Prepared { information: Information::new(columns.clone()), accepted: 0, plausible: 0 };
        for landmark in landmarks {
            let rows =
                landmark_rows(landmark, answer, keyframes, &poses, &self.state.calibration, point, &settings);
            let Some((jacobian, residual)) = rows else { continue };
            if self.landmark_gate.accepts_rows(&joint, &jacobian, &residual) {
                prepared.information.add(&jacobian, &residual);
                prepared.accepted += 1;
                prepared.plausible += 1;
            } else if self.contradiction_gate.accepts_rows(&joint, &jacobian, &residual) {
                prepared.plausible += 1;
            }
        }
        prepared
    }

    /// The pose that rows are linearized at: the one that the filter entered the keyframe with.
    pub(crate) fn pose_of(&self, id: KeyframeId, answer: &MapAnswer) -> Option<Pose> {
        let held = self.covariance.held.slot_of(id).map(|slot| self.covariance.held.get(slot));
        held.map(|keyframe| keyframe.global_from_keyframe.pose)
            .or_else(|| answer.keyframe(id).map(|keyframe| keyframe.global_from_keyframe.pose))
    }

    /// Mean reprojection error at a point; `None` when a verified landmark is not in view there.
    fn mean_reprojection(&self, answer: &MapAnswer, verified: &Verified, point: &MapPoint) -> Option<f64> {
        let eye = self.first_camera();
        let global_from_camera = point.global_from_local * point.local_from_imu * eye.imu_from_camera;
        let mut sum = 0.0;
        for &k in &verified.inliers {
            let landmark = &answer.landmarks[k];
            let in_global = self.pose_of(landmark.anchor, answer)?.transform(&landmark.position_in_anchor);
            let pixel = eye.camera.project(&global_from_camera.inverse_transform(&in_global)).ok()?;
            sum += (pixel - landmark.pixel).norm();
        }
        Some(sum / verified.inliers.len().max(1) as f64)
    }

    pub(crate) fn gravity_in_camera(&self, local_from_imu: &Pose) -> Vector3<f64> {
        let local_from_camera = local_from_imu.rotation * self.first_camera().imu_from_camera.rotation;
        local_from_camera.inverse() * -Vector3::z()
    }
}
