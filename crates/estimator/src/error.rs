//! The error type of the filter's verbs.

use crate::config::ConfigError;
use crate::health::Divergence;
use crate::imu::{BadImuSample, ImuGap};
use crate::linear_algebra::NotPositiveDefinite;

/// Errors of the filter's verbs.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum EstimatorError {
    /// A setting or a camera is invalid.
    #[error("estimator settings: {0}")]
    Config(#[from] ConfigError),
    /// An IMU sample was dropped; the filter is unchanged.
    #[error(transparent)]
    BadImu(#[from] BadImuSample),
    /// The IMU samples do not cover an interval; the filter is unchanged.
    #[error(transparent)]
    NoImu(#[from] ImuGap),
    /// An image is not newer than the state; the filter is unchanged.
    #[error("frame at {stamp_ns} ns dropped: the state is already at {state_ns} ns")]
    OldFrame {
        /// Time of the image by the camera's clock, nanoseconds.
        stamp_ns: i64,
        /// Time of the state, nanoseconds.
        state_ns: i64,
    },
    /// The estimate is wrong; the filter must be initialized again.
    #[error("the estimator diverged: {0}")]
    Diverged(#[from] Divergence),
}

impl From<NotPositiveDefinite> for EstimatorError {
    fn from(_: NotPositiveDefinite) -> Self {
        Self::Diverged(Divergence::CovarianceNotPositiveDefinite)
    }
}
