//! What a run says of itself: its status, and its alarms.

use super::counts::ClockShiftSummary;
use super::estimate::StatusReport;
use super::input::SensorFault;
use super::prediction::HORIZON_NS;
use super::run::Robot;
use estimator::{Alarm, Estimator, GnssFault, Localization, NoiseFault, Status, StatusReason, WheelFault};
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
        self.status_at(None)
    }

    /// The same at a time after the newest state, nanoseconds; `None` for that of the state.
    fn status_at(&self, now_ns: Option<i64>) -> Status {
        let mut status = self.supervisor.status();
        let unmatched = StatusReason::NoMatchYet.to_string();
        if !self.map.has_map()
            && let Some(rest) = status.reason.strip_prefix(&unmatched)
        {
            status.reason = format!("{NO_MAP}{rest}");
        }
        if let (Some(now_ns), Some(estimator)) = (now_ns, self.supervisor.estimator()) {
            let (_, reason) = estimator.localization();
            grow_old(&mut status, reason, now_ns.saturating_sub(estimator.stamp_ns()));
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
            let newest_ns = self.report.last_state_ns.unwrap_or(self.report.first_ns);
            let (seconds, shift_s) = (self.report.seconds_at(newest_ns), report.clock_shift_ns as f64 * 1e-9);
            self.report.clock_shifts.push(ClockShiftSummary { seconds, shift_s });
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

    /// Gives out the status where no image comes.
    ///
    /// # Arguments
    /// * `now_ns`: time on the clock of the estimator, nanoseconds; `None` before the first image.
    pub(crate) fn give_status_without_image(&mut self, now_ns: Option<i64>) {
        let report = StatusReport { status: self.status_at(now_ns), ..self.status_report(now_ns) };
        self.outputs.each(|output| output.status(&report));
    }

    /// Gives out the status where there is no pose.
    pub(crate) fn give_status(&mut self, stamp_ns: Option<i64>) {
        let report = self.status_report(stamp_ns);
        self.outputs.each(|output| output.status(&report));
    }
}

/// Makes a status that of a time after its state: a correction is longer ago, and beyond the horizon of the prediction there is no pose.
///
/// # Arguments
/// * `reason`: the reason of the state that the status begins with.
/// * `age_ns`: of the state, nanoseconds.
fn grow_old(status: &mut Status, reason: StatusReason, age_ns: i64) {
    let age_s = age_ns as f64 * 1e-9;
    let older = match reason {
        StatusReason::MapUpdate { seconds_ago } => {
            StatusReason::MapUpdate { seconds_ago: seconds_ago + age_s }
        }
        StatusReason::GnssUpdate { seconds_ago } => {
            StatusReason::GnssUpdate { seconds_ago: seconds_ago + age_s }
        }
        other => other,
    };
    if let Some(rest) = status.reason.strip_prefix(&reason.to_string()) {
        status.reason = format!("{older}{rest}");
    }
    if age_ns > HORIZON_NS && status.localization.is_usable() {
        status.localization = Localization::Lost;
        status.reason =
            format!("no image was used for {age_s:.1} s: the pose is not known any more; {}", status.reason);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_status_grows_old_with_its_state() {
        let of = |localization, reason: StatusReason, age_s: f64| {
            let text = format!("{reason}; an alarm");
            let mut status =
                Status { localization, reason: text, last_map_update_ns: None, held_keyframes: 0 };
            grow_old(&mut status, reason, (age_s * 1e9) as i64);
            (status.localization, status.reason)
        };
        let corrected = StatusReason::MapUpdate { seconds_ago: 0.3 };
        let (localization, reason) = of(Localization::Localized, corrected, 0.9);
        assert_eq!(localization, Localization::Localized);
        assert_eq!(reason, "the map corrected the pose 1.2 s ago; an alarm");
        let (localization, reason) = of(Localization::Localized, corrected, 5.0);
        assert_eq!(localization, Localization::Lost);
        assert!(reason.starts_with("no image was used for 5.0 s"), "{reason}");
        assert!(reason.ends_with("; the map corrected the pose 5.3 s ago; an alarm"), "{reason}");
        assert_eq!(of(Localization::OdometryOnly, StatusReason::NoMatchYet, 5.0).0, Localization::Lost);
        let contradicted = StatusReason::Contradicted { rejections: 5 };
        let (localization, reason) = of(Localization::Lost, contradicted, 5.0);
        assert_eq!((localization, reason), (Localization::Lost, format!("{contradicted}; an alarm")));
    }
}
