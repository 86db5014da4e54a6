//! The initial state of a run, and excerpts of recordings.

use super::arguments::Init;
use estimator::initialization::static_init::{REST_SECONDS, StaticInitError};
use estimator::propagation::GYROSCOPE_BIAS;
use estimator::{EstimatorConfig, ImuSample, InitialState};
use nalgebra::Vector3;
use sensors::{Recording, SequenceError, TruthRow};
use std::path::PathBuf;

/// How far into a recording [`first_rest`] searches, seconds.
const SEARCH_SECONDS: f64 = 10.0;

/// An initial state from ground truth is at most so long before the first image, nanoseconds: without images the filter
/// would only lose accuracy.
const LEAD_NS: i64 = 100_000_000;

/// Why a recording cannot be started as the switches say.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StartError {
    /// A file of the recording.
    #[error(transparent)]
    Recording(#[from] SequenceError),
    /// There is no ground truth.
    #[error("--init truth: {} has no ground truth; use --init auto", root.display())]
    NoTruth {
        /// The recording.
        root: PathBuf,
    },
    /// Ground truth and IMU contradict each other, or do not overlap.
    #[error("--init truth: the direction of gravity in the truth's frame cannot be found from truth and IMU")]
    NoGravity,
    /// No row of the ground truth is late enough.
    #[error("--init truth: the ground truth ends before the IMU begins")]
    TruthEndsEarly,
    /// The velocity is neither given nor can it be computed.
    #[error("--init truth: the first row has no velocity, and no row follows")]
    NoVelocity,
    /// The first readings are not at rest.
    #[error("--init static (--init auto waits until it can initialize, at rest or in motion): {0}")]
    NotAtRest(#[source] StaticInitError),
    /// A time of an excerpt.
    #[error("{switch} is {seconds}; it must be {wanted}")]
    Time {
        /// The switch.
        switch: &'static str,
        /// Its value.
        seconds: f64,
        /// What it must be.
        wanted: &'static str,
    },
    /// The excerpt begins after the last image.
    #[error("--start-at {seconds}: the recording has no image after that")]
    PastEnd {
        /// Seconds after the first image.
        seconds: f64,
    },
}

/// The initial state of a recording; `None` where the estimator initializes itself during the run.
///
/// # Errors
/// [`StartError`]: what the recording lacks.
pub fn initial_state(
    recording: &Recording<'_>,
    init: Init,
    config: &EstimatorConfig,
) -> Result<Option<InitialState>, StartError> {
    match init {
        Init::Truth => from_truth(recording, config).map(Some),
        Init::Static => {
            let start = InitialState::from_rest(&first_readings(recording)?, config);
            start.map(Some).map_err(StartError::NotAtRest)
        }
        Init::Auto => Ok(None),
    }
}

/// An excerpt of a recording, as if nothing else had been recorded.
///
/// # Arguments
/// * `start_at`: begin, seconds after the first image.
/// * `duration`: length, seconds; `None` for all the rest.
///
/// # Errors
/// [`StartError`]: a time is not a positive number, or past the end.
pub fn excerpt(
    recording: Recording<'_>,
    start_at: f64,
    duration: Option<f64>,
) -> Result<Recording<'_>, StartError> {
    let length = duration.unwrap_or(f64::INFINITY);
    if !(start_at.is_finite() && start_at >= 0.0) {
        let wanted = "zero or a positive number of seconds";
        return Err(StartError::Time { switch: "--start-at", seconds: start_at, wanted });
    }
    if length.is_nan() || length <= 0.0 {
        let wanted = "a positive number of seconds";
        return Err(StartError::Time { switch: "--duration", seconds: length, wanted });
    }
    let first_ns = recording.frames()?.next().transpose()?.map_or(0, |frame| frame.stamp_ns);
    let begin_ns = first_ns + (start_at * 1e9) as i64;
    let part = recording.between(begin_ns, begin_ns.saturating_add((length * 1e9) as i64));
    if part.frames()?.next().is_none() {
        return Err(StartError::PastEnd { seconds: start_at });
    }
    Ok(part)
}

/// The first state at rest within the first ten seconds of readings; for the gyroscope's bias.
pub fn first_rest(samples: &[ImuSample], config: &EstimatorConfig) -> Option<InitialState> {
    let end_ns = samples.first()?.stamp_ns + (SEARCH_SECONDS * 1e9) as i64;
    let mut next_ns = i64::MIN;
    (0..samples.partition_point(|sample| sample.stamp_ns <= end_ns)).find_map(|first| {
        if samples[first].stamp_ns < next_ns {
            return None;
        }
        next_ns = samples[first].stamp_ns + (REST_SECONDS * 0.2e9) as i64;
        InitialState::from_rest(window(samples, first), config).ok()
    })
}

/// The readings of [`REST_SECONDS`] from `first` on.
fn window(samples: &[ImuSample], first: usize) -> &[ImuSample] {
    let end_ns = samples.get(first).map_or(0, |sample| sample.stamp_ns + (REST_SECONDS * 1e9) as i64);
    let end = samples.partition_point(|sample| sample.stamp_ns <= end_ns);
    &samples[first.min(end)..end]
}

/// The readings of the first [`REST_SECONDS`] of a recording.
fn first_readings(recording: &Recording<'_>) -> Result<Vec<ImuSample>, SequenceError> {
    let mut readings: Vec<ImuSample> = Vec::new();
    for reading in recording.imu_samples()? {
        readings.push(reading?);
        let length_ns = readings[readings.len() - 1].stamp_ns - readings[0].stamp_ns;
        if length_ns > (REST_SECONDS * 1e9) as i64 {
            readings.pop();
            break;
        }
    }
    Ok(readings)
}

fn from_truth(recording: &Recording<'_>, config: &EstimatorConfig) -> Result<InitialState, StartError> {
    if !recording.has_truth() {
        return Err(StartError::NoTruth { root: recording.root().to_path_buf() });
    }
    let Some(gravity) = recording.truth_gravity()? else {
        return Err(StartError::NoGravity);
    };
    let first_reading = recording.imu_samples()?.next().transpose()?;
    let imu_begin_ns = first_reading.map_or(i64::MAX, |reading| reading.stamp_ns);
    let first_frame = recording.frames()?.next().transpose()?;
    let frames_begin_ns = first_frame.map_or(i64::MIN, |frame| frame.stamp_ns);
    let begin_ns = (imu_begin_ns - 10_000_000).max(frames_begin_ns - LEAD_NS);
    let due =
        |row: &Result<TruthRow, _>| row.as_ref().map_or(true, |row: &TruthRow| row.stamp_ns >= begin_ns);
    let mut rows = recording.truth()?.skip_while(|row| !due(row));
    let Some(row) = rows.next().transpose()? else {
        return Err(StartError::TruthEndsEarly);
    };
    let next = rows.next().transpose()?;
    let Some(velocity) = row.velocity.or_else(|| Some(slope(&row, &next?))) else {
        return Err(StartError::NoVelocity);
    };
    let stamp_ns = row.stamp_ns.max(imu_begin_ns);
    let at = |sigmas| InitialState::from_truth(stamp_ns, &row.pose, &velocity, &gravity, sigmas);
    if let Some((gyroscope, accelerometer)) = row.gyroscope_bias.zip(row.accelerometer_bias) {
        let mut start = at(config.initial.with_known_biases());
        (start.imu.gyroscope_bias, start.imu.accelerometer_bias) = (gyroscope, accelerometer);
        return Ok(start);
    }
    let mut start = at(config.initial);
    // The truth does not know the biases; a moment at rest shows that of the gyroscope.
    if let Some(rest) = first_rest(&readings_from(recording, stamp_ns)?, config) {
        start.imu.gyroscope_bias = rest.imu.gyroscope_bias;
        let measured = rest.covariance.fixed_view::<3, 3>(GYROSCOPE_BIAS, GYROSCOPE_BIAS);
        start.covariance.fixed_view_mut::<3, 3>(GYROSCOPE_BIAS, GYROSCOPE_BIAS).copy_from(&measured);
    }
    Ok(start)
}

/// The readings in which [`first_rest`] searches, from a time on.
fn readings_from(recording: &Recording<'_>, from_ns: i64) -> Result<Vec<ImuSample>, SequenceError> {
    let until_ns = from_ns.saturating_add((SEARCH_SECONDS * 1e9) as i64);
    let of_time = |reading: &Result<ImuSample, SequenceError>| {
        reading.as_ref().map_or(true, |reading| reading.stamp_ns <= until_ns)
    };
    let readings = recording.imu_samples()?.take_while(of_time);
    readings.filter(|reading| reading.as_ref().map_or(true, |reading| reading.stamp_ns >= from_ns)).collect()
}

fn slope(a: &TruthRow, b: &TruthRow) -> Vector3<f64> {
    (b.pose.translation - a.pose.translation) / ((b.stamp_ns - a.stamp_ns) as f64 * 1e-9)
}
