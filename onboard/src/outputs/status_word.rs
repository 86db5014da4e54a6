//! The state of a robot in a word.

use estimator::{Localization, Status};
use odometry::STARTING;

/// Whether a robot is only starting: it has no pose yet, and none was lost.
pub(crate) fn is_starting(status: &Status) -> bool {
    status.localization == Localization::Lost && status.reason.starts_with(STARTING)
}

/// The state in a word, for people.
pub(crate) fn status_word(status: &Status) -> &'static str {
    match status.localization {
        Localization::Localized => "localized",
        Localization::OdometryOnly => "odometry only",
        Localization::Lost if is_starting(status) => "starting",
        Localization::Lost => "lost",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_that_starts_is_not_lost() {
        let word = |localization, reason: &str| {
            let reason = reason.to_owned();
            status_word(&Status { localization, reason, last_map_update_ns: None, held_keyframes: 0 })
        };
        assert_eq!(word(Localization::Lost, "starting: no readings of the IMU yet"), "starting");
        assert_eq!(word(Localization::Lost, "the map contradicted the pose 3 times in a row"), "lost");
        assert_eq!(word(Localization::Localized, "starting: never"), "localized");
    }
}
