//! Noise levels that cannot be what the innovations show.

/// White noise of an IMU that is so many times the stated one is another error: in motion it is 3 to 10 times that of a data
/// sheet.
pub(super) const IMPLAUSIBLE_IMU_SCALE: f64 = 20.0;
/// Tracks that are so inaccurate are no tracks, px.
pub(super) const IMPLAUSIBLE_TRACK_PX: f64 = 5.0;
/// A fault ends below this part of its limit.
const ENDS_BELOW: f64 = 0.7;

/// A noise level that the innovations would move below what is allowed: the covariance may be too large.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum NoiseBound {
    /// The IMU is better than stated.
    #[error("the noise of the IMU is at its lower bound of {scale:.1} times the stated one")]
    Imu {
        /// Factor on the stated densities.
        scale: f64,
    },
    /// Tracks are more accurate than the filter takes them for.
    #[error("the noise of tracks is at its lower bound of {sigma_px:.2} px")]
    Tracks {
        /// px.
        sigma_px: f64,
    },
}

/// A noise level so high that something else must be wrong.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum NoiseFault {
    /// Images and IMU contradict each other by more than an IMU's noise.
    #[error(
        "images and IMU agree only with {scale:.0} times the IMU's stated noise: check its units and axes, the calibration and the \
         time offset (`driftless check-calibration`)"
    )]
    Imu {
        /// Factor on the stated densities.
        scale: f64,
    },
    /// No motion explains the tracks.
    #[error(
        "tracks agree with the motion only to {sigma_px:.0} px: check the calibration of the cameras and which is which \
         (`driftless check-calibration`)"
    )]
    Tracks {
        /// px.
        sigma_px: f64,
    },
}

/// Whether a level is too high: from its limit on, until it is clearly below it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limit {
    most: f64,
    is_exceeded: bool,
}

impl Limit {
    pub(super) fn new(most: f64) -> Self {
        Self { most, is_exceeded: false }
    }

    pub(super) fn note(&mut self, level: f64) {
        self.is_exceeded = level > if self.is_exceeded { ENDS_BELOW * self.most } else { self.most };
    }

    pub(super) fn is_exceeded(&self) -> bool {
        self.is_exceeded
    }
}
