//! Least squares over all poses, velocities, biases and landmarks of a window (Gauss-Newton).
//!
//! The sightings are weighted by Huber's loss until it has converged; then gross outliers are dropped, and
//! plain least squares on the rest gives an estimate with an honest covariance.

use super::NotYet;
use super::inertial::{Interval, moved};
use super::landmark::{self, Landmark};
use super::landmark_block::{LandmarkBlock, landmark_cost};
use super::normal_equations::{NormalEquations, Step, cost};
use super::window::{Window, images_of};
use crate::calibration::CalibratedCamera;
use crate::config::EstimatorConfig;
use crate::propagation::{IMU_DIM, ImuMatrix, ImuState};
use nalgebra::{DVector, Vector3};

/// Most steps with each loss.
const MOST_STEPS: usize = 20;
/// A step that lowers the cost (half squared sigmas) by less is the last one.
const CONVERGED: f64 = 1e-2;
/// Parts of a step that are tried, longest first.
const STEP_LENGTHS: [f64; 5] = [1.0, 0.5, 0.25, 0.1, 0.03];
/// Most steps of a landmark after a step of the poses, and the fall of its cost that is worth another.
const LANDMARK_STEPS: usize = 3;
const LANDMARK_CONVERGED: f64 = 1e-3;
/// Residual from which on Huber's loss is linear, sigmas.
const HUBER: f64 = 2.0;
/// Residual beyond which a sighting is an outlier, sigmas: 1 in 3000 good ones.
const OUTLIER: f64 = 4.0;
/// Sightings that a landmark must keep.
const LEAST_SIGHTINGS: usize = 4;

/// How much a large residual counts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Loss {
    /// Linear from two sigmas on.
    Huber,
    /// Plain least squares.
    Square,
}

impl Loss {
    /// Weight of a residual of `length` sigmas.
    pub fn weight(self, length: f64) -> f64 {
        if self == Self::Square || length <= HUBER { 1.0 } else { HUBER / length }
    }

    /// Its cost.
    pub fn cost(self, length: f64) -> f64 {
        if self == Self::Square || length <= HUBER {
            0.5 * length * length
        } else {
            HUBER * (length - 0.5 * HUBER)
        }
    }
}

/// What the adjustment goes by.
#[derive(Clone, Copy, Debug)]
pub struct Settings<'a> {
    /// Images and tracks.
    pub window: &'a Window,
    /// The readings between images k and k + 1.
    pub intervals: &'a [Interval],
    /// The cameras.
    pub rig: &'a [CalibratedCamera],
    /// Noise, gravity, prior standard deviations.
    pub config: &'a EstimatorConfig,
    /// What is believed of the gyroscope's bias beforehand, rad/s.
    pub gyroscope_bias: Vector3<f64>,
    /// The same of the accelerometer's, m/s^2.
    pub accelerometer_bias: Vector3<f64>,
}

impl Settings<'_> {
    /// How far biases are from what was believed of them.
    pub fn bias_errors(&self, state: &ImuState) -> (Vector3<f64>, Vector3<f64>) {
        (state.gyroscope_bias - self.gyroscope_bias, state.accelerometer_bias - self.accelerometer_bias)
    }
}

/// A landmark and the sightings of its track that are believed.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// Place of its track in the window.
    pub track: usize,
    /// Where it is.
    pub landmark: Landmark,
    /// Which sightings are believed.
    pub used: Vec<bool>,
}

/// The unknowns.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// At each image, oldest first. L has z up and its origin at the newest.
    pub states: Vec<ImuState>,
    /// Landmarks.
    pub landmarks: Vec<Entry>,
}

impl Estimate {
    /// The state at the newest image.
    pub fn newest(&self) -> &ImuState {
        &self.states[self.states.len() - 1]
    }

    fn moved(&self, step: &Step, length: f64) -> Self {
        let mut next = self.clone();
        for (k, state) in next.states.iter_mut().enumerate() {
            *state = moved(state, &(step.states.fixed_rows::<IMU_DIM>(IMU_DIM * k) * length));
        }
        for (entry, error) in next.landmarks.iter_mut().zip(&step.landmarks) {
            entry.landmark = entry.landmark.moved(&(error * length));
        }
        next
    }
}

/// The adjusted window.
#[derive(Clone, Debug)]
pub struct Adjusted {
    /// At the minimum.
    pub estimate: Estimate,
    /// Covariance of the newest state.
    pub covariance: ImuMatrix,
    /// Sum of squares over its degrees of freedom; 1 is right.
    pub reduced_chi_square: f64,
    /// Standard deviation of the length of the way through the window, as a part of it.
    pub sigma_scale: f64,
    /// Part of the sightings that were dropped as outliers.
    pub outliers: f64,
}

/// Finds the minimum from a first guess.
///
/// # Errors
/// [`NotYet::NoParallax`] where there is none, [`NotYet::TooFewTracks`].
pub fn adjust(settings: &Settings<'_>, guess: Estimate) -> Result<Adjusted, NotYet> {
    let sightings = |estimate: &Estimate| -> usize {
        estimate.landmarks.iter().map(|entry| entry.used.iter().filter(|used| **used).count()).sum()
    };
    let all = sightings(&guess);
    let mut estimate = minimize(settings, guess, Loss::Huber);
    drop_outliers(settings, &mut estimate);
    let kept = sightings(&estimate);
    if estimate.landmarks.len() < super::LEAST_TRACKS {
        return Err(NotYet::TooFewTracks { have: estimate.landmarks.len(), need: super::LEAST_TRACKS });
    }
    let estimate = minimize(settings, estimate, Loss::Square);
    let equations = NormalEquations::new(settings, &estimate, Loss::Square);
    let (information, _) = equations.reduced();
    let factor = information.cholesky().ok_or(NotYet::NoParallax)?;
    // The newest state is last, so its marginal information is the last block of the factor.
    let newest = factor.l_dirty().nrows() - IMU_DIM;
    let last: ImuMatrix = factor.l_dirty().fixed_view::<IMU_DIM, IMU_DIM>(newest, newest).into();
    let inverse = last.lower_triangle().try_inverse().ok_or(NotYet::NoParallax)?;
    let covariance = inverse.transpose() * inverse;

    let way = way(&estimate);
    let sigma_scale = way.dot(&factor.solve(&way)).sqrt() / way.norm_squared();
    let cost = cost(settings, &estimate, Loss::Square);
    // Rows: two a sighting, 15 an interval, 6 of the biases. Unknowns: 15 a state less the four of the gauge, 3 a
    // landmark.
    let freedom = (2 * kept) as f64 - (3 * estimate.landmarks.len()) as f64 - 5.0;
    Ok(Adjusted {
        estimate,
        covariance,
        reduced_chi_square: 2.0 * cost / freedom.max(1.0),
        sigma_scale,
        outliers: 1.0 - kept as f64 / all.max(1) as f64,
    })
}

/// All positions as one vector of the states' error: the direction in which the window grows.
fn way(estimate: &Estimate) -> DVector<f64> {
    let mut way = DVector::zeros(IMU_DIM * estimate.states.len());
    for (k, state) in estimate.states.iter().enumerate() {
        way.fixed_rows_mut::<3>(IMU_DIM * k + 3).copy_from(&state.local_from_imu.translation);
    }
    way
}

/// Gauss-Newton steps on everything, each shortened until the cost falls.
///
/// After each step the landmarks are moved to where the new poses see them (embedded point iterations, Jeong et al.,
/// PAMI 2012): when the scale of a window grows all depths must grow with it, which no linear step does.
fn minimize(settings: &Settings<'_>, mut estimate: Estimate, loss: Loss) -> Estimate {
    let mut now = cost(settings, &estimate, loss);
    for _ in 0..MOST_STEPS {
        let Some(step) = NormalEquations::new(settings, &estimate, loss).solve() else { break };
        let before = now;
        for length in STEP_LENGTHS {
            let mut tried = estimate.moved(&step, length);
            settle_landmarks(settings, &mut tried, loss);
            let lower = cost(settings, &tried, loss);
            if lower < now {
                (now, estimate) = (lower, tried);
                break;
            }
        }
        if before - now <= CONVERGED {
            break;
        }
    }

    estimate
}

/// Moves each landmark to where it fits the poses best, from where it is.
fn settle_landmarks(settings: &Settings<'_>, estimate: &mut Estimate, loss: Loss) {
    let Estimate { states, landmarks } = estimate;
    for entry in landmarks.iter_mut() {
        let mut now = landmark_cost(settings, states, entry, loss);
        for _ in 0..LANDMARK_STEPS {
            let block = LandmarkBlock::new(settings, states, entry, loss);
            let Some(error) = block.solve() else { break };
            let tried = Entry { landmark: entry.landmark.moved(&error), ..entry.clone() };
            let lower = landmark_cost(settings, states, &tried, loss);
            if lower.is_nan() || now - lower <= LANDMARK_CONVERGED {
                break;
            }
            now = lower;
            entry.landmark = tried.landmark;
        }
    }
}

/// Drops the sightings that do not fit, and the landmarks of which too little is left.
fn drop_outliers(settings: &Settings<'_>, estimate: &mut Estimate) {
    let limit = OUTLIER * settings.config.sigma_track_px;
    let Estimate { states, landmarks } = estimate;
    for entry in landmarks.iter_mut() {
        let track = &settings.window.tracks[entry.track];
        for (sighting, used) in track.iter().zip(&mut entry.used) {
            let residual = landmark::residual(&entry.landmark, &track[0], sighting, states, settings.rig);
            *used &= residual.is_some_and(|residual| residual.norm() <= limit);
        }
    }
    landmarks.retain(|entry| {
        let track = &settings.window.tracks[entry.track];
        let kept: Vec<_> =
            track.iter().zip(&entry.used).filter(|(_, used)| **used).map(|(sighting, _)| *sighting).collect();
        kept.len() >= LEAST_SIGHTINGS && images_of(&kept) >= LEAST_SIGHTINGS
    });
}
