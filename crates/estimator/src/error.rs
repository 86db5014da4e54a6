//! What can go wrong with a measurement or with the filter.

use crate::linear_algebra::NotPositiveDefinite;

/// What can go wrong with a measurement or with the filter.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EstimatorError {
    /// A setting cannot work.
    #[error("the estimator's settings: {0}")]
    Config(String),
    /// An IMU reading was dropped.
    #[error("IMU reading at {stamp_ns} ns dropped: {why}")]
    BadImu {
        /// Its time.
        stamp_ns: i64,
        /// What is wrong with it.
        why: &'static str,
    },
    /// The IMU does not cover an interval.
    #[error("no IMU readings from {from_ns} to {to_ns} ns; check the recording for a gap")]
    NoImu {
        /// Begin, nanoseconds.
        from_ns: i64,
        /// End, nanoseconds.
        to_ns: i64,
    },
    /// A frame is older than the state.
    #[error("frame at {stamp_ns} ns dropped: the state is already at {state_ns} ns")]
    OldFrame {
        /// Time of the frame.
        stamp_ns: i64,
        /// Time of the state.
        state_ns: i64,
    },
    /// The filter is broken.
    #[error("the estimator diverged: {0}")]
    Diverged(String),
}

impl From<NotPositiveDefinite> for EstimatorError {
    fn from(error: NotPositiveDefinite) -> Self {
        Self::Diverged(error.to_string())
    }
}
