//! The map update: verify an answer, initialize or relinearize, linearize, gate, update.

use super::Estimator;
use super::map_linearization::LinearizedMapUpdate;
use crate::KeyframeId;
use crate::config::{MapMode, Relinearization};
use crate::error::EstimatorError;
use crate::map_update::map_answer::{MapAnswer, MapKeyframe, MatchedLandmark};
use crate::map_update::map_measurement::{Linearization, LinearizationPoint};
use crate::map_update::map_report::{MapReport, Rejection};
use crate::map_update::repeated_views::View;
use crate::map_update::solved_pose::median_depth;
use crate::map_update::verification::{VerificationSettings, VerifiedAnswer, verify};
use crate::measurement::Information;
use crate::noise_adaptation::correction::BeforeUpdate;
use crate::schmidt::HeldKeyframes;
use crate::state::CloneId;
use geometry::PoseWithCovariance;
use nalgebra::Vector3;

/// Updated, rejected, or failed.
pub(super) type UpdateResult = Result<Result<(), Rejection>, EstimatorError>;

impl Estimator {
    /// Updates the state with the map's answer to the query of an image.
    ///
    /// Verifies the matches by PnP, pulls the keyframes of the answer as nuisance states, gates every landmark and the whole
    /// update, and updates the active state; the first accepted answer initializes `global_from_local`. A rejected answer is
    /// a report, not an error, and leaves the state unchanged.
    ///
    /// # Arguments
    /// * `clone`: of the query image, as [`Self::time_update`] returned it; [pinned](Self::pin) since then.
    ///
    /// # Errors
    /// [`EstimatorError::Diverged`]: the filter must be initialized again.
    ///
    /// # Example
    /// A body at rest sees twelve landmarks of a map with one keyframe, whose frame G is L moved by 10 m.
    /// ```
    /// # use estimator::{CalibratedCamera, Estimator, EstimatorConfig, ImuSample, InitialSigmas, InitialState};
    /// # use geometry::{Camera, Distortion};
    /// use estimator::{Localization, MapAnswer, MapKeyframe, MatchedLandmark};
    /// use geometry::{Pose, PoseWithCovariance};
    /// use nalgebra::{Matrix6, Matrix6xX, Vector3};
    /// # let camera = Camera {
    /// #     width: 640, height: 480, focal: [400.0; 2], centre: [320.0, 240.0], distortion: Distortion::None,
    /// # };
    /// # let cameras = vec![CalibratedCamera::new(camera.clone(), Pose::identity())];
    /// # let (rest, down) = (Vector3::zeros(), -Vector3::z());
    /// # let start = InitialState::from_truth(0, &Pose::identity(), &rest, &down, InitialSigmas::default());
    /// # let mut estimator = Estimator::new(EstimatorConfig::default(), cameras, &start)?;
    /// let clone = estimator.time_update(0)?;
    /// estimator.pin(clone);
    ///
    /// // What a map would answer.
    /// let global_from_keyframe = Pose { translation: Vector3::new(10.0, 0.0, 0.0), ..Pose::identity() };
    /// let landmarks = (0..12).map(|k| {
    ///     let k = f64::from(k);
    ///     let position = Vector3::new((1.3 * k).sin(), (2.1 * k).cos(), 4.0 + 0.2 * k);
    ///     let pixel = camera.project(&position).unwrap();
    ///     MatchedLandmark { pixel, anchor: 7, position_in_anchor: position, observations: vec![(7, pixel)] }
    /// });
    /// let answer = MapAnswer {
    ///     map_version: 1,
    ///     map_identity: 1,
    ///     camera: 0,
    ///     keyframes: vec![MapKeyframe {
    ///         id: 7,
    ///         global_from_keyframe: PoseWithCovariance::new(global_from_keyframe, Matrix6::identity() * 1e-4),
    ///         camera: camera.clone(),
    ///         common_error: Matrix6xX::zeros(0),
    ///         cross_covariances: Vec::new(),
    ///     }],
    ///     held_at_query: estimator.held_keyframes(),
    ///     landmarks: landmarks.collect(),
    ///     gravity_in_global: Some(-Vector3::z()),
    ///     sigma_map_px: 1.0,
    ///     log_odds: 10.0,
    ///     log_prior_odds: 0.0,
    /// };
    /// let report = estimator.map_update(clone, &answer)?;
    /// estimator.unpin(clone);
    ///
    /// assert_eq!(report.rejection, None);
    /// assert!(report.initialized);
    /// assert_eq!(estimator.held_keyframes(), [7]);
    /// assert_eq!(estimator.status().localization, Localization::Localized);
    /// let global_from_imu = estimator.global_from_imu().unwrap();
    /// assert!((global_from_imu.pose.translation - Vector3::new(10.0, 0.0, 0.0)).norm() < 0.1);
    /// // Never more accurate than the keyframe.
    /// assert!(global_from_imu.covariance[(3, 3)] > 1e-4);
    /// # Ok::<(), estimator::EstimatorError>(())
    /// ```
    pub fn map_update(&mut self, clone: CloneId, answer: &MapAnswer) -> Result<MapReport, EstimatorError> {
        let same_map = self.map_version.in_use() == Some(answer.map_version);
        let restricted = self.restrict(answer);
        let held = same_map.then_some(&self.covariance.held);
        let common_dim = held.and_then(HeldKeyframes::common_dim);
        let answer =
            restricted.without_invalid(&|id| held.and_then(|held| held.map_covariance(id)), common_dim);
        let mut report = MapReport {
            keyframes: answer.keyframes.len(),
            matches: answer.landmarks.len(),
            inliers: 0,
            used: 0,
            plausible: 0,
            mean_reprojection_px: None,
            relinearized: false,
            inflated: false,
            initialized: false,
            hypotheses_dropped: 0,
            nis: None,
            rejection: None,
        };
        if self.camera(answer.camera).is_none() {
            let rejection = Some(Rejection::NoCamera { camera: answer.camera });
            return Ok(MapReport { rejection, ..report });
        }
        let answer = self.seen_from_the_image(clone, answer);
        let before =
            self.filtered_global_from_imu().or_else(|| self.map_watch.predict(&self.local_from_imu()));
        report.rejection = self.update_in_version(clone, &answer, &mut report)?.err();
        match report.rejection {
            None => {
                self.note_success();
                if report.initialized {
                    self.map_initializer.clear();
                }
                if self.is_doubted_by(&answer, &report) {
                    self.give_way(clone, &answer, &mut report)?;
                } else {
                    self.note_support();
                }
                self.note_known();
            }
            Some(
                Rejection::Far { .. }
                | Rejection::Implausible { .. }
                | Rejection::FewLandmarks { .. }
                | Rejection::Contradicts { .. },
            ) => {
                self.note_contradiction();
                self.give_way(clone, &answer, &mut report)?;
            }
            Some(_) => {}
        }
        if let (None, true, Some(after)) =
            (&report.rejection, self.config.mode != MapMode::MapConst, self.filtered_global_from_imu())
        {
            self.map_watch.note(self.state.stamp_ns, before.as_ref(), &after, &self.local_from_imu());
        }
        self.covariance.held.deactivate_unused();
        self.covariance.evict(self.config.max_held_keyframes);
        Ok(report)
    }

    /// An answer updated the state: what was noted against it does not count any more.
    pub(super) fn note_success(&mut self) {
        self.rejections_in_a_row = 0;
        self.lost_after = None;
        self.last_map_update_ns = Some(self.state.stamp_ns);
    }

    /// The part of an answer that the mode allows and whose correlation with the held keyframes is known.
    fn restrict(&mut self, answer: &MapAnswer) -> MapAnswer {
        let mut restricted = answer.clone();
        let correlated = self.covariance.held.has_correlations()
            || answer.keyframes.iter().any(MapKeyframe::is_correlated);
        if self.map_version.in_use() == Some(answer.map_version) {
            let held = self.held_keyframes();
            restricted.remove_forgotten(&held);
            if correlated {
                restricted.remove_unknown_correlations(&held);
            }
        }
        if self.config.mode == MapMode::Single {
            restricted.keyframes.truncate(1);
        }
        restricted.remove_dangling_references();
        if self.map_version.identity().is_none_or(|held| held == answer.map_identity) {
            restricted.gravity_in_global = self.map_gravity.believed(answer.gravity_in_global);
        }
        restricted
    }

    /// Verifies an answer of the map version in use, and updates with it.
    pub(super) fn verify_and_update(
        &mut self,
        clone: CloneId,
        answer: &MapAnswer,
        report: &mut MapReport,
    ) -> UpdateResult {
        if self.config.mode == MapMode::Odometry {
            return Ok(Err(Rejection::Odometry));
        }
        let Some(index) = self.state.clone_index(clone) else { return Ok(Err(Rejection::TooLate)) };
        let local_from_imu = self.state.clones[index].local_from_imu;
        let first_position =
            self.config.first_estimates.then_some(self.state.clones[index].first_estimate.translation);
        let settings = VerificationSettings {
            angle: self.config.verify_angle_rad,
            min_inliers: self.config.min_inliers,
            gravity_in_camera: self.gravity_in_camera(clone, answer.camera),
        };
        let verified = verify(answer, self.camera_of(answer), &settings).or_else(|rejection| {
            // A wrong direction of gravity in the map must not hide itself.
            let unguided = VerificationSettings { gravity_in_camera: None, ..settings };
            let may_be_wrong = self.state.transform.is_none() && answer.gravity_in_global.is_some();
            if may_be_wrong { verify(answer, self.camera_of(answer), &unguided) } else { Err(rejection) }
        });
        let verified = match verified {
            Ok(verified) => verified,
            Err(rejection) => return Ok(Err(rejection.into())),
        };
        report.inliers = verified.inliers.len();

        let Some(best) = answer.keyframe(verified.best) else { return Ok(Err(Rejection::TooLate)) };
        let global_from_imu = self.pose_of(best.id, answer).unwrap_or(best.global_from_keyframe.pose)
            * verified.best_from_camera.pose
            * self.camera_of(answer).imu_from_camera.inverse();
        let solved_transform = global_from_imu * local_from_imu.inverse();
        report.initialized = self.state.transform.is_none();
        let measured = best.global_from_keyframe.change_of_child(&verified.best_from_camera.pose);
        let with_noise = self.with_pnp_noise(answer, &verified, &measured);
        if report.initialized
            && let Err(waiting) =
                self.admit_map_initialization(&local_from_imu, answer, &verified, &with_noise, report)
        {
            report.initialized = false;
            return Ok(Err(waiting));
        }
        let seen = solved_transform.rotation * -Vector3::z();
        if report.initialized {
            self.map_gravity.review(seen);
        }
        // A picture that repeats shows a wrong direction, too: only a place that is believed is evidence against the map's.
        if report.initialized
            && self.map_gravity.fault().is_none_or(|known| known.stated.is_none())
            && let Err(fault) = self.map_gravity.compare(answer.gravity_in_global, seen)
        {
            report.initialized = false;
            return Ok(Err(fault.into()));
        }
        let transform = self.state.transform.unwrap_or(solved_transform);
        let estimate = LinearizationPoint { local_from_imu, global_from_local: transform };

        let mean_error = self.mean_reprojection(answer, &verified, &estimate);
        report.mean_reprojection_px = mean_error;
        // A landmark that does not project at the estimate has an infinite error.
        let relinearize = mean_error.is_none_or(|error| error > self.config.relinearize_above_px);
        let mut at = estimate;
        if relinearize && !report.initialized {
            match self.config.relinearization {
                Relinearization::Off => {}
                Relinearization::Transform => at.global_from_local = solved_transform,
                Relinearization::Clone => at.local_from_imu = transform.inverse() * global_from_imu,
            }
            report.relinearized = at != estimate;
        }

        if report.initialized {
            self.insert_solved_transform(solved_transform, median_depth(answer, &verified));
        }
        self.note_fix(clone, answer, &verified, &with_noise);
        let point = Linearization { estimate, at, first_position };
        let mut outcome = self.iterate(clone, answer, &verified, point, &measured, report)?;
        if let (Err(Rejection::Far { .. }), Some(missing)) = (&outcome, self.missing_noise()) {
            let before = (self.covariance.clone(), self.repeated_views.clone());
            self.add_transform_noise(missing);
            outcome = self.iterate(clone, answer, &verified, point, &measured, report)?;
            report.inflated = outcome.is_ok();
            if !report.inflated {
                (self.covariance, self.repeated_views) = before;
            }
        }
        if outcome.is_err() && report.initialized {
            self.remove_transform();
            report.initialized = false;
        }
        Ok(outcome)
    }

    /// Gauss-Newton iterations on the map measurements, and the update at the last linearization point.
    ///
    /// # Arguments
    /// * `measured`: the camera of the answer in G at `clone` according to the answer.
    fn iterate(
        &mut self,
        clone: CloneId,
        answer: &MapAnswer,
        verified: &VerifiedAnswer,
        mut point: Linearization,
        measured: &PoseWithCovariance,
        report: &mut MapReport,
    ) -> UpdateResult {
        let landmarks: Vec<&MatchedLandmark> =
            verified.inliers.iter().map(|&k| &answer.landmarks[k]).collect();
        let inliers = landmarks.len();
        let keyframes = self.keyframes_of(&landmarks, answer);
        let new: Vec<KeyframeId> =
            keyframes.iter().copied().filter(|&id| !self.covariance.held.contains(id)).collect();
        let columns = self.pull_keyframes(clone, &keyframes, answer);
        let exact = self.config.mode == MapMode::MapConst;
        for iteration in 1..=self.config.map_iterations {
            let rows = self.linearize(&landmarks, answer, &keyframes, &point);
            // A map that is taken as exact is taken at its word.
            let noise = (!exact).then(|| self.noise_of_matches(&rows, &columns, verified));
            let sigma_factor = noise.as_ref().map_or(1.0, |noise| noise.sigma_factor);
            let mut linearized = self.gate(&rows, &columns, sigma_factor);
            if report.initialized {
                self.add_solved_pose(&mut linearized.information, answer, verified, &keyframes, &point);
            }
            let LinearizedMapUpdate { mut information, used, plausible } = linearized;
            (report.used, report.plausible) = (used, plausible);
            let agrees = exact || 2 * plausible >= inliers;
            let passes = iteration > 1 || self.passes_outlier_test(agrees, (clone, answer.camera), measured);
            let need = self.config.min_inliers.div_ceil(2);
            if used < need {
                return Ok(Err(self.revert_pull(&new, Rejection::FewLandmarks { used, inliers, need })));
            }
            if !passes {
                return Ok(Err(self.revert_pull(&new, Rejection::Contradicts { plausible, inliers })));
            }
            let rows = information.rows;
            let Ok(nis) = self.covariance.information_nis(&information) else {
                return Ok(Err(self.revert_pull(&new, Rejection::InconsistentMap)));
            };
            report.nis = Some((nis.total, rows));
            // With an exact map this gate would fail all the time; only the landmarks are gated then.
            if !exact && !self.frame_gate.accepts(nis.total, rows) {
                let (nis, bound) = (nis.total, self.frame_gate.bound(rows));
                return Ok(Err(self.revert_pull(&new, Rejection::Implausible { nis, rows, bound })));
            }
            let tests_pose = iteration == 1 && !report.initialized && !exact;
            if tests_pose && !self.contradiction_gate.accepts(nis.explained, nis.rank) {
                let (nis, rows) = (nis.explained, nis.rank);
                return Ok(Err(self.revert_pull(&new, Rejection::Far { nis, rows })));
            }
            if iteration < self.config.map_iterations {
                point.at = self.next_point(clone, &information, &point)?;
                continue;
            }
            let view = if exact { None } else { self.view_of(clone, answer, verified, &keyframes) };
            if let Some(view) = &view {
                // Gates are for what an answer says, whatever has been said before.
                information.scale(self.weight_of(view));
            }
            let before = BeforeUpdate::of(&self.state.imu, &self.covariance);
            self.covariance.information_update(&information, &mut self.correction)?;
            self.state.retract(&self.correction);
            if let Some(view) = &view {
                let sigmas = self.sigmas_in_map();
                self.repeated_views.note(view, sigmas);
            }
            if let Some(noise) = noise {
                self.noise.accept_matches(noise);
                if !report.initialized {
                    self.note_correction(&before);
                }
            }
            self.check_health()?;
        }
        Ok(Ok(()))
    }

    /// What an answer shows, and from where.
    fn view_of(
        &self,
        clone: CloneId,
        answer: &MapAnswer,
        verified: &VerifiedAnswer,
        keyframes: &[KeyframeId],
    ) -> Option<View> {
        Some(View {
            camera: answer.camera,
            keyframes: keyframes.into(),
            local_from_imu: self.state.clones[self.state.clone_index(clone)?].local_from_imu,
            depth_m: median_depth(answer, verified),
        })
    }

    /// How much an answer counts that is used: less where others were used from the same place, once the position is known well enough.
    fn weight_of(&mut self, view: &View) -> f64 {
        let sigmas = self.sigmas_in_map();
        let weight = self.repeated_views.weight(view, sigmas);
        if self.known_in_map { weight } else { 1.0 }
    }

    /// Removes the keyframes that a rejected answer pulled.
    fn revert_pull(&mut self, new: &[KeyframeId], rejection: Rejection) -> Rejection {
        self.covariance.held.remove_unused(new);
        rejection
    }

    /// Clone and transform after one Gauss-Newton step; the filter is unchanged.
    fn next_point(
        &mut self,
        clone: CloneId,
        information: &Information,
        point: &Linearization,
    ) -> Result<LinearizationPoint, EstimatorError> {
        self.covariance.information_correction(information, &mut self.correction)?;
        let mut next = self.state.clone();
        next.retract(&self.correction);
        let index = next.clone_index(clone);
        Ok(LinearizationPoint {
            local_from_imu: index.map_or(point.at.local_from_imu, |index| next.clones[index].local_from_imu),
            global_from_local: next.transform.unwrap_or(point.at.global_from_local),
        })
    }
}
