//! The status as ROS diagnostics.

use super::super::status_word::status_word;
use estimator::Localization;
use robot::StatusReport;
use ros_messages::builtin_interfaces::Time;
use ros_messages::diagnostic_msgs::{DiagnosticArray, DiagnosticStatus, KeyValue};
use ros_messages::std_msgs::Header;
use std::time::{Duration, Instant};

/// A status of this age is stale: the robot reads no images any more.
const STALE: Duration = Duration::from_secs(2);

/// The last status.
#[derive(Clone, Debug)]
pub struct Diagnostics {
    /// When it was made.
    pub made: Instant,
    /// The message.
    pub message: DiagnosticArray,
}

impl Diagnostics {
    /// The diagnostics of a status.
    ///
    /// # Arguments
    /// * `stamp_ns`: on the clock of the sensors, nanoseconds.
    pub fn of(robot: &str, map_expected: bool, stamp_ns: i64, report: &StatusReport) -> Self {
        let StatusReport { status, queries, .. } = report;
        let level = match status.localization {
            Localization::Localized => DiagnosticStatus::OK,
            Localization::OdometryOnly if !map_expected => DiagnosticStatus::OK,
            Localization::OdometryOnly | Localization::Starting => DiagnosticStatus::WARN,
            Localization::Lost => DiagnosticStatus::ERROR,
        };
        let value = |key: &str, value: String| KeyValue { key: key.to_owned(), value };
        let component = DiagnosticStatus {
            level,
            name: "driftless: localization".to_owned(),
            message: status.reason.clone(),
            hardware_id: robot.to_owned(),
            values: vec![
                value("state", status_word(status).to_owned()),
                value("keyframes held", status.held_keyframes.to_string()),
                value("queries sent", queries.sent.to_string()),
                value("queries answered", queries.answered.to_string()),
            ],
        };
        let stamp = Time::from_nanoseconds(stamp_ns).unwrap_or_default();
        let header = Header { stamp, frame_id: String::new() };
        Self { made: Instant::now(), message: DiagnosticArray { header, status: vec![component] } }
    }

    /// Whether level or state differ: the text holds numbers that change with every image.
    pub fn differs_from(&self, other: &Self) -> bool {
        let key = |diagnostics: &Self| {
            diagnostics.message.status.first().map(|status| (status.level, status.values.first().cloned()))
        };
        key(self) != key(other)
    }

    /// The message at a time.
    pub fn at(&self, now: Instant) -> DiagnosticArray {
        let mut message = self.message.clone();
        if now.duration_since(self.made) > STALE {
            for status in &mut message.status {
                status.level = DiagnosticStatus::STALE;
                status.message =
                    format!("no image for more than {} s; before: {}", STALE.as_secs(), status.message);
            }
        }
        message
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use estimator::Status;

    fn diagnostics(map_expected: bool, localization: Localization, reason: &str) -> Diagnostics {
        let status =
            Status { localization, reason: reason.to_owned(), last_map_update_ns: None, held_keyframes: 3 };
        let mut report = StatusReport::new(Some(5), status);
        (report.queries.sent, report.queries.answered) = (2, 1);
        Diagnostics::of("cart7", map_expected, 5_000_000_007, &report)
    }

    fn level(localization: Localization, map_expected: bool) -> u8 {
        diagnostics(map_expected, localization, "").message.status[0].level
    }

    #[test]
    fn levels_say_whether_somebody_must_act() {
        assert_eq!(level(Localization::Localized, true), DiagnosticStatus::OK);
        assert_eq!(level(Localization::OdometryOnly, false), DiagnosticStatus::OK);
        assert_eq!(level(Localization::OdometryOnly, true), DiagnosticStatus::WARN);
        assert_eq!(level(Localization::Lost, true), DiagnosticStatus::ERROR);
        assert_eq!(level(Localization::Starting, true), DiagnosticStatus::WARN);
    }

    #[test]
    fn numbers_in_the_text_are_no_change() {
        let first = diagnostics(true, Localization::Localized, "corrected 0.1 s ago");
        assert!(!first.differs_from(&diagnostics(true, Localization::Localized, "corrected 0.2 s ago")));
        assert!(first.differs_from(&diagnostics(true, Localization::Lost, "corrected 0.1 s ago")));
    }

    #[test]
    fn an_old_status_is_stale() {
        let last = diagnostics(true, Localization::Localized, "fine");
        assert_eq!(last.at(last.made + STALE).status[0].level, DiagnosticStatus::OK);
        let stale = last.at(last.made + STALE + Duration::from_millis(1));
        assert_eq!(stale.status[0].level, DiagnosticStatus::STALE);
        assert!(stale.status[0].message.ends_with("fine"));
    }
}
