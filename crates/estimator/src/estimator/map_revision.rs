//! The verb `map_changed`, and answers of other map versions; see [`map_revision`](crate::map_update::map_revision).

use super::Estimator;
use super::map_update::UpdateResult;
use crate::KeyframeId;
use crate::linear_algebra::dense::Dense;
use crate::map_update::map_answer::MapAnswer;
use crate::map_update::map_report::{MapReport, Rejection};
use crate::map_update::map_revision::{
    ChangeSize, KeyframeMotion, MAX_LINEAR_CHANGE_M, MapRevision, RevisionEffect, keyframe_wrt_motion,
    sigmas, transform_noise, transform_wrt_motion,
};
use crate::state::{Block, CloneId};
use nalgebra::{DVector, Matrix6, Vector6};
use std::collections::{HashMap, HashSet};

impl Estimator {
    /// Applies the announcement of a new map version.
    ///
    /// Call it when the announcement arrives, before [`Self::map_update`] with answers that arrived later. An announced
    /// change of known size keeps `global_from_local` with process noise and invalidates the changed keyframes; any other
    /// one makes the next answer of the new version initialize `global_from_local` again. See
    /// [`map_revision`](crate::map_update::map_revision) for the derivation.
    ///
    /// # Example
    /// ```
    /// # use estimator::{CalibratedCamera, Estimator, EstimatorConfig, InitialSigmas, InitialState};
    /// # use geometry::{Camera, Distortion, Pose};
    /// # use nalgebra::Vector3;
    /// use estimator::{ChangeSize, MapRevision, RevisionEffect};
    /// # let camera = Camera {
    /// #     width: 640, height: 480, focal: [400.0; 2], centre: [320.0, 240.0], distortion: Distortion::None,
    /// # };
    /// # let cameras = vec![CalibratedCamera::new(camera, Pose::identity())];
    /// # let (rest, down) = (Vector3::zeros(), -Vector3::z());
    /// # let start = InitialState::from_truth(0, &Pose::identity(), &rest, &down, InitialSigmas::default());
    /// # let mut estimator = Estimator::new(EstimatorConfig::default(), cameras, &start)?;
    /// let revision = MapRevision {
    ///     from_version: 1,
    ///     version: 2,
    ///     changed_keyframes: vec![40, 7],
    ///     size: Some(ChangeSize { sigma_rotation_rad: 1e-3, sigma_position_m: 0.02 }),
    ///     keyframe_motions: Vec::new(),
    /// };
    /// // This filter has not used the map yet, so the change does not affect it.
    /// assert_eq!(estimator.map_changed(&revision), RevisionEffect::None);
    /// assert_eq!(estimator.map_version(), None);
    /// # Ok::<(), estimator::EstimatorError>(())
    /// ```
    pub fn map_changed(&mut self, revision: &MapRevision) -> RevisionEffect {
        let Some(held) = self.map_version.in_use().filter(|held| *held != revision.version) else {
            return RevisionEffect::None;
        };
        if self.map_version.is_past(revision.from_version, revision.version) {
            return RevisionEffect::None;
        }
        let is_linear = |size: &ChangeSize| {
            // A rotation beyond the prior of `global_from_local` makes the present estimate useless.
            (0.0..=self.config.sigma_transform_rotation_rad).contains(&size.sigma_rotation_rad)
                && (0.0..=MAX_LINEAR_CHANGE_M).contains(&size.sigma_position_m)
        };
        let are_linear = revision.keyframe_motions.iter().all(|moved| {
            let (turn, shift) =
                (moved.motion.fixed_rows::<3>(0).norm(), moved.motion.fixed_rows::<3>(3).norm());
            turn <= self.config.sigma_transform_rotation_rad && shift <= MAX_LINEAR_CHANGE_M
        });
        match revision.size.filter(|size| is_linear(size) && are_linear) {
            Some(size) if held == revision.from_version => {
                if revision.keyframe_motions.is_empty() {
                    self.add_transform_noise(size);
                } else {
                    self.move_with_keyframes(&revision.changed_keyframes, &revision.keyframe_motions, size);
                }
                self.covariance.invalidate(&revision.changed_keyframes);
                self.contradiction = None;
                self.rejections_in_a_row = 0;
                let newest = self.state.clones.last();
                let since_ns = newest.map_or(self.state.stamp_ns, |clone| clone.stamp_ns);
                self.map_version.begin(revision.version, since_ns);
                RevisionEffect::CarriedOver
            }
            _ => {
                self.map_version.reinitialize_with(revision.version);
                RevisionEffect::Reinitialized
            }
        }
    }

    /// Process noise of `global_from_local`.
    pub(super) fn add_transform_noise(&mut self, size: ChangeSize) {
        if let Some(range) = self.state.range(Block::Transform) {
            let noise = transform_noise(&self.state.imu.local_from_imu.translation, size);
            self.covariance.add_noise(range.start, &noise);
            self.repeated_views.clear();
        }
    }

    /// Moves the state with the keyframes that it depends on, and adds process noise for what else it depends on.
    fn move_with_keyframes(&mut self, changed: &[KeyframeId], motions: &[KeyframeMotion], size: ChangeSize) {
        let transform = self.state.range(Block::Transform).zip(self.state.transform);
        let Some((range, global_from_local)) = transform else { return };
        let robot = self.state.imu.local_from_imu.translation;
        let robot_in_global = global_from_local.transform(&robot);
        let changed: HashSet<KeyframeId> = changed.iter().copied().collect();
        let motions: HashMap<KeyframeId, &Vector6<f64>> =
            motions.iter().map(|moved| (moved.id, &moved.motion)).collect();

        let held = &self.covariance.held;
        let mut with_map: Vec<(KeyframeId, Matrix6<f64>)> = Vec::new();
        let mut moved: Vec<(KeyframeId, Matrix6<f64>)> = Vec::new();
        for keyframe in held.keyframes() {
            let motion = motions.get(&keyframe.id);
            if motion.is_some() || !changed.contains(&keyframe.id) {
                let position = keyframe.global_from_keyframe.pose.translation;
                with_map.push((keyframe.id, keyframe_wrt_motion(&position, &robot_in_global)));
            }
            if let Some(motion) = motion {
                let mut column = Matrix6::zeros();
                column.set_column(0, motion);
                moved.push((keyframe.id, column));
            }
        }
        let weighted = |terms: &[(KeyframeId, Matrix6<f64>)]| -> Dense {
            held.error_by_keyframes(terms.iter().map(|(id, block)| (*id, block)))
        };
        let mut correction = DVector::zeros(self.state.dim());
        correction.copy_from_slice(weighted(&moved).column(0));
        let mut remainder = weighted(&with_map);
        let mut rows = remainder.view_mut();
        rows.neg_mut();
        let mut of_transform = rows.fixed_view_mut::<6, 6>(range.start, 0);
        of_transform += transform_wrt_motion(&global_from_local, &robot);
        for (mut column, sigma) in rows.column_iter_mut().zip(&sigmas(size)) {
            column *= *sigma;
        }
        self.covariance.add_noise_of_root(&remainder);
        self.repeated_views.clear();
        self.state.retract(&correction);
    }

    /// Updates with an answer of the version in use, or of another one as the module's documentation says. If
    /// `global_from_local` cannot be initialized with it, nothing is changed.
    pub(super) fn update_in_version(
        &mut self,
        clone: CloneId,
        answer: &MapAnswer,
        report: &mut MapReport,
    ) -> UpdateResult {
        let answered = answer.map_version;
        if let Some(held) = self.map_version.identity().filter(|held| *held != answer.map_identity) {
            return Ok(Err(Rejection::OtherMap { answered: answer.map_identity, held }));
        }
        let query_ns =
            self.state.clone_index(clone).map_or(i64::MIN, |index| self.state.clones[index].stamp_ns);
        if let Some(held) = self.map_version.in_use() {
            if answered == held {
                self.map_version.note_answer();
                return self.verify_and_update(clone, answer, report);
            }
            if query_ns <= self.map_version.since_ns() {
                return Ok(Err(Rejection::OldMapVersion { answered, held }));
            }
            let localized = self.state.transform.is_some();
            if self.map_version.awaits_announcement(answered, self.state.stamp_ns) && localized {
                return Ok(Err(Rejection::UnannouncedMapVersion { answered, held }));
            }
        }
        let before = (self.state.clone(), self.covariance.clone(), self.repeated_views.clone());
        let (known_in_map, support) = (self.known_in_map, self.support.clone());
        self.remove_transform();
        self.covariance.invalidate(&self.held_keyframes());
        let outcome = self.verify_and_update(clone, answer, report)?;
        if outcome.is_err() {
            (self.state, self.covariance, self.repeated_views) = before;
            (self.known_in_map, self.support) = (known_in_map, support);
        } else {
            self.map_version.begin(answered, query_ns);
            self.map_version.belong_to(answer.map_identity);
        }
        Ok(outcome)
    }
}
