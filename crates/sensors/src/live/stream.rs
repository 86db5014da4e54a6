//! The streams of a live source.

use std::fmt;

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
}

impl Stream {
    /// What the stream consists of, plural.
    pub(super) fn noun(self) -> &'static str {
        match self {
            Self::Imu => "readings",
            Self::Camera(_) => "images",
            Self::Tracks => "frames of tracks",
            Self::Wheels => "readings of the wheels",
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
        }
    }
}
