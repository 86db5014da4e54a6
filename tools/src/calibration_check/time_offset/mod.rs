//! Coarse time offset of the cameras: the lag at which the rotation rates of images and gyroscope correlate most.
//!
//! A filter linearizes about the stated offset and finds errors of some tens of milliseconds; drivers with wrong stamps are late by
//! tenths of a second. The rates need no other calibration than the rotation between camera and IMU, and no prediction by the
//! gyroscope, which an offset would spoil.

mod correlation;
mod gyroscope_angles;
mod image_rates;
#[cfg(test)]
mod tests;

use correlation::RatePairs;
use estimator::{EstimatorConfig, ReadingCheck};
use gyroscope_angles::GyroscopeAngles;
use image_rates::{ImageRate, image_rates};
use sensors::{ImuSample, Sequence};
use serde::Serialize;
use vision::tracking::TrackerError;

/// Lags between two that are compared, and the number of them to each side of the stated offset: 1.2 s, so that a second has a peak.
const STEP_NS: i64 = 5_000_000;
const STEPS: i64 = 240;
/// A lag at which the gyroscope covers too few images correlates less than any other.
const UNCOVERED: f64 = -1.0;
/// The peak is that of a parabola through it and the correlations so many steps beside it.
const PEAK_STEPS: usize = 4;
/// A second peak rises by this above the lowest correlation between it and the first; noise rises less.
const MIN_RISE: f64 = 0.02;
/// A correlation is none of unrelated signals from this many standard deviations of Fisher's transform on: it is the best one of
/// hundreds of lags.
const MIN_SIGNIFICANCE: f64 = 5.0;
/// What the best lag leaves unexplained of the squared rates, any other peak leaves so many times.
const MIN_UNEXPLAINED_RATIO: f64 = 1.5;

/// The coarse search for the time offset.
#[derive(Clone, Debug, Serialize)]
pub struct CoarseTimeOffset {
    /// How far was searched to both sides of the stated offset, seconds.
    pub range_s: f64,
    /// Intervals between images that were compared at the best lag.
    pub intervals: usize,
    /// RMS of the gyroscope's rate about its mean in them, rad/s.
    pub rate_rms_rad_s: f64,
    /// The best lag; `None` with too few intervals.
    pub best: Option<CorrelationPeak>,
    /// Standard deviation of the best lag, seconds; `None` where it is no peak.
    pub sigma_s: Option<f64>,
    /// The highest other peak, or the end of the range where the correlation rises towards it; `None` without a positive one.
    pub second: Option<CorrelationPeak>,
    /// Standard deviation of the correlation of unrelated signals that are as smooth as these.
    pub noise_correlation: f64,
    /// Why the best lag need not be the offset; `None` where it is.
    pub undetermined: Option<Undetermined>,
}

/// A maximum of the correlation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct CorrelationPeak {
    /// To be added to the times of the images beside the stated offset, seconds.
    pub lag_s: f64,
    /// Correlation of the rates, at most 1.
    pub correlation: f64,
}

/// Why a recording does not show the time offset.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Undetermined {
    /// Too few images show a rotation while the gyroscope has readings.
    TooFewIntervals,
    /// No lag correlates more than unrelated signals may.
    NoCorrelation,
    /// The correlation is highest at the end of the range.
    EndOfRange,
    /// Another lag fits about as well.
    Ambiguous,
    /// The peak is so wide that the estimate of the filter could not begin there.
    WidePeak,
}

impl Undetermined {
    /// The reason in words.
    pub fn describe(self) -> &'static str {
        match self {
            Self::TooFewIntervals => {
                "too few images have tracks and readings of the gyroscope at their times"
            }
            Self::NoCorrelation => {
                "images and gyroscope do not turn alike at any lag: the rotation rate hardly changes, or the extrinsics are wrong"
            }
            Self::EndOfRange => "they turn most alike at the end of the range",
            Self::Ambiguous => "the motion repeats itself, and another lag fits about as well",
            Self::WidePeak => "the rotation rate changes too slowly",
        }
    }
}

impl CoarseTimeOffset {
    /// Found minus stated offset, seconds; `None` where the motion does not show it.
    pub fn offset_s(&self) -> Option<f64> {
        self.best.filter(|_| self.undetermined.is_none()).map(|best| best.lag_s)
    }
}

/// Searches for the time offset by the rotation rates of camera 0 and the gyroscope.
///
/// # Arguments
/// * `config`: with the stated offset.
/// * `max_sigma_s`: a peak that is less certain determines nothing, seconds.
/// * `progress`: called with the number of frames done.
///
/// # Errors
/// The tracker refuses the camera.
pub(super) fn coarse_time_offset(
    sequence: &Sequence,
    config: &EstimatorConfig,
    max_sigma_s: f64,
    progress: impl FnMut(usize),
) -> Result<CoarseTimeOffset, TrackerError> {
    let rates = image_rates(sequence, progress)?;
    let mut check = ReadingCheck::default();
    let usable = sequence.imu_samples.iter().filter(|reading| check.check(reading).is_ok());
    let readings: Vec<ImuSample> = usable.copied().collect();
    Ok(search(&rates, &GyroscopeAngles::new(&readings), config.imu_stamp_ns(0), max_sigma_s))
}

fn search(
    rates: &[ImageRate],
    gyroscope: &GyroscopeAngles,
    stated_ns: i64,
    max_sigma_s: f64,
) -> CoarseTimeOffset {
    let pairs = |lag_ns: i64| RatePairs::at(rates, gyroscope, stated_ns + lag_ns);
    let lags_ns: Vec<i64> = (-STEPS..=STEPS).map(|step| step * STEP_NS).collect();
    let correlations: Vec<f64> =
        lags_ns.iter().map(|&lag_ns| pairs(lag_ns).map_or(UNCOVERED, |pairs| pairs.correlation())).collect();
    let peak =
        |at: usize| CorrelationPeak { lag_s: lags_ns[at] as f64 * 1e-9, correlation: correlations[at] };
    let highest = (0..correlations.len()).max_by(|&a, &b| correlations[a].total_cmp(&correlations[b]));
    let compared = highest.and_then(|at| Some((at, pairs(lags_ns[at])?)));
    let mut found = CoarseTimeOffset {
        range_s: (STEPS * STEP_NS) as f64 * 1e-9,
        intervals: compared.as_ref().map_or(0, |(_, pairs)| pairs.len()),
        rate_rms_rad_s: 0.0,
        best: None,
        sigma_s: None,
        second: None,
        noise_correlation: 0.0,
        undetermined: Some(Undetermined::TooFewIntervals),
    };
    let Some((at, pairs)) = compared else { return found };
    found.rate_rms_rad_s = pairs.rms();
    found.best = Some(peak(at));
    found.second = second_peak(&correlations, at).map(peak).filter(|second| second.correlation > 0.0);
    found.noise_correlation = pairs.noise_correlation();
    if let Some(parabola) = Parabola::about(&correlations, at) {
        let step_s = STEP_NS as f64 * 1e-9;
        let correlation = parabola.height.min(1.0);
        found.best = Some(CorrelationPeak { lag_s: peak(at).lag_s + parabola.offset * step_s, correlation });
        // The Cramer-Rao bound of a delay in white noise, for as many residuals as are independent.
        let independent = pairs.len() as f64 / pairs.dependence_of_residuals();
        let information = independent * correlation * parabola.curvature / (step_s * step_s);
        found.sigma_s = Some(((1.0 - correlation * correlation) / information).sqrt());
    }
    found.undetermined = doubt(&found, max_sigma_s);
    found
}

/// Why the best lag need not be the offset.
fn doubt(found: &CoarseTimeOffset, max_sigma_s: f64) -> Option<Undetermined> {
    let Some(best) = found.best else { return Some(Undetermined::TooFewIntervals) };
    let unexplained = |correlation: f64| 1.0 - correlation.clamp(0.0, 1.0).powi(2);
    let needed = MIN_UNEXPLAINED_RATIO * unexplained(best.correlation);
    let independent = (found.noise_correlation.powi(-2) - 3.0).max(0.0);
    let significance = best.correlation.clamp(0.0, 1.0).atanh() * independent.sqrt();
    // A NaN is that of a correlation of one without independent intervals.
    if significance.is_nan() || significance < MIN_SIGNIFICANCE || needed > 1.0 {
        return Some(Undetermined::NoCorrelation);
    }
    let Some(sigma_s) = found.sigma_s else { return Some(Undetermined::EndOfRange) };
    if found.second.is_some_and(|second| unexplained(second.correlation) < needed) {
        return Some(Undetermined::Ambiguous);
    }
    (sigma_s > max_sigma_s).then_some(Undetermined::WidePeak)
}

/// The highest correlation that is not on the slopes of the best one.
fn second_peak(correlations: &[f64], best: usize) -> Option<usize> {
    let before = beyond_valley(correlations, (0..best).rev());
    let after = beyond_valley(correlations, best + 1..correlations.len());
    before.into_iter().chain(after).max_by(|&a, &b| correlations[a].total_cmp(&correlations[b]))
}

fn beyond_valley(correlations: &[f64], indices: impl Iterator<Item = usize>) -> Option<usize> {
    let mut lowest = f64::INFINITY;
    let rest = indices.skip_while(|&index| {
        lowest = lowest.min(correlations[index]);
        correlations[index] < lowest + MIN_RISE
    });
    rest.max_by(|&a, &b| correlations[a].total_cmp(&correlations[b]))
}

/// A parabola about a maximum.
struct Parabola {
    /// Of the maximum from the middle, in steps.
    offset: f64,
    height: f64,
    /// How fast it falls: the negative second derivative, by step squared.
    curvature: f64,
}

impl Parabola {
    /// `None` where there is no maximum between the points beside the middle.
    fn about(values: &[f64], middle: usize) -> Option<Self> {
        let (before, after) =
            (*values.get(middle.checked_sub(PEAK_STEPS)?)?, *values.get(middle + PEAK_STEPS)?);
        let (height, width) = (values[middle], PEAK_STEPS as f64);
        let curvature = (2.0 * height - before - after) / (width * width);
        if before == UNCOVERED || after == UNCOVERED || curvature <= 0.0 {
            return None;
        }
        let slope = (after - before) / (2.0 * width);
        let offset = slope / curvature;
        Some(Self { offset, height: height + 0.5 * slope * offset, curvature })
    }
}
