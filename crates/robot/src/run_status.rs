//! What a run says of itself: its status, and its alarms.

use super::estimate::StatusReport;
use super::input::SensorFault;
use super::run::Robot;
use estimator::{Alarm, Estimator, GnssFault, NoiseFault, Status, StatusReason, WheelFault};
use protocol::limits::MAX_TEXT_BYTES;
use std::mem::{Discriminant, discriminant};

/// Reason of a status without a map.
const NO_MAP: &str = "no map was asked for";

/// Kinds of alarms.
#[derive(Debug, PartialEq)]
pub(crate) enum AlarmKind {
    Filter(Discriminant<Alarm>),
    Noise(Discriminant<NoiseFault>),
    Wheels(Discriminant<WheelFault>),
    Gnss(Discriminant<GnssFault>),
    Sensor(SensorFault),
    /// By the number of the output.
    Output(usize),
}

impl AlarmKind {
    fn of_filter(alarm: &Alarm) -> Self {
        match alarm {
            Alarm::Noise(fault) => Self::Noise(discriminant(fault)),
            Alarm::Wheels(fault) => Self::Wheels(discriminant(fault)),
            Alarm::Gnss(fault) => Self::Gnss(discriminant(fault)),
            other => Self::Filter(discriminant(other)),
        }
    }
}

impl Robot<'_> {
    /// Logs and keeps the alarms that begin and end.
    ///
    /// # Arguments
    /// * `seconds`: since the first frame.
    pub(crate) fn update_alarms(&mut self, seconds: f64) {
        let of_filter = self.supervisor.estimator().map(Estimator::alarms).unwrap_or_default();
        let of_filter = of_filter.iter().map(|alarm| (AlarmKind::of_filter(alarm), alarm.to_string()));
        let of_sensors = self.faults.now().map(|(fault, text)| (AlarmKind::Sensor(fault), text));
        let of_outputs = self.outputs.faults().map(|(at, fault)| (AlarmKind::Output(at), fault.to_owned()));
        let all = of_filter.chain(of_sensors).chain(of_outputs).collect();
        self.alarms.update(seconds, all);
    }

    /// The status, with why the map does not answer and what is wrong with the readings and with outputs.
    pub(crate) fn status(&self) -> Status {
        let mut status = self.supervisor.status();
        let unmatched = StatusReason::NoMatchYet.to_string();
        if !self.map.has_map()
            && let Some(rest) = status.reason.strip_prefix(&unmatched)
        {
            status.reason = format!("{NO_MAP}{rest}");
        }
        let failure = self.map.last_failure.as_ref();
        let failure = failure.map(|failure| format!("the map does not answer: {failure}"));
        let of_sensors = self.faults.now().map(|(_, text)| text);
        let of_outputs = self.outputs.faults().map(|(_, fault)| fault.to_owned());
        let of_operator = self.initial_pose.describe();
        for fault in of_operator.into_iter().chain(failure).chain(of_sensors).chain(of_outputs) {
            status.reason = format!("{}; {fault}", status.reason);
        }
        // A longer text would not be published.
        status.reason.truncate(status.reason.floor_char_boundary(MAX_TEXT_BYTES));
        status
    }

    /// Asks a live source what is wrong with it, and hands on what has changed.
    pub(crate) fn update_live(&mut self) {
        let Some(report) = self.events.live() else { return };
        self.report.dropped_frames = report.dropped_frames;
        if report.clock_shift_ns != self.faults.live.clock_shift_ns {
            self.outputs.each(|output| output.set_clock_shift(report.clock_shift_ns));
        }
        if report.best_effort != self.faults.live.best_effort {
            self.outputs.each(|output| output.set_best_effort(&report.best_effort));
        }
        self.faults.live = report;
    }

    /// The status of now with the counts of now.
    ///
    /// # Arguments
    /// * `stamp_ns`: time of the image, nanoseconds; `None` before the first, which tells the time of the sensors.
    pub(crate) fn status_report(&self, stamp_ns: Option<i64>) -> StatusReport {
        StatusReport {
            stamp_ns,
            status: self.status(),
            frames: self.report.frames,
            queries: self.report.queries,
            has_sensor_fault: self.faults.now().next().is_some(),
        }
    }

    /// Gives out the status where there is no pose.
    pub(crate) fn give_status(&mut self, stamp_ns: Option<i64>) {
        let report = self.status_report(stamp_ns);
        self.outputs.each(|output| output.status(&report));
    }
}
