//! The status as ROS diagnostics.

use super::super::status_word::status_word;
use super::settings::RosBody;
use estimator::Localization;
use robot::StatusReport;
use ros_messages::builtin_interfaces::Time;
use ros_messages::diagnostic_msgs::{DiagnosticArray, DiagnosticStatus, KeyValue};
use ros_messages::std_msgs::Header;
use std::time::{Duration, Instant};

/// A status is stale so long after the last image that was processed.
const STALE: Duration = Duration::from_secs(2);

/// The last status.
#[derive(Clone, Debug)]
pub struct Diagnostics {
    /// When the last image was processed; before the first one, when this was made.
    pub last_image: Instant,
    /// The message.
    pub message: DiagnosticArray,
}

impl Diagnostics {
    /// The diagnostics of a status.
    ///
    /// # Arguments
    /// * `body`: whose frame may have been taken for that of the IMU, which is worth a warning.
    /// * `map_tilt_deg`: angle between the z axis of the map and the vertical, degrees, where that is worth one.
    /// * `stamp_ns`: on the clock of the sensors, nanoseconds.
    pub fn of(
        robot: &str,
        map_expected: bool,
        body: &RosBody,
        map_tilt_deg: Option<f64>,
        stamp_ns: i64,
        report: &StatusReport,
    ) -> Self {
        let StatusReport { status, queries, .. } = report;
        let assumed = body.mount.is_assumed().then(|| {
            let base = &body.frames.base_link;
            format!(
                "{base} is taken to be the IMU: no transform states where it is, give --imu-in-base-link; "
            )
        });
        let tilted = map_tilt_deg.map(|tilt_deg| {
            format!(
                "the z axis of the map is {tilt_deg:.1} degrees off the vertical: x, y and yaw in it are not those on the floor; build the map from \
                 reference poses with z up, or without any; "
            )
        });
        let warnings: String = [assumed, tilted].into_iter().flatten().collect();
        let level = match status.localization {
            Localization::Localized | Localization::OdometryOnly
                if !warnings.is_empty() || report.has_sensor_fault =>
            {
                DiagnosticStatus::WARN
            }
            Localization::Localized => DiagnosticStatus::OK,
            Localization::OdometryOnly if !map_expected => DiagnosticStatus::OK,
            Localization::OdometryOnly | Localization::Starting => DiagnosticStatus::WARN,
            Localization::Lost => DiagnosticStatus::ERROR,
        };
        let value = |key: &str, value: String| KeyValue { key: key.to_owned(), value };
        let component = DiagnosticStatus {
            level,
            name: "driftless: localization".to_owned(),
            message: warnings + &status.reason,
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
        Self { last_image: Instant::now(), message: DiagnosticArray { header, status: vec![component] } }
    }

    /// Whether level or state differ: the text holds numbers that change with every image.
    pub fn differs_from(&self, other: &Self) -> bool {
        let key = |diagnostics: &Self| {
            diagnostics.message.status.first().map(|status| (status.level, status.values.first().cloned()))
        };
        key(self) != key(other)
    }

    /// The message at a time: stale where no image is processed any more, and an error all the same where the robot is lost.
    pub fn at(&self, now: Instant) -> DiagnosticArray {
        let mut message = self.message.clone();
        if now.duration_since(self.last_image) > STALE {
            for status in &mut message.status {
                if status.level != DiagnosticStatus::ERROR {
                    status.level = DiagnosticStatus::STALE;
                }
                status.message =
                    format!("no image processed for more than {} s; {}", STALE.as_secs(), status.message);
            }
        }
        message
    }
}

#[cfg(test)]
mod tests {
    use super::super::base_mount::BaseMount;
    use super::*;
    use estimator::Status;
    use geometry::Pose;

    fn diagnostics(map_expected: bool, localization: Localization, reason: &str) -> Diagnostics {
        of_body(&RosBody::default(), map_expected, localization, reason)
    }

    fn of_body(body: &RosBody, map_expected: bool, localization: Localization, reason: &str) -> Diagnostics {
        let status =
            Status { localization, reason: reason.to_owned(), last_map_update_ns: None, held_keyframes: 3 };
        let mut report = StatusReport::new(Some(5), status);
        (report.queries.sent, report.queries.answered) = (2, 1);
        Diagnostics::of("cart7", map_expected, body, None, 5_000_000_007, &report)
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
    fn a_fault_of_a_sensor_is_a_warning() {
        let level_of = |localization| {
            let reason = "cam1: no images for 3 s".to_owned();
            let status = Status { localization, reason, last_map_update_ns: None, held_keyframes: 3 };
            let mut report = StatusReport::new(Some(5), status);
            report.has_sensor_fault = true;
            Diagnostics::of("cart7", true, &RosBody::default(), None, 5, &report).message.status[0].level
        };
        assert_eq!(level_of(Localization::Localized), DiagnosticStatus::WARN);
        assert_eq!(level_of(Localization::Lost), DiagnosticStatus::ERROR);
    }

    #[test]
    fn a_frame_that_is_taken_to_be_the_imu_is_a_warning_until_it_is_stated() {
        let body = RosBody { mount: BaseMount::assumed(), ..RosBody::default() };
        let first_of =
            |localization| of_body(&body, false, localization, "fine").message.status.swap_remove(0);
        let localized = first_of(Localization::Localized);
        assert_eq!(localized.level, DiagnosticStatus::WARN);
        assert!(localized.message.starts_with("base_link is taken to be the IMU"), "{}", localized.message);
        assert!(localized.message.ends_with("; fine"), "{}", localized.message);
        assert_eq!(first_of(Localization::OdometryOnly).level, DiagnosticStatus::WARN);
        assert_eq!(first_of(Localization::Lost).level, DiagnosticStatus::ERROR);
        body.mount.state(Pose::identity());
        let stated = first_of(Localization::Localized);
        assert_eq!((stated.level, stated.message.as_str()), (DiagnosticStatus::OK, "fine"));
    }

    #[test]
    fn a_map_that_is_not_level_is_a_warning() {
        let level_of = |localization| {
            let reason = "fine".to_owned();
            let status = Status { localization, reason, last_map_update_ns: None, held_keyframes: 3 };
            let report = StatusReport::new(Some(5), status);
            let body = RosBody::default();
            let component =
                Diagnostics::of("cart7", true, &body, Some(11.3), 5, &report).message.status.swap_remove(0);
            assert!(
                component.message.starts_with("the z axis of the map is 11.3 degrees off the vertical: "),
                "{}",
                component.message
            );
            component.level
        };
        assert_eq!(level_of(Localization::Localized), DiagnosticStatus::WARN);
        assert_eq!(level_of(Localization::Lost), DiagnosticStatus::ERROR);
    }

    #[test]
    fn numbers_in_the_text_are_no_change() {
        let first = diagnostics(true, Localization::Localized, "corrected 0.1 s ago");
        assert!(!first.differs_from(&diagnostics(true, Localization::Localized, "corrected 0.2 s ago")));
        assert!(first.differs_from(&diagnostics(true, Localization::Lost, "corrected 0.1 s ago")));
    }

    #[test]
    fn an_old_status_is_stale_and_a_lost_robot_stays_an_error() {
        let later = STALE + Duration::from_millis(1);
        for (localization, level, level_later) in [
            (Localization::Localized, DiagnosticStatus::OK, DiagnosticStatus::STALE),
            (Localization::Starting, DiagnosticStatus::WARN, DiagnosticStatus::STALE),
            (Localization::Lost, DiagnosticStatus::ERROR, DiagnosticStatus::ERROR),
        ] {
            let last = diagnostics(true, localization, "the reason");
            let status = |after: Duration| last.at(last.last_image + after).status.swap_remove(0);
            assert_eq!((status(STALE).level, status(STALE).message.as_str()), (level, "the reason"));
            let old = status(later);
            assert_eq!(old.level, level_later);
            assert_eq!(old.message, "no image processed for more than 2 s; the reason");
        }
    }
}
