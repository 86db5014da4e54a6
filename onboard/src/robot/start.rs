//! Finds the state that a recording starts from.

use super::arguments::Init;
use crate::estimator::initialization::REST_SECONDS;
use crate::estimator::{EstimatorConfig, ImuSample, InitialState};
use crate::sequence::{Sequence, TruthRow};
use anyhow::{Context as _, Result, bail};
use nalgebra::Vector3;

/// How far into a recording [`Init::Auto`] looks for a body at rest, seconds.
const SEARCH_SECONDS: f64 = 10.0;

/// How long before the first image a start from truth lies at most, nanoseconds: without images the filter would only
/// lose what the truth tells.
const LEAD_NS: i64 = 100_000_000;

/// The first state.
///
/// # Errors
/// A sentence that says what the recording lacks and which switch helps.
pub fn initial_state(sequence: &Sequence, init: Init, config: &EstimatorConfig) -> Result<InitialState> {
    match init {
        Init::Truth => from_truth(sequence, config),
        Init::Static => {
            let readings = window(&sequence.imu_samples, 0);
            InitialState::from_rest(readings, config).context("--init static")
        }
        Init::Auto => first_rest(&sequence.imu_samples, config),
    }
}

/// The readings of [`REST_SECONDS`] from `first` on.
fn window(samples: &[ImuSample], first: usize) -> &[ImuSample] {
    let end_ns = samples.get(first).map_or(0, |sample| sample.stamp_ns + (REST_SECONDS * 1e9) as i64);
    let end = samples.partition_point(|sample| sample.stamp_ns <= end_ns);
    &samples[first.min(end)..end]
}

fn first_rest(samples: &[ImuSample], config: &EstimatorConfig) -> Result<InitialState> {
    let end_ns = samples.first().map_or(0, |sample| sample.stamp_ns + (SEARCH_SECONDS * 1e9) as i64);
    let mut why = None;
    let mut next_ns = i64::MIN;
    for first in 0..samples.partition_point(|sample| sample.stamp_ns <= end_ns) {
        if samples[first].stamp_ns < next_ns {
            continue;
        }
        next_ns = samples[first].stamp_ns + (REST_SECONDS * 0.2e9) as i64;
        match InitialState::from_rest(window(samples, first), config) {
            Ok(start) => return Ok(start),
            Err(error) => why = why.or(Some(error)),
        }
    }
    let why = why.map_or_else(|| "the recording has no IMU readings".to_owned(), |error| error.to_string());
    bail!("no start at rest in the first {SEARCH_SECONDS} s: {why}")
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
