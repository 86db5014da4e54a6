//! Propagation to an image, cloning, marginalization of clones.

use super::Estimator;
use crate::error::EstimatorError;
use crate::first_estimates;
use crate::health::Divergence;
use crate::linear_algebra::dependence::Dependence;
use crate::map_update::map_fix::ImuMotion;
use crate::motion::AngularRate;
use crate::propagation::{IMU_DIM, MotionEstimate, Propagation, noise_of_a_guess};
use crate::rolling_shutter::motion_around::TimedPoses;
use crate::state::{ActiveState, Block, CloneId, ClonedPose, POSE_DIM};
use nalgebra::{Vector3, Vector6};
use smallvec::SmallVec;
use std::ops::Range;
use types::ImuSample;

/// Maximum time by which the IMU samples may end before an image, nanoseconds.
pub(super) const IMU_SLACK_NS: i64 = 20_000_000;

/// Longest gap between IMU samples that is bridged, nanoseconds. The attitude is uncertain by 0.5 rad a second in it, and beyond
/// this, updates are too far from linear: the state may run away.
const MAX_GAP_NS: i64 = 1_200_000_000;

/// Gap between IMU samples after which odometry is no evidence, nanoseconds: what the state knew of the map before may not hold.
const FAILURE_GAP_NS: i64 = 100_000_000;

impl Estimator {
    /// Stores an IMU sample for the next [`Self::time_update`]. Samples come in the order of time.
    ///
    /// # Errors
    /// [`EstimatorError::BadImu`] for a sample that is not finite or not newer than the one before. It was dropped; the
    /// filter goes on.
    pub fn imu(&mut self, sample: ImuSample) -> Result<(), EstimatorError> {
        self.imu.push(sample)?;
        self.repetition.note(&sample, || self.noise.do_readings_show_noise());
        if !self.repetition.repeats() {
            self.noise.note_reading(&sample);
        }
        Ok(())
    }

    /// Propagates the state to the time of an image and clones its pose.
    ///
    /// Clones beyond the window are marginalized, except pinned ones.
    ///
    /// # Arguments
    /// * `stamp_ns`: by the camera's clock, nanoseconds; the estimated time offset is added to it. IMU samples must reach
    ///   up to 20 ms before [`Self::imu_stamp_ns`] of it.
    ///
    /// # Returns
    /// The identity of the clone, for [`Self::pin`] and [`Self::map_update`].
    ///
    /// # Errors
    /// [`EstimatorError::OldFrame`], [`EstimatorError::NoImu`]: the filter is unchanged.
    /// [`EstimatorError::Diverged`]: it must be initialized again.
    pub fn time_update(&mut self, stamp_ns: i64) -> Result<CloneId, EstimatorError> {
        let from_ns = self.state.stamp_ns;
        let to_ns = self.imu_stamp_ns(stamp_ns);
        if to_ns <= from_ns && !self.state.clones.is_empty() || to_ns < from_ns {
            return Err(EstimatorError::OldFrame { stamp_ns, state_ns: from_ns });
        }
        let mut motion_before = None;
        if to_ns > from_ns {
            let before = self.state.imu;
            motion_before = self.propagate_to(to_ns)?;
            let gravity = -Vector3::z() * self.config.gravity;
            let since_ns = self.state.clones.last().map_or(from_ns, |newest| newest.stamp_ns);
            let motion = ImuMotion::between(&before, &self.state.imu, [since_ns, stamp_ns], &gravity);
            self.map_fixes.add_motion(motion);
        }
        if self.health.has_odometry_failed(self.state.stamp_ns) {
            self.note_odometry_failure();
        }
        self.check_health()?;
        // `track_update` may be left out for an image without tracks.
        self.marginalize_old_clones();
        let clone = self.clone_pose(stamp_ns, &motion_before.unwrap_or_default());
        self.wheel_updates()?;
        self.gnss_updates()?;
        Ok(clone)
    }

    /// # Returns
    /// The motion before `stamp_ns`, where cameras have a rolling shutter.
    fn propagate_to(&mut self, stamp_ns: i64) -> Result<Option<TimedPoses>, EstimatorError> {
        let readings = self.imu.interval(self.state.stamp_ns, stamp_ns, IMU_SLACK_NS)?;
        let gap_ns = self.imu.longest_gap_ns(self.state.stamp_ns, stamp_ns);
        if gap_ns > MAX_GAP_NS {
            return Err(Divergence::MotionUnknown { seconds: gap_ns as f64 * 1e-9 }.into());
        }
        if gap_ns > FAILURE_GAP_NS || self.repetition.is_fault() {
            self.note_odometry_failure();
        }
        if self.config.first_estimates {
            first_estimates::renew(&mut self.state, &mut self.covariance);
        }
        let has_pixel_times = self.has_pixel_times();
        if has_pixel_times {
            self.note_motion_after(&readings);
        }
        let mut propagation = self.propagation();
        for pair in readings.windows(2) {
            let spacing_ns = self.imu.longest_gap_ns(pair[0].stamp_ns, pair[1].stamp_ns);
            propagation.step_within(&pair[0], &pair[1], spacing_ns);
        }
        let propagated = propagation.end();
        self.angular_rate = AngularRate::at_end(&readings);
        self.covariance.time_update(&propagated.transition, &propagated.noise);
        self.state.imu = propagated.state;
        self.state.stamp_ns = stamp_ns;
        self.state.first_motion = MotionEstimate::of(&propagated.state);
        self.imu.remove_before(stamp_ns);
        Ok(has_pixel_times.then(|| self.motion_before(&readings)))
    }

    /// A propagation from the state, with nothing integrated yet.
    pub(super) fn propagation(&self) -> Propagation {
        let newest = MotionEstimate::of(&self.state.imu);
        let first = if self.config.first_estimates { &self.state.first_motion } else { &newest };
        let noise = self.noise.imu_noise(&self.config.imu_noise);
        let noise = if self.repetition.is_guess_after(self.state.stamp_ns) {
            noise_of_a_guess(&noise)
        } else {
            noise
        };
        Propagation::new(&self.state.imu, first, &noise, self.config.gravity)
    }

    /// Stochastic cloning: the newest pose is appended to the state with its correlations.
    ///
    /// # Arguments
    /// * `motion_before`: of a rolling shutter.
    fn clone_pose(&mut self, stamp_ns: i64, motion_before: &TimedPoses) -> CloneId {
        let id = CloneId(self.next_clone);
        self.next_clone += 1;
        let dim = self.state.dim();
        self.covariance.gather(&[0..dim, 0..POSE_DIM]);
        if self.state.calibration.estimates_time_offset() {
            // The pose at the true time of the image differs by the motion over the error of the time offset.
            let state = &self.state.imu;
            let rotation =
                state.local_from_imu.rotation * (self.angular_rate.gyroscope - state.gyroscope_bias);
            let velocity = state.velocity;
            let motion = Vector6::new(rotation.x, rotation.y, rotation.z, velocity.x, velocity.y, velocity.z);
            self.covariance.add_dependences(&[Dependence { begin: dim, of: IMU_DIM, jacobian: motion }]);
        }
        let pose = self.state.imu.local_from_imu;
        let motion = self.has_pixel_times().then(|| self.motion_around(stamp_ns, motion_before));
        self.state.clones.push(ClonedPose {
            id,
            stamp_ns,
            local_from_imu: pose,
            first_estimate: pose,
            pins: 0,
            motion,
        });
        id
    }

    /// Marginalizes the clones beyond the window.
    pub(super) fn marginalize_old_clones(&mut self) {
        let removed: SmallVec<[usize; 4]> = clones_beyond_window(&self.state, self.config.window).collect();
        if removed.is_empty() {
            return;
        }
        let mut kept = SmallVec::<[Range<usize>; 32]>::new();
        kept.push(0..self.state.clones_begin());
        kept.extend(
            (0..self.state.clones.len())
                .filter(|index| !removed.contains(index))
                .filter_map(|index| self.state.range(Block::Clone(index))),
        );
        self.covariance.gather(&kept);
        let mut index = 0;
        self.state.clones.retain(|_| {
            index += 1;
            !removed.contains(&(index - 1))
        });
    }

    /// Excludes a clone from marginalization, as long as a map query of its image is pending: once for each query.
    pub fn pin(&mut self, clone: CloneId) {
        if let Some(index) = self.state.clone_index(clone) {
            self.state.clones[index].pins += 1;
        }
    }

    /// Ends one [`Self::pin`]: the answer was used, or will not come.
    pub fn unpin(&mut self, clone: CloneId) {
        if let Some(index) = self.state.clone_index(clone) {
            let pins = &mut self.state.clones[index].pins;
            *pins = pins.saturating_sub(1);
        }
    }

    pub(super) fn check_health(&self) -> Result<(), EstimatorError> {
        Ok(self.health.check(&self.state, &self.covariance)?)
    }
}

/// Indices of the clones beyond the window that are not pinned.
pub(super) fn clones_beyond_window(state: &ActiveState, window: usize) -> impl Iterator<Item = usize> + '_ {
    (0..state.clones.len().saturating_sub(window)).filter(|&index| state.clones[index].pins == 0)
}
