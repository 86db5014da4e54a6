//! The streams of a live source.

use super::fault::{FaultKind, FaultLog};
use std::fmt;
use std::time::Duration;

/// Stamps are nanoseconds since 1970 or since a start; later ones than in the year 2096 are mistakes.
const STAMPS_NS: std::ops::RangeInclusive<i64> = 0..=4_000_000_000_000_000_000;

/// A stream of measurements that arrive live.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[non_exhaustive]
pub enum Stream {
    /// Readings of the IMU.
    Imu,
    /// Images of a camera.
    Camera(usize),
    /// Tracks (and features) of a front end that runs elsewhere.
    Tracks,
    /// Readings of the wheels.
    Wheels,
    /// Positions of GNSS.
    Gnss,
}

impl Stream {
    /// What the stream consists of, plural.
    pub(super) fn noun(self) -> &'static str {
        match self {
            Self::Imu => "readings",
            Self::Camera(_) => "images",
            Self::Tracks => "frames of tracks",
            Self::Wheels => "readings of the wheels",
            Self::Gnss => "positions of GNSS",
        }
    }
}

impl fmt::Display for Stream {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Imu => write!(formatter, "imu"),
            Self::Camera(index) => write!(formatter, "cam{index}"),
            Self::Tracks => write!(formatter, "tracks"),
            Self::Wheels => write!(formatter, "wheels"),
            Self::Gnss => write!(formatter, "gnss"),
        }
    }
}

/// Whether a stamp can be one; notes one that cannot.
pub(super) fn check_stamp(stream: Stream, stamp_ns: i64, now: Duration, faults: &mut FaultLog) -> bool {
    let is_stamp = STAMPS_NS.contains(&stamp_ns);
    if !is_stamp {
        let problem =
            format!("a stamp of {stamp_ns} ns is no time since 1970; {} are not used", stream.noun());
        faults.note(stream, FaultKind::WrongStamp, now, problem);
    }
    is_stamp
}
