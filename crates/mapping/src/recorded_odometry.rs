//! Odometry over a recording in memory, for building a map from it.

use super::camera::is_stereo;
use ::odometry::{EstimatorSupervisor, FrontEnd, calibrated_cameras};
use estimator::propagation::ImuState;
use estimator::{ConfigError, EstimatorConfig, EstimatorError, MapMode, ReadingCheck, TrackObservation};
use sensors::{Frame, ImuSample, Sequence};
use std::path::PathBuf;
use vision::tracking::{TrackerError, TrackerOptions};

use super::odometry::Odometry;

/// Points are lost between images further apart than this (median, ns): a robot turns by 20 degrees meanwhile.
const MAX_TRACKED_GAP_NS: i64 = 300_000_000;

/// Why there is no odometry of a recording.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OdometryError {
    /// The recording has no IMU.
    #[error(
        "{sequence} has no readings of an IMU, and no poses were given: a map needs one of them; give poses with --poses FILE"
    )]
    NoImu {
        /// The recording.
        sequence: PathBuf,
    },
    /// The estimator was never initialized.
    #[error("{sequence}: odometry was never initialized: {reason}")]
    NeverInitialized {
        /// The recording.
        sequence: PathBuf,
        /// What it waited for.
        reason: String,
    },
    /// The tracker refuses its settings or the cameras.
    #[error("the tracker cannot start: {0}")]
    Tracker(#[from] TrackerError),
    /// Settings that cannot be used.
    #[error("settings of the estimator: {0}")]
    Config(#[from] ConfigError),
    /// A fault of the filter.
    #[error(transparent)]
    Estimator(#[from] EstimatorError),
}

/// What odometry found.
pub struct OdometryRun {
    /// Time of an image (ns), and the state then.
    pub states: Vec<(i64, ImuState)>,
    /// How often the filter diverged.
    pub divergences: usize,
    /// The filter at the end.
    pub supervisor: EstimatorSupervisor,
}

/// Runs odometry over a recording.
///
/// Tracks that are made of images are put into its frames. Images before the initialization have no state.
///
/// # Arguments
/// * `cameras`: how many are used, the first ones.
/// * `progress`: called with the number of frames done.
///
/// # Errors
/// A recording without IMU, tracks and images, or in which the estimator is never initialized.
pub fn run_odometry(
    sequence: &mut Sequence,
    cameras: usize,
    progress: impl FnMut(usize, usize),
) -> Result<Odometry, OdometryError> {
    run_watched(sequence, cameras, progress, |_, _| ())
}

/// [`run_odometry`], with each state as soon as it is known.
///
/// # Arguments
/// * `located`: called with each image that has a state.
///
/// # Errors
/// As [`run_odometry`].
pub fn run_watched(
    sequence: &mut Sequence,
    cameras: usize,
    progress: impl FnMut(usize, usize),
    located: impl FnMut(&Frame, &ImuState),
) -> Result<Odometry, OdometryError> {
    let config = odometry_config(sequence)?;
    let run = run_configured(sequence, cameras, &config, progress, located)?;
    if run.states.is_empty() {
        let reason = run.supervisor.status().reason;
        return Err(OdometryError::NeverInitialized { sequence: sequence.root.clone(), reason });
    }
    let imu_noise_scale = run.supervisor.learned_noise().map_or(1.0, |learned| learned.imu_noise_scale);
    Ok(Odometry { states: run.states, cameras, imu_noise_scale, config, keyframes: None })
}

/// [`run_watched`] with settings; without an error where the filter is never initialized.
///
/// # Errors
/// A tracker that cannot start, a fault of the filter.
pub fn run_configured(
    sequence: &mut Sequence,
    cameras: usize,
    config: &EstimatorConfig,
    mut progress: impl FnMut(usize, usize),
    mut located: impl FnMut(&Frame, &ImuState),
) -> Result<OdometryRun, OdometryError> {
    let rig = calibrated_cameras(&sequence.cameras[..cameras]);
    let mut supervisor = EstimatorSupervisor::initializing(config.clone(), rig);
    let contents = sequence.contents();
    let mut front_end = if contents.tracks {
        None
    } else {
        let options = TrackerOptions::default();
        Some(FrontEnd::new(&sequence.cameras[..cameras], &options)?)
    };
    let readings = usable_readings(&sequence.imu_samples);
    let mut states: Vec<(i64, ImuState)> = Vec::new();
    let mut divergences = 0;
    let mut next_reading = 0;
    let frames = sequence.frames.len();
    for (index, frame) in sequence.frames.iter_mut().enumerate() {
        progress(index, frames);
        // Up to the first one that is not before the frame's last row, by the clock of the IMU.
        let until_ns = supervisor.last_row_ns(frame.stamp_ns);
        while let Some(&reading) = readings.get(next_reading) {
            next_reading += 1;
            match supervisor.imu(reading) {
                Ok(()) | Err(EstimatorError::BadImu(_)) => {}
                Err(error) => return Err(error.into()),
            }
            if reading.stamp_ns >= until_ns {
                break;
            }
        }
        if let Some(front_end) = &mut front_end {
            if frame.images.is_empty() {
                continue;
            }
            front_end.set_time_offset_ns(supervisor.camera_time_offset_ns());
            let since_ns = front_end.last_stamp_ns().unwrap_or(frame.stamp_ns);
            let read = &readings[..next_reading];
            let begin = read.partition_point(|reading| reading.stamp_ns <= since_ns).saturating_sub(1);
            match front_end.track_frame(frame, &read[begin..]) {
                Ok(tracks) => frame.tracks = tracks,
                Err(error) => {
                    tracing::warn!(%error, "image left out");
                    continue;
                }
            }
        }
        let used = |track: &&TrackObservation| usize::from(track.camera) < cameras;
        let tracks: Vec<TrackObservation> = frame.tracks.iter().filter(used).copied().collect();
        match step(&mut supervisor, frame.stamp_ns, &tracks) {
            Ok(Some(state)) => {
                located(frame, &state);
                states.push((frame.stamp_ns, state));
            }
            Ok(None) | Err(EstimatorError::NoImu { .. } | EstimatorError::OldFrame { .. }) => {}
            Err(error @ EstimatorError::Diverged(_)) => {
                tracing::warn!(%error, "odometry starts again");
                supervisor.reinitialize(frame.stamp_ns, &error, &readings[..next_reading]);
                divergences += 1;
            }
            Err(error) => return Err(error.into()),
        }
    }
    Ok(OdometryRun { states, divergences, supervisor })
}

/// The readings without those that cannot be used, which are counted and logged.
fn usable_readings(readings: &[ImuSample]) -> Vec<ImuSample> {
    let mut check = ReadingCheck::default();
    let mut first_bad = None;
    let is_usable = |reading: &&ImuSample| {
        let checked = check.check(reading);
        first_bad = first_bad.or(checked.err());
        checked.is_ok()
    };
    let usable: Vec<ImuSample> = readings.iter().filter(is_usable).copied().collect();
    if let Some(first) = first_bad {
        tracing::warn!(count = readings.len() - usable.len(), %first, "bad readings of the IMU were left out");
    }
    usable
}

/// Whether images of a stereo pair follow each other so slowly that points cannot be tracked.
pub fn is_sparse(sequence: &Sequence) -> bool {
    let contents = sequence.contents();
    let mut gaps: Vec<i64> =
        sequence.frames.windows(2).map(|frames| frames[1].stamp_ns - frames[0].stamp_ns).collect();
    gaps.sort_unstable();
    let slow = gaps.get(gaps.len() / 2).is_some_and(|&gap_ns| gap_ns > MAX_TRACKED_GAP_NS);
    slow && contents.images && !contents.tracks && is_stereo(&sequence.cameras)
}

/// Settings of odometry over a recording.
///
/// # Errors
/// A recording without an IMU.
pub fn odometry_config(sequence: &Sequence) -> Result<EstimatorConfig, OdometryError> {
    let calibration = sequence.calibration();
    let imu = calibration.imu.filter(|_| !sequence.imu_samples.is_empty());
    let Some(imu) = imu else { return Err(OdometryError::NoImu { sequence: sequence.root.clone() }) };
    let mut config = EstimatorConfig::default();
    config.imu_noise = imu.noise;
    config.gravity = imu.gravity_magnitude.unwrap_or(config.gravity);
    config.mode = MapMode::Odometry;
    config.validate()?;
    Ok(config)
}

/// One image; `None` where the estimator is not initialized.
fn step(
    supervisor: &mut EstimatorSupervisor,
    stamp_ns: i64,
    tracks: &[TrackObservation],
) -> Result<Option<ImuState>, EstimatorError> {
    supervisor.try_initialize(stamp_ns, tracks)?;
    let Some(estimator) = supervisor.estimator_mut() else { return Ok(None) };
    estimator.time_update(stamp_ns)?;
    estimator.track_update(tracks)?;
    let (gyroscope_bias, accelerometer_bias) = estimator.biases();
    let state = ImuState {
        local_from_imu: estimator.local_from_imu().pose,
        velocity: estimator.velocity(),
        gyroscope_bias,
        accelerometer_bias,
    };
    supervisor.update_last_trusted();
    Ok(Some(state))
}
