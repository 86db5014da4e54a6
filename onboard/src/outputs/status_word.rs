//! The state of a robot in a word.

use estimator::{Localization, Status};

/// The state in a word, for people.
pub(crate) fn status_word(status: &Status) -> &'static str {
    match status.localization {
        Localization::Localized => "localized",
        Localization::OdometryOnly => "odometry only",
        Localization::Lost => "lost",
        Localization::Starting => "starting",
    }
}
