//! Finds the state that a recording starts from.

use super::arguments::Init;
use crate::estimator::initialization::REST_SECONDS;
use crate::estimator::{EstimatorConfig, ImuSample, InitialState};
use crate::sequence::{Sequence, TruthRow};
use anyhow::{Context as _, Result, bail};
use nalgebra::Vector3;

/// How far into a recording [`first_rest`] looks, seconds.
const SEARCH_SECONDS: f64 = 10.0;

/// How long before the first image a start from truth lies at most, nanoseconds: without images the filter would only
/// lose what the truth tells.
const LEAD_NS: i64 = 100_000_000;

/// Truth is kept from so long before an excerpt to so long after, nanoseconds: it is interpolated at the ends.
const TRUTH_LEAD_NS: i64 = 300_000_000;

/// The first state; `None` where it is to be found on the way.
///
/// # Errors
/// A sentence that says what the recording lacks and which switch helps.
pub fn initial_state(
    sequence: &Sequence,
    init: Init,
    config: &EstimatorConfig,
) -> Result<Option<InitialState>> {
    match init {
        Init::Truth => from_truth(sequence, config).map(Some),
        Init::Static => {
            let readings = window(&sequence.imu_samples, 0);
            let start = InitialState::from_rest(readings, config);
            start.context("--init static (--init auto waits for a start, and starts in motion too)").map(Some)
        }
        Init::Auto => Ok(None),
    }
}

/// A part of a recording, as if nothing else had been recorded.
///
/// # Arguments
/// * `start_at`: begin, seconds after the first image.
/// * `duration`: length, seconds; unset, all the rest.
///
/// # Errors
/// A sentence: a time that is not a positive number, or past the end.
pub fn excerpt(sequence: &Sequence, start_at: f64, duration: Option<f64>) -> Result<Sequence> {
    let length = duration.unwrap_or(f64::INFINITY);
    if !(start_at.is_finite() && start_at >= 0.0) {
        bail!("--start-at is {start_at}; it must be zero or a positive number of seconds");
    }
    if length.is_nan() || length <= 0.0 {
        bail!("--duration is {length}; it must be a positive number of seconds");
    }
    let first_ns = sequence.frames.first().map_or(0, |frame| frame.stamp_ns);
    let begin_ns = first_ns + (start_at * 1e9) as i64;
    let end_ns = begin_ns.saturating_add((length * 1e9) as i64);
    let kept = |stamp_ns: i64, lead_ns: i64| {
        (begin_ns - lead_ns..=end_ns.saturating_add(lead_ns)).contains(&stamp_ns)
    };
    let mut part = sequence.clone();
    part.frames.retain(|frame| kept(frame.stamp_ns, 0));
    part.imu_samples.retain(|reading| kept(reading.stamp_ns, LEAD_NS));
    if let Some(rows) = &mut part.groundtruth {
        rows.retain(|row| kept(row.stamp_ns, TRUTH_LEAD_NS));
    }
    if part.frames.is_empty() {
        bail!("--start-at {start_at}: the recording has no image after that");
    }
    Ok(part)
}

/// The first state at rest in the first ten seconds of readings, for those who only want the gyroscope's bias.
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

fn from_truth(sequence: &Sequence, config: &EstimatorConfig) -> Result<InitialState> {
    let Some(rows) = sequence.groundtruth.as_deref().filter(|rows| rows.len() > 1) else {
        bail!("--init truth: {} has no ground truth; use --init auto", sequence.root.display())
    };
    let Some(gravity) = sequence.truth_gravity() else {
        bail!(
            "--init truth: the direction of gravity in the truth's frame cannot be found from truth and IMU"
        )
    };
    let imu_begin_ns = sequence.imu_samples.first().map_or(i64::MAX, |sample| sample.stamp_ns);
    let frames_begin_ns = sequence.frames.first().map_or(i64::MIN, |frame| frame.stamp_ns);
    let begin_ns = (imu_begin_ns - 10_000_000).max(frames_begin_ns - LEAD_NS);
    let Some(first) = rows.iter().position(|row| row.stamp_ns >= begin_ns) else {
        bail!("--init truth: the ground truth ends before the IMU begins")
    };
    let row = &rows[first];
    let velocity = row.velocity.or_else(|| slope(rows, first));
    let Some(velocity) = velocity else {
        bail!("--init truth: the first row has no velocity, and no row follows")
    };
    let stamp_ns = row.stamp_ns.max(imu_begin_ns);
    let mut start = InitialState::from_truth(stamp_ns, &row.pose, &velocity, &gravity, config.initial);
    start.imu.gyroscope_bias = row.gyroscope_bias.unwrap_or_default();
    start.imu.accelerometer_bias = row.accelerometer_bias.unwrap_or_default();
    Ok(start)
}

fn slope(rows: &[TruthRow], first: usize) -> Option<Vector3<f64>> {
    let (a, b) = (rows.get(first)?, rows.get(first + 1)?);
    Some((b.pose.translation - a.pose.translation) / ((b.stamp_ns - a.stamp_ns) as f64 * 1e-9))
}
