//! What a run says of itself: its status, and its alarms.

use super::outputs::Recorder;
use super::run::RobotRun;
use estimator::{Alarm, Estimator, NoiseFault, Status, StatusReason};
use protocol::limits::MAX_TEXT_BYTES;
use sensors::live::{FaultKind, Stream};
use std::mem::{Discriminant, discriminant};
use std::time::{SystemTime, UNIX_EPOCH};

/// Reason of a status without a map.
const NO_MAP: &str = "no map was asked for";

/// Kinds of alarms.
#[derive(Debug, PartialEq)]
pub(crate) enum AlarmKind {
    Filter(Discriminant<Alarm>),
    Noise(Discriminant<NoiseFault>),
    ImuUnits,
    BadReadings,
    Sensor(Stream, FaultKind),
}

impl AlarmKind {
    fn of_filter(alarm: &Alarm) -> Self {
        match alarm {
            Alarm::Noise(fault) => Self::Noise(discriminant(fault)),
            other => Self::Filter(discriminant(other)),
        }
    }
}

impl RobotRun<'_> {
    /// Logs and keeps the alarms that begin and end.
    ///
    /// # Arguments
    /// * `seconds`: since the first frame.
    pub(super) fn update_alarms(&mut self, seconds: f64) {
        let of_filter = self.supervisor.estimator().map(Estimator::alarms).unwrap_or_default();
        let of_filter = of_filter.iter().map(|alarm| (AlarmKind::of_filter(alarm), alarm.to_string()));
        let of_imu = self.imu_fault.map(|fault| (AlarmKind::ImuUnits, fault.to_string()));
        let of_readings = self.bad_readings.fault().map(|fault| (AlarmKind::BadReadings, fault));
        let of_sensors = self
            .live_faults
            .iter()
            .map(|fault| (AlarmKind::Sensor(fault.stream, fault.kind), fault.to_string()));
        self.alarms.update(seconds, of_filter.chain(of_imu).chain(of_readings).chain(of_sensors).collect());
    }

    /// The status, with why the map does not answer and what is wrong with the readings.
    pub(super) fn status(&self) -> Status {
        let mut status = self.supervisor.status();
        let has_map = self.queries.is_some() || self.opening.is_some();
        let unmatched = StatusReason::NoMatchYet.to_string();
        if !has_map && let Some(rest) = status.reason.strip_prefix(&unmatched) {
            status.reason = format!("{NO_MAP}{rest}");
        }
        let failure = self.last_failure.as_ref().map(|failure| format!("the map does not answer: {failure}"));
        let of_sensors = self.live_faults.iter().map(ToString::to_string);
        let of_units = self.imu_fault.map(|fault| fault.to_string());
        let of_readings = self.bad_readings.fault();
        let of_operator = self.initial_pose.describe();
        for fault in
            of_operator.into_iter().chain(failure).chain(of_units).chain(of_readings).chain(of_sensors)
        {
            status.reason = format!("{}; {fault}", status.reason);
        }
        // A longer text would not be published.
        status.reason.truncate(status.reason.floor_char_boundary(MAX_TEXT_BYTES));
        status
    }

    /// Asks a live source what is wrong with it.
    pub(super) fn update_live(&mut self, recorder: &mut Recorder) {
        let Some(report) = self.events.live() else { return };
        recorder.dropped_frames = report.dropped_frames;
        self.live_faults = report.faults;
        if let Some(publisher) = &mut self.publisher {
            publisher.set_clock_shift(report.clock_shift_ns);
        }
        if let Some(recording) = &mut self.recording {
            recording.set_clock_shift(report.clock_shift_ns);
            recording.set_best_effort(&report.best_effort);
        }
        if let Some(ros) = &mut self.ros {
            ros.set_clock_shift(report.clock_shift_ns);
        }
    }

    /// Publishes the status where there is no pose.
    pub(super) fn publish_status(&mut self, stamp_ns: i64, recorder: &Recorder) {
        let status = self.note_status(recorder);
        if let Some(recording) = &mut self.recording {
            recording.status(stamp_ns, &status, recorder.query_counts());
        }
        if let Some(ros) = &self.ros {
            ros.publish_status(stamp_ns, &status, recorder.query_counts());
        }
        if let Some(publisher) = &self.publisher {
            publisher.publish_status(stamp_ns, status, recorder.query_counts());
        }
    }

    /// Publishes the status before the first frame, which tells the time of the sensors: at the time of this machine. The
    /// recording takes it at the time of the sensors.
    pub(super) fn publish_first_status(&mut self, recorder: &Recorder) {
        let status = self.note_status(recorder);
        let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let stamp_ns = i64::try_from(since_1970.as_nanos()).unwrap_or(i64::MAX);
        if let Some(recording) = &mut self.recording {
            recording.first_status(&status, recorder.query_counts());
        }
        if let Some(ros) = &self.ros {
            ros.publish_status(stamp_ns, &status, recorder.query_counts());
        }
        if let Some(publisher) = &self.publisher {
            publisher.publish_status(stamp_ns, status, recorder.query_counts());
        }
    }

    /// Takes the status of now into metrics and log.
    pub(super) fn note_status(&mut self, recorder: &Recorder) -> Status {
        let status = self.status();
        self.metrics.note_status(&status, &recorder.queries);
        self.status_line.log(&status, recorder.frames, &recorder.queries);
        status
    }
}
