//! Updates by the wheels.

use super::Estimator;
use crate::error::EstimatorError;
use crate::gnss::report::GnssCounts;
use crate::state::Block;
use crate::wheels::buffer::BadWheelReading;
use crate::wheels::calibration::WheelCalibration;
use crate::wheels::linearization::{ClonesAround, TimedPose, linearize};
use crate::wheels::measurement::{Part, WheelMeasurement};
use crate::wheels::preintegration::{PlanarMotion, preintegrate};
use crate::wheels::report::{LearnedWheels, WheelCounts, WheelReport};
use crate::wheels::{DueInterval, TimedClone, WheelOdometry};
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
        let mut done = Ok(());
        while let (Ok(()), Some(calibration)) = (&done, self.state.wheels)
            && let Some(due) = wheels.next_due(calibration.time_offset_s)
        {
            done = self.wheel_update(&mut wheels, &due, &calibration);
            if !wheels.watch.is_trusted() {
                wheels.keep(due);
                continue;
            }
            for kept in std::mem::take(&mut wheels.untried) {
                // Each one corrects the calibration that the next one is integrated with.
                let Some(calibration) = self.state.wheels else { break };
                done = done.and_then(|()| self.use_interval(&mut wheels, &kept, &calibration));
            }
        }
        self.wheels = Some(wheels);
        done
    }

    /// Tests one interval and uses it.
    fn wheel_update(
        &mut self,
        wheels: &mut WheelOdometry,
        due: &DueInterval,
        calibration: &WheelCalibration,
    ) -> Result<(), EstimatorError> {
        let Some((motion, measurement)) = self.measured(wheels, due, calibration) else { return Ok(()) };
        let residual_m = measurement.residual_of_wheels(&calibration.base);
        let is_telling = !wheels.watch.has_agreed() && self.is_telling(wheels, &measurement, &motion)?;
        let (is_trusted, is_faulty) = (wheels.watch.is_trusted(), wheels.watch.fault().is_some());
        let is_accepted = self.update_part(wheels, &measurement, Part::Rolling, is_trusted)?;
        wheels.watch.note(due.clones.map(|clone| clone.stamp_ns), is_accepted, residual_m, is_telling);
        let counts = &mut wheels.counts;
        counts.left_out += usize::from(is_faulty);
        counts.used += usize::from(is_trusted && is_accepted);
        counts.slipped += usize::from(is_trusted && !is_accepted);
        if is_trusted {
            self.off_track_update(wheels, due, &motion)?;
        }
        Ok(())
    }

    /// Uses an interval that was tested before the wheels had agreed; where its clones are gone, it cannot be.
    fn use_interval(
        &mut self,
        wheels: &mut WheelOdometry,
        due: &DueInterval,
        calibration: &WheelCalibration,
    ) -> Result<(), EstimatorError> {
        let Some((motion, measurement)) = self.measured(wheels, due, calibration) else { return Ok(()) };
        if self.update_part(wheels, &measurement, Part::Rolling, true)? {
            wheels.counts.used += 1;
            self.off_track_update(wheels, due, &motion)?;
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
            before: due.before.as_ref().and_then(pose),
            first: pose(&due.clones[0])?,
            second: pose(&due.clones[1])?,
            after: due.after.as_ref().and_then(pose),
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
        let clones = [self.state.clone_index(due.clones[0].id)?, self.state.clone_index(due.clones[1].id)?];
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
