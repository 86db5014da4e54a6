//! Package `builtin_interfaces`.

use serde::{Deserialize, Serialize};

const NANOSECONDS: i64 = 1_000_000_000;

/// A point in time since the epoch of the sender's clock.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Time {
    /// Whole seconds, towards minus infinity.
    pub sec: i32,
    /// Nanoseconds after `sec`, below 10^9.
    pub nanosec: u32,
}

impl Time {
    /// The time as ROS writes it; `None` outside of what `sec` can hold (1901 to 2038).
    pub fn from_nanoseconds(stamp_ns: i64) -> Option<Self> {
        let sec = i32::try_from(stamp_ns.div_euclid(NANOSECONDS)).ok()?;
        Some(Self { sec, nanosec: stamp_ns.rem_euclid(NANOSECONDS) as u32 })
    }

    /// Nanoseconds since the epoch. An invalid `nanosec` of more than a second is added as it is.
    pub fn to_nanoseconds(self) -> i64 {
        i64::from(self.sec) * NANOSECONDS + i64::from(self.nanosec)
    }
}
