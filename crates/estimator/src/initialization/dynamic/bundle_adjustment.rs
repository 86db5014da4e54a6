//! Visual-inertial bundle adjustment over all poses, velocities, biases and landmarks of a window (Gauss-Newton).
//!
//! Minimized with Huber's loss first; then outliers are dropped, and least squares on the rest gives a consistent covariance.

use super::error::DynamicInitError;
use super::landmark_block::{LandmarkBlock, landmark_cost};
use super::normal_equations::{NormalEquations, cost};
use super::problem::{Estimate, Loss, Problem, WindowLandmark};
use super::reprojection;
use super::window::{MIN_TRACKS, images_of};
use crate::propagation::{IMU_DIM, ImuMatrix};
use nalgebra::DVector;

/// Maximum number of steps with each loss.
const MAX_STEPS: usize = 20;
/// Decrease of the cost (half squared sigmas) below which a step is the last one.
const CONVERGED: f64 = 1e-2;
/// Fractions of a step that are tried, longest first.
const STEP_LENGTHS: [f64; 5] = [1.0, 0.5, 0.25, 0.1, 0.03];
/// Maximum number of steps of a landmark after a step of the poses.
const LANDMARK_STEPS: usize = 3;
/// Decrease of the cost of a landmark below which its step is the last one.
const LANDMARK_CONVERGED: f64 = 1e-3;
/// Residual beyond which an observation is an outlier, sigmas: 1 in 3000 inliers.
const OUTLIER_SIGMAS: f64 = 4.0;
/// Minimum number of inliers of a landmark, and of its images.
const MIN_OBSERVATIONS: usize = 4;

/// The adjusted window.
#[derive(Clone, Debug)]
pub struct Adjusted {
    /// Estimate at the minimum.
    pub estimate: Estimate,
    /// Covariance of the newest state.
    pub covariance: ImuMatrix,
    /// Reduced chi-square, 1 is expected.
    pub reduced_chi_square: f64,
    /// Standard deviation of the scale of the trajectory, as a fraction.
    pub sigma_scale: f64,
    /// Fraction of the observations dropped as outliers.
    pub outliers: f64,
}

/// Minimizes the cost from an initial guess.
///
/// # Errors
/// [`DynamicInitError::NoParallax`] where there is none, [`DynamicInitError::TooFewTracks`].
pub fn adjust(problem: &Problem<'_>, guess: Estimate) -> Result<Adjusted, DynamicInitError> {
    let inliers = |estimate: &Estimate| -> usize {
        estimate.landmarks.iter().map(|landmark| problem.inliers(landmark).count()).sum()
    };
    let all = inliers(&guess);
    let mut estimate = minimize(problem, guess, Loss::Huber);
    drop_outliers(problem, &mut estimate);
    let kept = inliers(&estimate);
    if estimate.landmarks.len() < MIN_TRACKS {
        return Err(DynamicInitError::TooFewTracks { have: estimate.landmarks.len(), need: MIN_TRACKS });
    }
    let estimate = minimize(problem, estimate, Loss::Square);
    let equations = NormalEquations::new(problem, &estimate, Loss::Square);
    let (information, _) = equations.reduced();
    let factor = information.cholesky().ok_or(DynamicInitError::NoParallax)?;
    // The newest state is last, so its marginal information is the last block of the factor.
    let newest = factor.l_dirty().nrows() - IMU_DIM;
    let last: ImuMatrix = factor.l_dirty().fixed_view::<IMU_DIM, IMU_DIM>(newest, newest).into();
    let inverse = last.lower_triangle().try_inverse().ok_or(DynamicInitError::NoParallax)?;
    let covariance = inverse.transpose() * inverse;

    let scale = scale_direction(&estimate);
    let sigma_scale = scale.dot(&factor.solve(&scale)).sqrt() / scale.norm_squared();
    let cost = cost(problem, &estimate, Loss::Square);
    // Residuals: 2 per observation, 15 per interval, 6 of the biases. Unknowns: 15 per state minus 4 of the gauge, 3 per
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

/// All positions as one error vector of the states: the direction in which the scale of the trajectory increases.
fn scale_direction(estimate: &Estimate) -> DVector<f64> {
    let mut direction = DVector::zeros(IMU_DIM * estimate.states.len());
    for (k, state) in estimate.states.iter().enumerate() {
        direction.fixed_rows_mut::<3>(IMU_DIM * k + 3).copy_from(&state.local_from_imu.translation);
    }
    direction
}

/// Gauss-Newton steps on all unknowns, each shortened until the cost decreases.
///
/// After each step the landmarks are optimized for the new poses (embedded point iterations, Jeong et al., PAMI 2012): when
/// the scale increases, all depths must increase with it, which a linear step does not achieve.
fn minimize(problem: &Problem<'_>, mut estimate: Estimate, loss: Loss) -> Estimate {
    let mut now = cost(problem, &estimate, loss);
    for _ in 0..MAX_STEPS {
        let Some(step) = NormalEquations::new(problem, &estimate, loss).solve() else { break };
        let before = now;
        for length in STEP_LENGTHS {
            let mut tried = estimate.retract(&step, length);
            optimize_landmarks(problem, &mut tried, loss);
            let lower = cost(problem, &tried, loss);
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

/// Optimizes each landmark for fixed poses.
fn optimize_landmarks(problem: &Problem<'_>, estimate: &mut Estimate, loss: Loss) {
    let Estimate { states, landmarks } = estimate;
    for landmark in landmarks.iter_mut() {
        let mut now = landmark_cost(problem, states, landmark, loss);
        for _ in 0..LANDMARK_STEPS {
            let block = LandmarkBlock::new(problem, states, landmark, loss);
            let Some(error) = block.solve() else { break };
            let position = landmark.position.retract(&error);
            let tried = WindowLandmark { position, ..landmark.clone() };
            let lower = landmark_cost(problem, states, &tried, loss);
            if lower.is_nan() || now - lower <= LANDMARK_CONVERGED {
                break;
            }
            now = lower;
            landmark.position = tried.position;
        }
    }
}

/// Drops outlying observations, and landmarks with too few inliers.
fn drop_outliers(problem: &Problem<'_>, estimate: &mut Estimate) {
    let limit = OUTLIER_SIGMAS * problem.config.sigma_track_px;
    let Estimate { states, landmarks } = estimate;
    for landmark in landmarks.iter_mut() {
        let track = &problem.window.tracks[landmark.track];
        for (observation, inlier) in track.iter().zip(&mut landmark.inlier) {
            let residual =
                reprojection::residual(&landmark.position, &track[0], observation, states, problem.cameras);
            *inlier &= residual.is_some_and(|residual| residual.norm() <= limit);
        }
    }
    landmarks.retain(|landmark| {
        let kept: Vec<_> = problem.inliers(landmark).copied().collect();
        kept.len() >= MIN_OBSERVATIONS && images_of(&kept) >= MIN_OBSERVATIONS
    });
}
