//! What the robot knows of where it is, said plainly.

use crate::Estimator;
use serde::{Deserialize, Serialize};

/// Whether the pose in G can be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Localization {
    /// Good odometry, but no place in the map yet (or no map at all).
    OdometryOnly,
    /// A pose in the map, confirmed recently enough.
    Localized,
    /// There was a pose, or odometry, that can no longer be trusted.
    Lost,
}

/// [`Localization`] and why.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// The state.
    pub localization: Localization,
    /// The reason, for a person.
    pub reason: String,
    /// Time at which the map last corrected the state, nanoseconds.
    pub last_map_update_ns: Option<i64>,
    /// Keyframes held.
    pub held_keyframes: usize,
}

impl Status {
    /// Adds to the reason why the map does not answer.
    pub fn with_failure(mut self, failure: Option<&str>) -> Self {
        if let Some(failure) = failure {
            self.reason = format!("{}; the map does not answer: {failure}", self.reason);
        }
        self
    }
}

impl Estimator {
    /// What the robot knows of where it is.
    pub fn status(&self) -> Status {
        let seconds_since_map =
            self.last_map_update_ns.map(|last| (self.state.stamp_ns - last) as f64 * 1e-9);
        let (localization, reason) = match (&self.state.transform, &self.lost, seconds_since_map) {
            (Some(_), _, Some(age)) => {
                (Localization::Localized, format!("the map corrected the pose {age:.1} s ago"))
            }
            (_, Some(reason), _) => (Localization::Lost, reason.clone()),
            _ => (Localization::OdometryOnly, "no match with the map yet".to_owned()),
        };
        Status {
            localization,
            reason,
            last_map_update_ns: self.last_map_update_ns,
            held_keyframes: self.covariance.held.len(),
        }
    }

    /// Counts a verified answer that the state cannot believe; after too many in a row it is the state
    /// that is wrong, and `global_from_local` is given up.
    pub(crate) fn note_contradiction(&mut self) {
        if self.state.transform.is_none() {
            return;
        }
        self.rejections_in_a_row += 1;
        if self.rejections_in_a_row >= self.config.lost_after_rejections {
            self.lost =
                Some(format!("the map contradicted the pose {} times in a row", self.rejections_in_a_row));
            self.rejections_in_a_row = 0;
            self.last_map_update_ns = None;
            self.remove_transform();
        }
    }
}
