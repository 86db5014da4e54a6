//! Why a robot cannot be made, and why a run ends early.

use estimator::EstimatorError;
use sensors::SensorError;
use vision::tracking::TrackerError;

/// Why a robot cannot be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RobotError {
    /// The calibration has no camera, or none is to be used.
    #[error("there is no camera, which the estimator needs")]
    NoCamera,
    /// The front end refuses its settings.
    #[error(transparent)]
    FrontEnd(#[from] TrackerError),
    /// The estimator refuses its settings, or the initial state.
    #[error(transparent)]
    Estimator(#[from] EstimatorError),
    /// The operating system has no thread for odometry at the rate of the IMU.
    #[error("the thread of the prediction cannot be started")]
    Prediction(#[source] std::io::Error),
}

/// Why a run ended early. What was done up to there is kept.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RunError {
    /// The source cannot be read any further.
    #[error(transparent)]
    Source(#[from] SensorError),
    /// The run was stopped from outside.
    #[error("interrupted {seconds:.1} s into the recording")]
    Interrupted {
        /// Time since the first frame.
        seconds: f64,
    },
    /// The estimator cannot be built or continued.
    #[error("at {seconds:.1} s of the recording: {source}")]
    Estimator {
        /// Time since the first frame.
        seconds: f64,
        /// The error of the estimator.
        source: EstimatorError,
    },
    /// The estimator was never initialized.
    #[error("the estimator was not initialized in {seconds:.1} s of recording: {status}")]
    NotInitialized {
        /// Time from the first frame to the last.
        seconds: f64,
        /// What the initialization lacked at the end.
        status: String,
    },
}
