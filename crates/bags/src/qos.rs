//! What the publisher of a recorded topic offered, as rosbag2 writes it down: `ros2 bag play` offers the same again.

use std::fmt::Write as _;

/// The entry of a channel's metadata, and the column of SQLite.
pub(crate) const KEY: &str = "offered_qos_profiles";

/// The quality of service that the publisher of a topic offers. Without it players offer what subscribers of latched
/// topics do not accept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum OfferedQos {
    /// Reliable, for those who listen now.
    Reliable {
        /// Messages that are kept for a slow subscriber.
        depth: u32,
    },
    /// Best effort, for those who listen now: sensors over a bad network. Subscribers that ask for reliable do not
    /// accept it.
    BestEffort {
        /// Messages that are kept for a slow subscriber.
        depth: u32,
    },
    /// Reliable and transient local: who comes later gets the last messages, too.
    Latched {
        /// Messages that are kept for those who come later.
        depth: u32,
    },
}

impl Default for OfferedQos {
    /// Reliable, the last 10: ROS's default.
    fn default() -> Self {
        Self::Reliable { depth: 10 }
    }
}

impl OfferedQos {
    /// The list of this one profile in YAML, with the words of version 9 of rosbag2's metadata (Jazzy and later).
    ///
    /// # Arguments
    /// * `indent`: before each line.
    pub(crate) fn yaml(self, indent: &str) -> String {
        let (depth, reliability, durability) = match self {
            Self::Reliable { depth } => (depth, "reliable", "volatile"),
            Self::BestEffort { depth } => (depth, "best_effort", "volatile"),
            Self::Latched { depth } => (depth, "reliable", "transient_local"),
        };
        let mut text = String::new();
        let mut line = |line: &str| {
            let _ = writeln!(text, "{indent}{line}");
        };
        line("- history: keep_last");
        line(&format!("  depth: {depth}"));
        line(&format!("  reliability: {reliability}"));
        line(&format!("  durability: {durability}"));
        infinite(&mut line, "deadline");
        infinite(&mut line, "lifespan");
        line("  liveliness: automatic");
        infinite(&mut line, "liveliness_lease_duration");
        line("  avoid_ros_namespace_conventions: false");
        text
    }
}

/// A duration without end, as rmw writes it: the largest number of nanoseconds.
fn infinite(line: &mut impl FnMut(&str), name: &str) {
    let (seconds, nanoseconds) = (i64::MAX / 1_000_000_000, i64::MAX % 1_000_000_000);
    line(&format!("  {name}:"));
    line(&format!("    sec: {seconds}"));
    line(&format!("    nsec: {nanoseconds}"));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_profile_is_written_as_rosbag2_writes_it() {
        let expected = "- history: keep_last\n  depth: 1\n  reliability: reliable\n  durability: transient_local\n  \
            deadline:\n    sec: 9223372036\n    nsec: 854775807\n  lifespan:\n    sec: 9223372036\n    nsec: 854775807\n  \
            liveliness: automatic\n  liveliness_lease_duration:\n    sec: 9223372036\n    nsec: 854775807\n  \
            avoid_ros_namespace_conventions: false\n";
        assert_eq!(OfferedQos::Latched { depth: 1 }.yaml(""), expected);
        let sensors = OfferedQos::BestEffort { depth: 5 }.yaml("    ");
        assert!(sensors.lines().all(|line| line.starts_with("    ")), "{sensors}");
        assert!(
            sensors.contains("depth: 5\n      reliability: best_effort\n      durability: volatile\n"),
            "{sensors}"
        );
        assert!(OfferedQos::default().yaml("").contains("  reliability: reliable\n  durability: volatile\n"));
    }
}
