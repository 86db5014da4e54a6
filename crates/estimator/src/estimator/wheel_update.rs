//! Updates by the wheels.

use super::Estimator;
use crate::error::EstimatorError;
use crate::gnss::report::GnssCounts;
use crate::state::Block;
use crate::wheels::buffer::{BadWheelReading, Interval};
use crate::wheels::calibration::WheelCalibration;
use crate::wheels::linearization::{ClonesAround, TimedPose, linearize};
use crate::wheels::measurement::{Part, WheelMeasurement};
use crate::wheels::preintegration::{PlanarMotion, preintegrate};
use crate::wheels::report::{LearnedWheels, WheelCounts, WheelReport};
use crate::wheels::{ConsecutiveClones, DueInterval, TimedClone, WheelOdometry};
use types::WheelReading;

/// Standard deviations of a calibration that a filter which failed had learned, in units of those that it stated.
const RESUMED_SIGMAS: f64 = 10.0;

impl Estimator {
    /// Stores a reading of the wheels for the next [`Self::time_update`]. Readings come in the order of time, and an interval
    /// between two images is used at the first image behind its last reading. Without
    /// [`EstimatorConfig::wheels`](crate::EstimatorConfig::wheels) it does nothing.
    ///
    /// # Errors
    /// [`BadWheelReading`]: the reading was dropped; the filter goes on.
    pub fn wheels(&mut self, reading: WheelReading) -> Result<(), BadWheelReading> {
        let Some(wheels) = &mut self.wheels else { return Ok(()) };
        wheels.buffer.push(reading).inspect_err(|_| wheels.counts.refused_readings += 1)
    }

    /// What the wheels did, and their calibration as estimated now; `None` without them.
    pub fn wheel_report(&self) -> Option<WheelReport> {
        let counts = self.wheels.as_ref()?.counts;
        Some(WheelReport::new(counts, &self.learned_wheels()?))
    }

    /// The calibration of the wheels as learned up to now; `None` without them.
    pub fn learned_wheels(&self) -> Option<LearnedWheels> {
        let range = self.state.range(Block::Wheels)?;
        let covariance = self.covariance.active().view();
        let covariance = covariance.view((range.start, range.start), (range.len(), range.len())).into_owned();
        Some(LearnedWheels { calibration: self.state.wheels?, covariance })
    }

    /// Continues from the calibration that a filter of the same robot had learned before it failed; before the first image.
    ///
    /// It may be what was wrong: its standard deviations become ten times as large, each up to the stated one.
    pub fn resume_wheels(&mut self, learned: &LearnedWheels) {
        let Some(stated) = self.learned_wheels() else { return };
        let LearnedWheels { calibration, covariance } = learned.clone().widened(RESUMED_SIGMAS, &stated);
        let range = self.state.range(Block::Wheels).filter(|range| range.len() == covariance.nrows());
        let Some(range) = range else { return };
        self.state.wheels = Some(calibration);
        self.covariance.replace(range.start, &covariance);
    }

    /// Counts on from what other filters of the same run counted.
    pub fn resume_counts(&mut self, gnss: Option<GnssCounts>, wheels: Option<WheelCounts>) {
        if let (Some(own), Some(counts)) = (&mut self.gnss, gnss) {
            own.counts = counts;
        }
        if let (Some(own), Some(counts)) = (&mut self.wheels, wheels) {
            own.counts = counts;
        }
    }

    /// Takes in the newest clone, and makes the updates that are due.
    pub(super) fn wheel_updates(&mut self) -> Result<(), EstimatorError> {
        let Some(mut wheels) = self.wheels.take() else { return Ok(()) };
        if let Some(newest) = self.state.clones.last() {
            wheels.add_clone(newest.id, self.state.stamp_ns);
        }
        wheels.retain_untried(|id| self.state.clone_index(id).is_some());
        let mut done = Ok(());
        while let (Ok(()), Some(calibration)) = (&done, self.state.wheels)
            && let Some(due) = wheels.next_due(calibration.time_offset_s)
        {
            done = self.wheel_update(&mut wheels, &due, &calibration);
            if wheels.watch.is_trusted() {
                for kept in wheels.take_untried() {
                    done = done.and_then(|()| self.use_interval(&mut wheels, &kept));
                }
            }
        }
        self.wheels = Some(wheels);
        done
    }

    /// Tests one interval and uses it; where wheels are not used now, it is kept for when they are.
    fn wheel_update(
        &mut self,
        wheels: &mut WheelOdometry,
        due: &DueInterval,
        calibration: &WheelCalibration,
    ) -> Result<(), EstimatorError> {
        let span_ns = due.clones.both.map(|clone| clone.stamp_ns);
        let Some((motion, measurement)) = self.measured(wheels, due, calibration) else {
            wheels.note_missing(span_ns[0], self.state.stamp_ns);
            return Ok(());
        };
        let residual_m = measurement.residual_of_wheels(&calibration.base);
        let is_telling = !wheels.watch.has_agreed() && self.is_telling(wheels, &measurement, &motion)?;
        let (is_trusted, is_faulty) = (wheels.watch.is_trusted(), wheels.watch.fault().is_some());
        let is_accepted = self.update_part(wheels, &measurement, Part::Rolling, is_trusted)?;
        wheels.watch.note(span_ns, is_accepted, residual_m, is_telling);
        let counts = &mut wheels.counts;
        counts.left_out += usize::from(is_faulty);
        counts.used += usize::from(is_trusted && is_accepted);
        counts.slipped += usize::from(is_trusted && !is_accepted);
        if is_trusted {
            self.off_track_update(wheels, due, &motion)?;
        } else {
            wheels.keep(due.clones);
        }
        Ok(())
    }

    /// Uses an interval that was tested while wheels were not used; where its clones are gone, it cannot be.
    fn use_interval(
        &mut self,
        wheels: &mut WheelOdometry,
        clones: &ConsecutiveClones,
    ) -> Result<(), EstimatorError> {
        // Each one corrects the calibration that the next one is cut and integrated with.
        let Some(calibration) = self.state.wheels else { return Ok(()) };
        let Interval::Covered(readings) = wheels.readings_between(clones, calibration.time_offset_s) else {
            return Ok(());
        };
        let due = DueInterval { clones: *clones, readings };
        let Some((motion, measurement)) = self.measured(wheels, &due, &calibration) else { return Ok(()) };
        if self.update_part(wheels, &measurement, Part::Rolling, true)? {
            wheels.counts.used += 1;
            self.off_track_update(wheels, &due, &motion)?;
        }
        Ok(())
    }

    /// That the base moves on the floor, and ahead.
    fn off_track_update(
        &mut self,
        wheels: &mut WheelOdometry,
        due: &DueInterval,
        motion: &PlanarMotion,
    ) -> Result<(), EstimatorError> {
        if let Some(measurement) = self.wheel_measurement(wheels, due, motion) {
            let is_accepted = self.update_part(wheels, &measurement, Part::OffTrack, true)?;
            wheels.counts.off_track += usize::from(!is_accepted);
        }
        Ok(())
    }

    /// The motion of an interval, and what it measures; `None` where its clones are gone, or readings are missing.
    fn measured(
        &self,
        wheels: &WheelOdometry,
        due: &DueInterval,
        calibration: &WheelCalibration,
    ) -> Option<(PlanarMotion, WheelMeasurement)> {
        let motion = self.preintegrated(wheels, due, calibration)?;
        let measurement = self.wheel_measurement(wheels, due, &motion)?;
        Some((motion, measurement))
    }

    /// The motion of an interval, linearized at the clones' motion.
    fn preintegrated(
        &self,
        wheels: &WheelOdometry,
        due: &DueInterval,
        calibration: &WheelCalibration,
    ) -> Option<PlanarMotion> {
        let pose = |clone: &TimedClone| {
            let local_from_imu = self.state.clones[self.state.clone_index(clone.id)?].local_from_imu;
            Some(TimedPose { local_from_imu, stamp_ns: clone.stamp_ns })
        };
        let clones = ClonesAround {
            before: due.clones.before.as_ref().and_then(pose),
            first: pose(&due.clones.both[0])?,
            second: pose(&due.clones.both[1])?,
            after: due.clones.after.as_ref().and_then(pose),
        };
        let noise = &wheels.config.noise;
        let motion = preintegrate(&due.readings, calibration, noise)?;
        linearize(&motion, &due.readings, &clones, calibration, noise)
    }

    /// Whether wheels that report half of the motion would fail the test.
    fn is_telling(
        &mut self,
        wheels: &mut WheelOdometry,
        measurement: &WheelMeasurement,
        motion: &PlanarMotion,
    ) -> Result<bool, EstimatorError> {
        let rows = &mut wheels.rows;
        let is_valid = measurement.of_half_the_motion(motion).whiten(Part::Rolling, rows);
        Ok(is_valid && !wheels.gate.accepts(self.covariance.nis(rows)?, rows.residual.len()))
    }

    fn wheel_measurement(
        &self,
        wheels: &WheelOdometry,
        due: &DueInterval,
        motion: &PlanarMotion,
    ) -> Option<WheelMeasurement> {
        let [first, second] = due.clones.both;
        let clones = [self.state.clone_index(first.id)?, self.state.clone_index(second.id)?];
        WheelMeasurement::new(&self.state, clones, motion, &wheels.config.noise, self.config.first_estimates)
    }

    /// Tests a part of a measurement, and updates the state with it.
    ///
    /// # Arguments
    /// * `is_used`: else it is only tested.
    ///
    /// # Returns
    /// Whether it passed the test.
    fn update_part(
        &mut self,
        wheels: &mut WheelOdometry,
        measurement: &WheelMeasurement,
        part: Part,
        is_used: bool,
    ) -> Result<bool, EstimatorError> {
        let rows = &mut wheels.rows;
        if !measurement.whiten(part, rows) {
            return Ok(false);
        }
        let is_accepted = wheels.gate.accepts(self.covariance.nis(rows)?, rows.residual.len());
        if is_accepted && is_used {
            self.covariance.measurement_update(rows, &mut self.correction)?;
            self.state.retract(&self.correction);
        }
        Ok(is_accepted)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::CalibratedCamera;
    use crate::config::{EstimatorConfig, InitialSigmas};
    use crate::estimator::status::Alarm;
    use crate::initialization::static_init::InitialState;
    use crate::wheels::config::WheelConfig;
    use crate::wheels::watch::WheelFault;
    use geometry::{Camera, Distortion, Pose};
    use nalgebra::Vector3;
    use types::{BaseKind, ImuSample, WheelBase};

    /// Nanoseconds in a millisecond.
    const MS: i64 = 1_000_000;

    /// A filter of a base at rest, with readings of the IMU for three seconds.
    fn at_rest() -> Estimator {
        let (focal, centre) = ([400.0; 2], [320.0, 240.0]);
        let camera = Camera { width: 640, height: 480, focal, centre, distortion: Distortion::None };
        let cameras = vec![CalibratedCamera::new(camera, Pose::identity())];
        let (rest, down) = (Vector3::zeros(), -Vector3::z());
        let start = InitialState::from_truth(0, &Pose::identity(), &rest, &down, InitialSigmas::default());
        let wheels = WheelConfig::new(WheelBase::new(BaseKind::Differential, 0.10, 0.50));
        let config = EstimatorConfig { wheels: Some(wheels), ..EstimatorConfig::default() };
        let mut estimator = Estimator::new(config, cameras, &start).unwrap();
        for k in 0..600 {
            let (gyroscope, accelerometer) = (Vector3::zeros(), Vector3::z() * 9.81);
            estimator.imu(ImuSample { stamp_ns: k * 5 * MS, gyroscope, accelerometer }).unwrap();
        }
        estimator
    }

    fn counts(estimator: &Estimator) -> WheelCounts {
        estimator.wheel_report().unwrap().counts
    }

    #[test]
    fn readings_that_come_when_the_clones_are_gone_are_missing_and_an_alarm() {
        let mut estimator = at_rest();
        // 80 images a second: a window of a quarter of a second.
        for image in 0..160 {
            let now_ns = image * 25 * MS / 2;
            let late_ns = now_ns - 300 * MS;
            if late_ns >= 0 && image % 2 == 0 {
                estimator.wheels(WheelReading::new(late_ns, [0.0, 0.0])).unwrap();
            }
            estimator.time_update(now_ns).unwrap();
        }
        assert!(counts(&estimator).missing > 100, "{:?}", counts(&estimator));
        let is_silent = |alarm: &Alarm| matches!(alarm, Alarm::Wheels(WheelFault::Silent { .. }));
        assert!(estimator.alarms().iter().any(is_silent), "{:?}", estimator.alarms());
    }

    #[test]
    fn an_interval_that_was_used_is_not_used_again() {
        let mut estimator = at_rest();
        let watch = &mut estimator.wheels.as_mut().unwrap().watch;
        // Long ago the wheels agreed, and for the last 0.7 s they have not.
        for k in -80..-70 {
            watch.note([k * 50 * MS, (k + 1) * 50 * MS], true, [0.0; 4], true);
        }
        for k in -14..0 {
            watch.note([k * 50 * MS, (k + 1) * 50 * MS], false, [0.0; 4], true);
        }
        assert!(watch.is_trusted());
        for stamp_ns in [0, 50 * MS] {
            estimator.wheels(WheelReading::new(stamp_ns, [0.0, 0.0])).unwrap();
            estimator.time_update(stamp_ns).unwrap();
        }
        let wheels = estimator.wheels.as_mut().unwrap();
        assert!(wheels.counts.used == 1 && !wheels.watch.is_trusted(), "{:?}", wheels.counts);
        assert!(wheels.take_untried().is_empty(), "it was used, and is kept");
    }

    #[test]
    fn intervals_before_wheels_are_used_are_kept_while_their_clones_are_there() {
        let mut estimator = at_rest();
        for image in 0..25 {
            estimator.wheels(WheelReading::new(image * 50 * MS, [0.0, 0.0])).unwrap();
            estimator.time_update(image * 50 * MS).unwrap();
        }
        let kept = estimator.wheels.as_mut().unwrap().take_untried();
        let clones = estimator.state.clones.len();
        assert!((clones - 2..clones).contains(&kept.len()), "{} intervals of {clones} clones", kept.len());
    }
}
