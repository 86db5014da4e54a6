//! Versions of the format.

use calibration::{CameraSensor, camera_groups};

/// Version of the format of a file. A file has the oldest one that can hold what its robot records, so that older programs read it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Schema {
    /// Candidates and answers are of camera 0.
    FirstCamera = 1,
    /// Candidates and answers state their camera.
    EachCamera = 2,
}

impl Schema {
    /// The newest one that this program reads.
    pub(crate) const NEWEST: Self = Self::EachCamera;

    /// That of a robot with some cameras: with one stereo pair or single camera, the map is asked about camera 0 alone.
    pub(crate) fn of_cameras(cameras: &[CameraSensor]) -> Self {
        if camera_groups(cameras).len() > 1 { Self::EachCamera } else { Self::FirstCamera }
    }

    /// That with a number; `None` where this program does not know it.
    pub(crate) fn of_number(number: u16) -> Option<Self> {
        [Self::FirstCamera, Self::EachCamera].into_iter().find(|schema| schema.number() == number)
    }

    /// Its number in a file.
    pub(crate) fn number(self) -> u16 {
        self as u16
    }
}
