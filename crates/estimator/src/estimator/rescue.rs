//! Rescue of a wrong state by the map.
//!
//! A filter that is wrong rejects right answers. Successive answers that agree with each other, by odometry or by the IMU,
//! and not with the state may show that it is the state; see [`map_fix`](crate::map_update::map_fix). They are weighed against
//! the evidence that the state has, since odometry last failed, from other places. Where they outweigh it, two of them make the
//! pose in G untrusted, and three replace it: `global_from_local` alone where odometry agrees with them, else the whole state, from
//! the poses of the map, the motion of the IMU between them and the direction of gravity in the map.

use super::Estimator;
use crate::error::EstimatorError;
use crate::initialization::static_init::{InitialState, gravity_aligned, yaw_between};
use crate::map_update::fixed_pose::FixedPose;
use crate::map_update::map_answer::MapAnswer;
use crate::map_update::map_fix::{FixedMotion, MapFix, worst_sigmas};
use crate::map_update::map_initializer::REQUIRED_ODDS;
use crate::map_update::map_report::{MapReport, Rejection};
use crate::map_update::map_revision::ChangeSize;
use crate::map_update::place_evidence::SeenPlace;
use crate::map_update::verification::VerifiedAnswer;
use crate::propagation::{IMU_DIM, ImuError, ImuState};
use crate::state::{CloneId, rotation_adjoint};
use geometry::{Pose, PoseWithCovariance};
use nalgebra::{Matrix6, Vector3, Vector6};

/// Successive fixes that make the pose in G untrusted.
const UNTRUSTED_AFTER: usize = 2;
/// The evidence against the state times this makes the pose in G untrusted where it outweighs that for it.
const UNTRUSTED_RATIO: f64 = 2.0;
/// Mean time until odometry fails or becomes overconfident without any sign of it, seconds.
const MEAN_TIME_TO_FAILURE_S: f64 = 600.0;
/// Successive fixes that replace it.
const REPLACED_AFTER: usize = 3;
/// Angle between gravity in the map and in the state beyond which the state is tilted, rad: odometry agrees with the map then
/// for a short time only.
const MAX_TILT_RAD: f64 = 0.04;
/// An answer that is nearer to the state than this, metres and rad, is of the same place, whatever it contradicts.
const NEAR: [f64; 2] = [2.0, 0.2];
/// Error of a wrong state's biases in its own standard deviations.
const BIAS_SIGMAS: f64 = 10.0;
/// Factor on the variances of a pose that restarts the filter. Its keyframe is not held, so that a later answer with it counts the error
/// of the keyframe again, as independent: both together state `f / (f + 1)` of its variance.
const UNHELD_INFLATION: f64 = 10.0;

impl Estimator {
    /// The pose by the map alone, as evidence in case that the state contradicts it.
    pub(super) fn note_fix(
        &mut self,
        clone: CloneId,
        answer: &MapAnswer,
        verified: &VerifiedAnswer,
        measured: &PoseWithCovariance,
    ) {
        self.newest_fix = None;
        let (Some(index), Some(transform)) = (self.state.clone_index(clone), self.state.transform) else {
            return;
        };
        let Some(predicted) = self.global_from_camera(clone, answer.camera) else { return };
        let together = PoseWithCovariance::new(predicted.pose, predicted.covariance + measured.covariance);
        let clone = &self.state.clones[index];
        let (sigma_rotation, sigma_position) = worst_sigmas(&measured.covariance);
        self.newest_fix = Some(MapFix {
            stamp_ns: clone.stamp_ns,
            global_from_imu: measured.pose * self.camera_of(answer).imu_from_camera.inverse(),
            predicted: transform * clone.local_from_imu,
            local_from_imu: clone.local_from_imu,
            keyframe: verified.best,
            squared: together.nees(&measured.pose).unwrap_or(f64::INFINITY),
            sigma_rotation,
            sigma_position,
            seen: self.seen_place(answer, verified),
        });
    }

    /// What the inliers of an answer show. The answer's odds are those of the pose at which the server counted its matches: where the
    /// pose that was verified here explains only a minority of them, it is another one, and the odds do not speak for it.
    pub(super) fn seen_place(&self, answer: &MapAnswer, verified: &VerifiedAnswer) -> SeenPlace {
        let in_global = |&k: &usize| {
            let landmark = &answer.landmarks[k];
            Some(self.pose_of(landmark.anchor, answer)?.transform(&landmark.position_in_anchor))
        };
        let landmarks: Vec<_> = verified.inliers.iter().filter_map(in_global).collect();
        let log_ratio = answer.log_odds - answer.log_prior_odds;
        let is_minority = 2 * verified.inliers.len() < answer.landmarks.len();
        let log_ratio = if is_minority { log_ratio.min(0.0) } else { log_ratio };
        SeenPlace::of(&landmarks, log_ratio, answer.log_prior_odds)
    }

    /// An answer agrees with the state, and is evidence for it.
    pub(super) fn note_support(&mut self) {
        let Some(fix) = self.newest_fix else { return };
        self.map_fixes.clear();
        self.against.clear();
        self.support.add(fix.seen);
    }

    /// Odometry failed: what it ties together is no longer evidence.
    pub(super) fn note_odometry_failure(&mut self) {
        self.support.clear();
        self.map_initializer.note_odometry_failure();
        self.repeated_views.clear();
        self.forget_located();
    }

    /// Whether evidence against the state is more than the state has: that of the answers which support it, and at most the odds
    /// that odometry has not failed unnoticed since the last of them.
    pub(super) fn is_outweighed_by(&self, log_odds: f64) -> bool {
        let elapsed_s = self
            .last_map_update_ns
            .map_or(f64::INFINITY, |last_ns| (self.state.stamp_ns - last_ns) as f64 * 1e-9);
        let odometry_log_odds = (MEAN_TIME_TO_FAILURE_S / elapsed_s.max(1.0)).ln().max(0.0);
        log_odds >= self.support.log_odds().min(odometry_log_odds)
    }

    /// By how much the pose of an answer of the same place is beyond the covariances: what noise the state lacks.
    pub(super) fn missing_noise(&self) -> Option<ChangeSize> {
        let fix = self.newest_fix?;
        let apart = fix.predicted.local(&fix.global_from_imu);
        let (turned, shifted) = (apart.fixed_rows::<3>(0).norm(), apart.fixed_rows::<3>(3).norm());
        let is_near = shifted < NEAR[0] && turned < NEAR[1];
        let an_axis = 3.0_f64.sqrt().recip();
        is_near.then_some(ChangeSize {
            sigma_rotation_rad: turned * an_axis,
            sigma_position_m: shifted * an_axis,
        })
    }

    /// Whether the last answer is evidence against the state although it updated it.
    pub(super) fn is_doubted_by(&self, answer: &MapAnswer, report: &MapReport) -> bool {
        // A minority that agrees updates the state, but does not confirm it.
        !report.initialized
            && (report.inflated
                || 2 * report.plausible < report.inliers
                || self.newest_fix.is_some_and(|fix| fix.is_far())
                || self.remains_tilted(answer))
    }

    /// Whether gravity in the map is not where the state says, after an answer that was evidence against the state:
    /// `global_from_local` took in the tilt of the state, and only for a moment does the pose in G look right.
    fn remains_tilted(&self, answer: &MapAnswer) -> bool {
        let (Some(down), Some(transform)) = (answer.gravity_in_global, self.state.transform) else {
            return false;
        };
        !self.map_fixes.is_empty() && (transform.rotation * -Vector3::z()).angle(&down) > MAX_TILT_RAD
    }

    /// Whether the map contradicts the pose in G.
    pub(super) fn is_contradicted(&self) -> Option<usize> {
        let is_untrusted = |count: &usize| {
            *count >= UNTRUSTED_AFTER && self.is_outweighed_by(UNTRUSTED_RATIO * self.map_fixes.log_odds())
        };
        Some(self.map_fixes.len()).filter(is_untrusted)
    }

    /// Takes in a rejected answer as evidence against the state, and gives way to enough of it.
    ///
    /// # Errors
    /// [`EstimatorError::Diverged`]: the filter must be initialized again.
    pub(super) fn give_way(
        &mut self,
        clone: CloneId,
        answer: &MapAnswer,
        report: &mut MapReport,
    ) -> Result<(), EstimatorError> {
        let (Some(fix), Some(index)) = (self.newest_fix.take(), self.state.clone_index(clone)) else {
            return Ok(());
        };
        if !self.map_fixes.is_evidence(&fix) || self.map_fixes.add(fix) < REPLACED_AFTER {
            return Ok(());
        }
        let log_odds = self.map_fixes.log_odds();
        if log_odds < REQUIRED_ODDS.ln() || !self.is_outweighed_by(log_odds) {
            return Ok(());
        }
        let gravity = answer.gravity_in_global.map(|down| down * self.config.gravity);
        let is_tilted =
            gravity.is_some_and(|gravity| self.map_fixes.tilt(&gravity, REPLACED_AFTER) > MAX_TILT_RAD);
        if self.map_fixes.agree_by_odometry(REPLACED_AFTER) && !is_tilted {
            self.refute_transform();
            self.contradiction = None;
            let newest = FixedPose {
                global_from_imu: fix.global_from_imu,
                local_from_imu: self.state.clones[index].local_from_imu,
                sigma_rotation: fix.sigma_rotation,
                sigma_position: fix.sigma_position,
            };
            self.map_initializer.begin_with(answer.map_version, newest, self.map_fixes.evidence());
            self.lost_after = Some(self.map_fixes.len());
            (self.last_map_update_ns, self.last_gnss_update_ns) = (None, None);
            self.support.clear();
            self.against.clear();
            self.map_fixes.clear();
            report.rejection = self.update_in_version(clone, answer, report)?.err();
            if report.rejection.is_none() {
                self.note_success();
                self.map_initializer.clear();
            }
            return Ok(());
        }
        let Some(gravity) = gravity else { return Ok(()) };
        let newest_ns = self.state.clones.last().map_or(self.state.stamp_ns, |newest| newest.stamp_ns);
        if let Some(motion) = self.map_fixes.fixed_motion(&gravity, newest_ns) {
            let fixes = self.map_fixes.len();
            self.restart(&self.state_of(&motion, &gravity), &motion)?;
            report.rejection = Some(Rejection::Restarted { fixes });
        }
        Ok(())
    }

    /// The state of a motion in G; position and yaw in L are continuous.
    fn state_of(&self, motion: &FixedMotion, gravity: &Vector3<f64>) -> InitialState {
        let body_from_global = motion.global_from_imu.rotation.inverse();
        let upright = gravity_aligned(&(body_from_global * -gravity));
        let now = &self.state.imu.local_from_imu;
        let rotation = yaw_between(&upright, &now.rotation) * upright;
        let mut sigmas = self.config.initial;
        sigmas.sigma_tilt_rad = motion.sigma_rotation;
        sigmas.sigma_velocity_m_s = motion.sigma_velocity;
        // The biases may be what is wrong.
        let (gyroscope, accelerometer) = self.sigma_biases();
        let widened = |sigma: Vector3<f64>, unknown: f64| (BIAS_SIGMAS * sigma.max()).min(unknown);
        sigmas.sigma_gyroscope_bias_rad_s = widened(gyroscope, sigmas.sigma_gyroscope_bias_rad_s);
        sigmas.sigma_accelerometer_bias_m_s2 = widened(accelerometer, sigmas.sigma_accelerometer_bias_m_s2);
        InitialState {
            stamp_ns: self.state.stamp_ns,
            imu: ImuState {
                local_from_imu: Pose::new(rotation, now.translation),
                velocity: rotation * (body_from_global * motion.velocity),
                ..self.state.imu
            },
            covariance: sigmas.covariance(),
        }
    }

    /// Continues as a new filter from another state, at the pose in G of a motion; noise, calibration, readings, and the version of the
    /// map are kept.
    fn restart(&mut self, initial: &InitialState, motion: &FixedMotion) -> Result<(), EstimatorError> {
        let mut fresh = Self::new(self.config.clone(), self.state.calibration.cameras.clone(), initial)?;
        // The settings state readout times for the start.
        fresh.state.calibration.cameras.clone_from(&self.state.calibration.cameras);
        fresh.state.calibration.time_offset = self.state.calibration.time_offset;
        if let Some(learned) = self.learned_wheels() {
            fresh.resume_wheels(&learned);
        }
        fresh.resume_counts(self.gnss_counts(), self.wheels.as_ref().map(|wheels| wheels.counts));
        fresh.imu = std::mem::take(&mut self.imu);
        fresh.noise = self.noise.clone();
        fresh.repetition = self.repetition.clone();
        fresh.map_version = self.map_version.clone();
        fresh.map_gravity = self.map_gravity;
        fresh.map_watch = std::mem::take(&mut self.map_watch);
        fresh.next_clone = self.next_clone;
        fresh.support = self.map_fixes.evidence();
        fresh.last_map_update_ns = Some(initial.stamp_ns);
        fresh.insert_fixed_transform(motion);
        fresh.note_known();
        *self = fresh;
        Ok(())
    }

    /// Adds `global_from_local` to the state by the pose of a motion in G, with variances that allow for a later answer of its keyframe.
    fn insert_fixed_transform(&mut self, motion: &FixedMotion) {
        let variance = |k: usize| {
            UNHELD_INFLATION * if k < 3 { motion.sigma_rotation } else { motion.sigma_position }.powi(2)
        };
        let covariance = Matrix6::from_diagonal(&Vector6::from_fn(|k, _| variance(k)));
        let imu_from_local = self.state.imu.local_from_imu.inverse();
        let global_from_imu = PoseWithCovariance::new(motion.global_from_imu, covariance);
        let global_from_local = global_from_imu.change_of_child(&imu_from_local);
        // Of the error in G, as the state has it: in the axes of L.
        let adjoint = rotation_adjoint(&global_from_local.pose);
        let covariance = adjoint.tr_mul(&global_from_local.covariance) * adjoint;
        self.insert_transform(&PoseWithCovariance::new(global_from_local.pose, covariance));
    }

    /// Moves the state of the IMU without telling the covariance, as an undetected failure would: for tests of recovery.
    ///
    /// # Arguments
    /// * `error`: `[δθ, δp, δv, δb_g, δb_a]` in L, rad, metres, m/s, rad/s, m/s^2.
    pub fn displace(&mut self, error: &[f64; IMU_DIM]) {
        self.state.imu = self.state.imu.retract(&ImuError::from_row_slice(error));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::alignment::Located;
    use crate::propagation::ImuMatrix;
    use crate::{CalibratedCamera, EstimatorConfig, GnssConfig};
    use geometry::camera::{Camera, Distortion};
    use geometry::rotation;
    use nalgebra::Matrix3;

    /// A filter that starts at a pose that is known.
    fn estimator(config: &EstimatorConfig, local_from_imu: Pose) -> Estimator {
        let (focal, centre) = ([400.0; 2], [320.0, 240.0]);
        let camera = Camera { width: 640, height: 480, focal, centre, distortion: Distortion::None };
        let imu = ImuState {
            local_from_imu,
            velocity: Vector3::zeros(),
            gyroscope_bias: Vector3::zeros(),
            accelerometer_bias: Vector3::zeros(),
        };
        let initial = InitialState { stamp_ns: 0, imu, covariance: ImuMatrix::identity() * 1e-12 };
        let rig = vec![CalibratedCamera::new(camera, Pose::identity())];
        Estimator::new(config.clone(), rig, &initial).unwrap()
    }

    /// Far from the origin of L and turned against it.
    #[test]
    fn a_motion_by_fixes_is_as_uncertain_in_the_map_as_it_states() {
        for (yaw, metres) in [(0.0, 0.0), (0.8, 20.0), (1.6, 100.0), (3.1, 100.0)] {
            let local_from_imu = Pose::new(rotation::exp(&(Vector3::z() * 0.3)), Vector3::x() * metres);
            let mut estimator = estimator(&EstimatorConfig::default(), local_from_imu);
            let turn = rotation::exp(&Vector3::new(0.02, -0.01, yaw));
            let motion = FixedMotion {
                global_from_imu: Pose::new(turn, Vector3::new(7.0, -3.0, 1.0)),
                velocity: Vector3::zeros(),
                sigma_rotation: 0.01,
                sigma_position: 0.05,
                sigma_velocity: 0.1,
            };
            estimator.insert_fixed_transform(&motion);
            let claimed = estimator.filtered_global_from_imu().unwrap();
            assert!(claimed.pose.local(&motion.global_from_imu).norm() < 1e-9);
            let (rotation, position) = (UNHELD_INFLATION * 1e-4, UNHELD_INFLATION * 2.5e-3);
            let stated = Matrix6::from_diagonal(&Vector6::new(
                rotation, rotation, rotation, position, position, position,
            ));
            let off = (claimed.covariance - stated).amax();
            assert!(off < 1e-6, "{yaw} rad, {metres} m: {}", claimed.covariance);
        }
    }

    #[test]
    fn positions_from_before_a_failure_do_not_bring_the_old_transform_back() {
        let config = EstimatorConfig { gnss: Some(GnssConfig::default()), ..EstimatorConfig::default() };
        let mut estimator = estimator(&config, Pose::identity());
        let turned = |at: Vector3<f64>| rotation::exp(&(Vector3::z() * 0.5)) * at;
        let locate = |estimator: &mut Estimator, from: i64| {
            let gnss = estimator.gnss.as_mut().unwrap();
            for step in from..from + 30 {
                let seconds = step as f64;
                let in_local = Vector3::new(1.5 * seconds, 10.0 * (0.1 * seconds).sin(), 0.0);
                gnss.locate(Located {
                    stamp_ns: step * 1_000_000_000,
                    in_local,
                    in_global: turned(in_local),
                    covariance: Matrix3::identity() * 1e-4,
                });
            }
        };
        let initialized = |estimator: &mut Estimator| {
            let mut gnss = estimator.gnss.take().unwrap();
            estimator.initialize_by_gnss(&mut gnss, i64::MIN);
            estimator.gnss = Some(gnss);
            estimator.state.transform.is_some()
        };
        locate(&mut estimator, 0);
        estimator.note_odometry_failure();
        assert!(!initialized(&mut estimator));
        locate(&mut estimator, 30);
        assert!(initialized(&mut estimator));
    }
}
