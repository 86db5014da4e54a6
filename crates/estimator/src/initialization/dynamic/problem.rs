//! The least-squares problem of a window: what is given, the unknowns, and a step of the unknowns.

use super::reprojection::InverseDepthLandmark;
use super::window::{Window, WindowObservation};
use crate::calibration::CalibratedCamera;
use crate::config::EstimatorConfig;
use crate::preintegration::PreintegratedImu;
use crate::propagation::{IMU_DIM, ImuState};
use geometry::robust::huber;
use nalgebra::{DVector, Vector3};

/// Residual from which on Huber's loss is linear, sigmas.
const HUBER_SIGMAS: f64 = 2.0;

/// Loss of the reprojection residuals.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Loss {
    /// Huber's loss, linear from two sigmas on.
    Huber,
    /// Least squares.
    Square,
}

impl Loss {
    fn threshold(self) -> f64 {
        match self {
            Self::Huber => HUBER_SIGMAS,
            Self::Square => f64::INFINITY,
        }
    }

    /// Weight of a residual of `length` sigmas.
    pub fn weight(self, length: f64) -> f64 {
        huber(length, self.threshold()).0
    }

    /// Cost of a residual of `length` sigmas.
    pub fn cost(self, length: f64) -> f64 {
        huber(length, self.threshold()).1
    }
}

/// What is given.
#[derive(Clone, Copy, Debug)]
pub struct Problem<'a> {
    /// Images and tracks.
    pub window: &'a Window,
    /// Preintegrated IMU samples between images k and k + 1.
    pub intervals: &'a [PreintegratedImu],
    /// Cameras by index.
    pub cameras: &'a [CalibratedCamera],
    /// Noise, gravity, prior standard deviations.
    pub config: &'a EstimatorConfig,
    /// Prior of the gyroscope bias, rad/s.
    pub gyroscope_bias: Vector3<f64>,
    /// Prior of the accelerometer bias, m/s^2.
    pub accelerometer_bias: Vector3<f64>,
}

impl Problem<'_> {
    /// Differences of the biases to their priors.
    pub fn bias_errors(&self, state: &ImuState) -> (Vector3<f64>, Vector3<f64>) {
        (state.gyroscope_bias - self.gyroscope_bias, state.accelerometer_bias - self.accelerometer_bias)
    }

    /// The observations of a landmark that are not outliers.
    pub fn inliers<'a>(
        &'a self,
        landmark: &'a WindowLandmark,
    ) -> impl Iterator<Item = &'a WindowObservation> {
        let track = &self.window.tracks[landmark.track];
        track.iter().zip(&landmark.inlier).filter(|(_, inlier)| **inlier).map(|(observation, _)| observation)
    }
}

/// A landmark and the inliers of its track.
#[derive(Clone, Debug, PartialEq)]
pub struct WindowLandmark {
    /// Index of its track in the window.
    pub track: usize,
    /// Its position.
    pub position: InverseDepthLandmark,
    /// Which observations of the track are inliers.
    pub inlier: Vec<bool>,
}

/// The unknowns.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// State at each image, oldest first. L has z up and its origin at the newest.
    pub states: Vec<ImuState>,
    /// Landmarks.
    pub landmarks: Vec<WindowLandmark>,
}

/// A step of all unknowns.
pub struct Step {
    /// 15 entries per image.
    pub states: DVector<f64>,
    /// `(x, y, ρ)` of every landmark.
    pub landmarks: Vec<Vector3<f64>>,
}

impl Estimate {
    /// The state at the newest image.
    pub fn newest(&self) -> &ImuState {
        &self.states[self.states.len() - 1]
    }

    /// Adds `length` times a step.
    #[must_use]
    pub fn retract(&self, step: &Step, length: f64) -> Self {
        let mut next = self.clone();
        for (k, state) in next.states.iter_mut().enumerate() {
            *state = state.retract(&(step.states.fixed_rows::<IMU_DIM>(IMU_DIM * k) * length));
        }
        for (landmark, error) in next.landmarks.iter_mut().zip(&step.landmarks) {
            landmark.position = landmark.position.retract(&(error * length));
        }
        next
    }
}
