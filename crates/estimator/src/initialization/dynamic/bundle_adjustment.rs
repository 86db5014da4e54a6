//! Visual-inertial bundle adjustment over all poses, velocities, biases and landmarks of a window.
//!
//! Minimized with Huber's loss first; then outliers are dropped, and least squares on the rest gives a consistent covariance.

use super::BiasPrior;
use super::error::DynamicInitError;
use super::window::{MIN_TRACKS, Window};
use crate::calibration::CalibratedCamera;
use crate::config::EstimatorConfig;
use crate::inertial_chain::InertialChain;
use crate::preintegration::PreintegratedImu;
use crate::propagation::{IMU_DIM, ImuMatrix, ImuState};
use adjustment::{
    Bundle, InverseDepthLandmark, Loss, MountedCamera, PixelModel, PosePrior, Problem, ViewMotion,
    gauge_information,
};
use geometry::Pose;
use nalgebra::DVector;

/// Residual from which on Huber's loss is linear, sigmas.
const HUBER_SIGMAS: f64 = 2.0;
/// Prior information of an inverse depth, m^2: a landmark without parallax stays solvable.
const DEPTH_INFORMATION: f64 = 1e-2;
/// Maximum number of steps of a landmark after a step of the poses.
const LANDMARK_STEPS: usize = 3;
/// Residual beyond which an observation is an outlier, sigmas: 1 in 3000 inliers.
const OUTLIER_SIGMAS: f64 = 4.0;
/// Minimum number of inliers of a landmark, and of its images.
const MIN_OBSERVATIONS: usize = 4;

/// The adjusted window.
#[derive(Clone, Debug)]
pub struct Adjusted {
    /// Body poses, motions and landmarks at the minimum.
    pub bundle: Bundle,
    /// State at the newest image.
    pub newest: ImuState,
    /// Its covariance.
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
/// # Arguments
/// * `guess`: a state at each image of the window, and landmarks.
///
/// # Errors
/// [`DynamicInitError::NoParallax`] where there is none, [`DynamicInitError::TooFewTracks`], [`DynamicInitError::NoImu`].
pub fn adjust(
    window: &Window,
    cameras: &[CalibratedCamera],
    config: &EstimatorConfig,
    prior: &BiasPrior,
    guess: Bundle,
) -> Result<Adjusted, DynamicInitError> {
    let (newest, first) = (guess.poses.len() - 1, guess.motions[0]);
    let mean = ViewMotion {
        gyroscope_bias: prior.gyroscope,
        accelerometer_bias: prior.accelerometer,
        velocity: first.velocity,
    };
    let intervals = preintegrated(window, &first, config).ok_or(DynamicInitError::NoImu)?;
    let chain = InertialChain::new(intervals, mean, Pose::identity(), config);
    // Position and yaw of the newest image define L.
    let initial = &config.initial;
    let information = gauge_information(initial.sigma_yaw_rad, f64::INFINITY, initial.sigma_position_m);
    let gauge = PosePrior { view: newest, pose: guess.poses[newest], information };
    let mounted = |calibrated: &CalibratedCamera| {
        MountedCamera::new(calibrated.camera.clone(), &calibrated.imu_from_camera.inverse()).at_any_scale()
    };
    let cameras: Vec<MountedCamera> = cameras.iter().map(mounted).collect();
    let pixels = PixelModel {
        sigma_px: config.sigma_track_px,
        loss: Loss::Huber,
        depth_information: DEPTH_INFORMATION,
        inverse_depths: [f64::NEG_INFINITY, f64::INFINITY],
        landmark_steps: LANDMARK_STEPS,
    };
    let problem = Problem { cameras: &cameras, factors: vec![&chain, &gauge], pixels };

    let all = observation_count(&guess);
    let mut bundle = problem.minimize_undamped(guess, HUBER_SIGMAS);
    drop_outliers(&problem, &mut bundle);
    let kept = observation_count(&bundle);
    if bundle.landmarks.len() < MIN_TRACKS {
        return Err(DynamicInitError::TooFewTracks { have: bundle.landmarks.len(), need: MIN_TRACKS });
    }
    let bundle = problem.minimize_undamped(bundle, f64::INFINITY);
    let covariance = problem.covariance(&bundle).ok_or(DynamicInitError::NoParallax)?;
    let scale = scale_direction(&bundle);
    let sigma_scale = scale.dot(&covariance.times(&scale)).sqrt() / scale.norm_squared();
    // Residuals: 2 per observation, 15 per interval, 6 of the biases. Unknowns: 15 per state minus 4 of the gauge, 3 per
    // landmark.
    let freedom = (2 * kept) as f64 - (3 * bundle.landmarks.len()) as f64 - 5.0;
    let of_newest: ImuMatrix = covariance.of_state(newest).fixed_view::<IMU_DIM, IMU_DIM>(0, 0).into_owned();
    Ok(Adjusted {
        newest: ImuState::of(bundle.poses[newest], &bundle.motions[newest]),
        covariance: (of_newest + of_newest.transpose()) * 0.5,
        reduced_chi_square: 2.0 * problem.cost(&bundle, f64::INFINITY) / freedom.max(1.0),
        sigma_scale,
        outliers: 1.0 - kept as f64 / all.max(1) as f64,
        bundle,
    })
}

/// The readings between the images, integrated with the biases of a motion.
fn preintegrated(
    window: &Window,
    motion: &ViewMotion,
    config: &EstimatorConfig,
) -> Option<Vec<(usize, PreintegratedImu)>> {
    let ViewMotion { gyroscope_bias, accelerometer_bias, .. } = motion;
    let intervals = window.readings.iter().enumerate();
    intervals
        .map(|(image, readings)| {
            Some((image, PreintegratedImu::new(readings, gyroscope_bias, accelerometer_bias, config)?))
        })
        .collect()
}

fn observation_count(bundle: &Bundle) -> usize {
    bundle.landmarks.iter().map(|landmark| landmark.observations.len()).sum()
}

/// All positions as one error vector of the states: the direction in which the scale of the trajectory increases.
fn scale_direction(bundle: &Bundle) -> DVector<f64> {
    let layout = bundle.layout();
    let mut direction = DVector::zeros(layout.dim());
    for (view, pose) in bundle.poses.iter().enumerate() {
        direction.fixed_rows_mut::<3>(layout.pose(view).start + 3).copy_from(&pose.translation);
    }
    direction
}

/// Drops outlying observations, and landmarks with too few inliers.
fn drop_outliers(problem: &Problem<'_>, bundle: &mut Bundle) {
    let limit = OUTLIER_SIGMAS * problem.pixels.sigma_px;
    let poses = bundle.view_poses();
    let inliers = |landmark: &InverseDepthLandmark| {
        let errors = landmark.errors(problem.cameras, &poses);
        let keep: Vec<bool> = errors.iter().map(|&error| error <= limit).collect();
        let anchor =
            if keep[landmark.anchor] { landmark.anchor } else { keep.iter().position(|&keep| keep)? };
        let landmark = landmark.anchored_at(anchor, problem.cameras, &poses)?.without(&keep);
        let images = landmark.observations.last()?.view() - landmark.observations[0].view() + 1;
        (landmark.observations.len() >= MIN_OBSERVATIONS && images >= MIN_OBSERVATIONS).then_some(landmark)
    };
    bundle.landmarks = bundle.landmarks.iter().filter_map(inliers).collect();
}
