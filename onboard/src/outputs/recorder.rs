//! Writes the files of a run.

use super::files::{OutputError, OutputFiles};
use super::summary::Summary;
use evaluation::trajectory::StateRow;
use robot::{Estimate, Event, Output};
use std::path::Path;

/// The files of a run. Lent to a run as an [`Output`], they are finished afterwards.
#[derive(Debug)]
pub struct Recorder {
    files: OutputFiles,
    /// The newest state, not written yet: map updates after the frame replace it.
    newest: Option<StateRow>,
    /// What is added to all times, as those of the sensors are written, and the time behind which it is: that of the newest state when it
    /// was told. On the estimator's clock, nanoseconds.
    clock_shifts: Vec<(i64, i64)>,
    /// Time of the newest state on the estimator's clock, nanoseconds.
    newest_ns: Option<i64>,
    /// The first error of writing; the files are incomplete then.
    error: Option<OutputError>,
}

impl Recorder {
    /// Creates the output folder and its files.
    ///
    /// # Arguments
    /// * `limit`: bytes of all files together, with which those of an earlier run are kept and old ones are not; `None` without one.
    ///
    /// # Errors
    /// [`OutputError`] with the file.
    pub fn create(folder: &Path, limit: Option<u64>) -> Result<Self, OutputError> {
        Ok(Self {
            files: OutputFiles::create(folder, limit)?,
            newest: None,
            clock_shifts: Vec::new(),
            newest_ns: None,
            error: None,
        })
    }

    /// What the clock of the sensors was ahead of the estimator's at a time of the latter, nanoseconds.
    fn shift_at(&self, stamp_ns: i64) -> i64 {
        let behind = self.clock_shifts.iter().rev().find(|(from_ns, _)| stamp_ns > *from_ns);
        behind.map_or(0, |(_, shift_ns)| *shift_ns)
    }

    fn write_newest(&mut self) {
        if let Some(row) = self.newest.take() {
            let written = self.files.append_state(&row);
            self.keep_first_error(written);
        }
    }

    /// A run continues when its disk is full: the first error is logged, and reported at the end.
    fn keep_first_error(&mut self, written: Result<(), OutputError>) {
        if let (Err(error), None) = (written, &self.error) {
            tracing::error!(%error, "the output files will be incomplete; the run continues");
            self.error = Some(error);
        }
    }

    /// Whether the files have the last part of the run only, for the limit of the folder.
    pub fn is_cut(&self) -> bool {
        self.files.is_cut()
    }

    /// Writes the last state and flushes the files.
    ///
    /// # Errors
    /// The first [`OutputError`] of the run.
    pub fn finish_states(&mut self) -> Result<(), OutputError> {
        self.write_newest();
        self.error.take().map_or_else(|| self.files.flush(), Err)
    }

    /// Writes the summary.
    ///
    /// # Errors
    /// [`OutputError`] with the file.
    pub fn write_summary(&self, summary: &Summary) -> Result<(), OutputError> {
        self.files.write_summary(summary)
    }
}

impl Output for Recorder {
    fn estimate(&mut self, estimate: &Estimate) {
        self.write_newest();
        self.revise(estimate);
    }

    fn revise(&mut self, estimate: &Estimate) {
        self.newest_ns = Some(estimate.motion.stamp_ns);
        self.newest = Some(StateRow {
            stamp_ns: estimate.motion.stamp_ns.saturating_add(self.shift_at(estimate.motion.stamp_ns)),
            local_from_imu: estimate.motion.local_from_imu(),
            global_from_local: estimate.trusted().map(|global| global.global_from_local),
            global_from_imu: estimate.trusted().map(|global| global.global_from_imu),
        });
    }

    fn query(&mut self, event: &Event) {
        let shift_s = |at_s: f64| self.shift_at((at_s * 1e9) as i64) as f64 * 1e-9;
        let event = Event {
            stamp_ns: event.stamp_ns.saturating_add(self.shift_at(event.stamp_ns)),
            queried_at_s: event.queried_at_s + shift_s(event.queried_at_s),
            applied_at_s: event.applied_at_s + shift_s(event.applied_at_s),
            ..event.clone()
        };
        let written = self.files.append_event(&event);
        self.keep_first_error(written);
    }

    fn set_clock_shift(&mut self, shift_ns: i64) {
        self.clock_shifts.push((self.newest_ns.unwrap_or(i64::MIN), shift_ns));
    }
}

#[cfg(test)]
mod tests {
    use super::super::files::{EVENTS, STATES};
    use super::*;
    use estimator::Motion;
    use estimator::propagation::{ImuMatrix, ImuState};
    use evaluation::trajectory::states::StateReader;
    use geometry::Pose;
    use nalgebra::Vector3;

    const SECOND_NS: i64 = 1_000_000_000;

    fn estimate(stamp_ns: i64) -> Estimate {
        let state = ImuState {
            local_from_imu: Pose::identity(),
            velocity: Vector3::zeros(),
            gyroscope_bias: Vector3::zeros(),
            accelerometer_bias: Vector3::zeros(),
        };
        let motion = Motion {
            stamp_ns,
            state,
            covariance: ImuMatrix::identity(),
            angular_velocity: Vector3::zeros(),
            angular_velocity_variance: 0.0,
        };
        Estimate::new(motion, None, true)
    }

    fn event(stamp_ns: i64) -> Event {
        Event {
            stamp_ns,
            queried_at_s: stamp_ns as f64 * 1e-9,
            applied_at_s: stamp_ns as f64 * 1e-9 + 0.5,
            outcome: "matched".to_owned(),
            keyframes: 1,
            matches: 20,
            inliers: 20,
            used: 20,
            mean_reprojection_px: None,
            relinearized: false,
            accepted: true,
            reason: String::new(),
            nis: None,
            nis_degrees: None,
        }
    }

    #[test]
    fn times_have_the_jumps_of_the_clock_of_the_sensors() {
        let folder = tempfile::tempdir().unwrap();
        let mut recorder = Recorder::create(folder.path(), None).unwrap();
        recorder.estimate(&estimate(SECOND_NS));
        recorder.set_clock_shift(3600 * SECOND_NS);
        recorder.query(&event(SECOND_NS));
        recorder.estimate(&estimate(2 * SECOND_NS));
        recorder.finish_states().unwrap();
        let states = StateReader::open(&folder.path().join(STATES)).unwrap();
        let stamps: Vec<i64> = states.map(|row| row.unwrap().stamp_ns).collect();
        assert_eq!(stamps, [SECOND_NS, 3602 * SECOND_NS]);
        let mut events = csv::Reader::from_path(folder.path().join(EVENTS)).unwrap();
        let written: Event = events.deserialize().next().unwrap().unwrap();
        // It is about an image from before the jump, and came behind it.
        let expected = (SECOND_NS, 1.0, 3601.5);
        assert_eq!((written.stamp_ns, written.queried_at_s, written.applied_at_s), expected);
    }
}
