//! Whether a calibration agrees with a recording: odometry runs with it, and again while estimating it.

mod gross_errors;
mod parameters;
mod time_offset;

pub use parameters::{Agreement, Parameter};
pub use time_offset::{CoarseTimeOffset, CorrelationPeak, Undetermined};

use anyhow::{Result, bail};
use estimator::{EstimatorConfig, LearnedNoise};
use mapping::{OdometryRun, run_configured};
use parameters::parameters_of;
use sensors::Sequence;
use serde::Serialize;
use time_offset::coarse_time_offset;

/// Standard deviations of a calibration that may be wrong (rad, m, s): larger than those of online calibration.
const SIGMA_ROTATION: f64 = 0.09;
const SIGMA_POSITION: f64 = 0.05;
const SIGMA_TIME_OFFSET: f64 = 0.03;
/// More noise of the IMU than stated by more than this is no usual sensor.
const MAX_IMU_NOISE_SCALE: f64 = 12.0;
/// Tracks that fit worse than this (px) fit no trajectory.
const MAX_SIGMA_TRACK_PX: f64 = 3.0;

/// How odometry fits a recording.
#[derive(Clone, Debug, Serialize)]
pub struct Fit {
    /// Images with a pose.
    pub states: usize,
    /// How often the filter diverged.
    pub divergences: usize,
    /// Noise levels that fit, where the filter was initialized.
    pub noise: Option<LearnedNoise>,
    /// Why it was never initialized, where it was not.
    pub uninitialized: Option<String>,
}

impl Fit {
    fn of(run: &OdometryRun) -> Fit {
        let noise = run.supervisor.learned_noise();
        Fit {
            states: run.states.len(),
            divergences: run.divergences,
            noise,
            uninitialized: noise.is_none().then(|| run.supervisor.status().reason),
        }
    }

    /// Why it fits no trajectory, in words.
    pub fn complaint(&self) -> Option<String> {
        let Some(noise) = self.noise else {
            let why = self.uninitialized.as_deref().unwrap_or_default();
            return Some(format!("odometry was never initialized: {why}"));
        };
        if self.divergences > 0 {
            return Some(format!("odometry diverged {} times", self.divergences));
        }
        if noise.imu_noise_scale > MAX_IMU_NOISE_SCALE {
            return Some(format!(
                "the IMU fits with {:.0} times the stated noise only: check its noise densities, its units and its axes",
                noise.imu_noise_scale
            ));
        }
        (noise.sigma_track_px > MAX_SIGMA_TRACK_PX).then(|| {
            format!(
                "pixels fit to {:.1} px only: check the intrinsics and the order of the cameras",
                noise.sigma_track_px
            )
        })
    }
}

/// The result of a check.
#[derive(Clone, Debug, Serialize)]
pub struct CalibrationCheck {
    /// Time that was played, seconds.
    pub seconds: f64,
    /// The time offset by the rotation rates of images and gyroscope.
    pub coarse_time_offset: CoarseTimeOffset,
    /// Odometry with the calibration as stated.
    pub stated: Fit,
    /// Odometry that estimates it, from the coarse time offset on where that is far from the stated one.
    pub estimated: Fit,
    /// A mistake without which odometry fits.
    pub mistake: Option<&'static str>,
    /// What was found; empty where odometry that estimates it has no pose at the end.
    pub parameters: Vec<Parameter>,
    /// Whether nothing differs, and odometry fits.
    pub agrees: bool,
    /// Whether anything can be said: odometry was initialized, or a mistake was found without which it is.
    pub checked: bool,
}

/// Checks the calibration of a recording.
///
/// # Arguments
/// * `sequence`: the part to look at. Tracks that are made of its images are put into its frames.
/// * `config`: of odometry with the stated calibration.
/// * `progress`: called with the number of frames done, of three times all of them.
///
/// # Errors
/// Odometry cannot run.
pub fn check_calibration(
    sequence: &mut Sequence,
    cameras: usize,
    config: &EstimatorConfig,
    mut progress: impl FnMut(usize, usize),
) -> Result<CalibrationCheck> {
    let seconds = match (sequence.frames.first(), sequence.frames.last()) {
        (Some(first), Some(last)) => (last.stamp_ns - first.stamp_ns) as f64 * 1e-9,
        _ => bail!("{} has no frames", sequence.root.display()),
    };
    let frames = sequence.frames.len();
    let all = 3 * frames;
    let has_tracks = sequence.contents().tracks;
    let coarse_time_offset =
        coarse_time_offset(sequence, config, SIGMA_TIME_OFFSET, |done| progress(done, all))?;
    let stated =
        run_configured(sequence, cameras, config, |done, _| progress(frames + done, all), |_, _| ())?;
    // A small one is within the prior of the estimate.
    let least_s = SIGMA_TIME_OFFSET + 3.0 * coarse_time_offset.sigma_s.unwrap_or(0.0);
    let far_s = coarse_time_offset.offset_s().filter(|offset_s| offset_s.abs() > least_s);
    if far_s.is_some() && !has_tracks {
        // The gyroscope predicted them, at the wrong times.
        sequence.frames.iter_mut().for_each(|frame| frame.tracks.clear());
    }
    let (stated, online, moved_s) = (Fit::of(&stated), online(config), far_s.unwrap_or(0.0));
    let fits = gross_errors::fits(&stated, sequence);
    let (estimated, mistake) = at_moved_times(sequence, moved_s, |sequence| {
        let estimated = run_configured(
            sequence,
            cameras,
            &online,
            |done, _| progress(2 * frames + done, all),
            |_, _| (),
        )?;
        let is_explained = fits || far_s.is_some() && gross_errors::fits(&Fit::of(&estimated), sequence);
        let mistake =
            if is_explained { None } else { gross_errors::find(sequence, cameras, config, has_tracks)? };
        anyhow::Ok((estimated, mistake))
    })?;
    let estimator = estimated.supervisor.estimator();
    let parameters =
        estimator.map_or_else(Vec::new, |estimator| parameters_of(estimator, sequence, config, moved_s));
    let estimated = Fit::of(&estimated);
    let differs = parameters.iter().any(|parameter| parameter.agreement == Agreement::Differs);
    let checked = stated.noise.is_some() || estimated.noise.is_some() || mistake.is_some();
    let agrees = fits && !differs && far_s.is_none();
    Ok(CalibrationCheck {
        seconds,
        coarse_time_offset,
        stated,
        estimated,
        mistake,
        parameters,
        agrees,
        checked,
    })
}

/// Settings that estimate the calibration.
fn online(config: &EstimatorConfig) -> EstimatorConfig {
    let mut online = config.clone();
    let calibration = &mut online.calibration;
    (calibration.extrinsics, calibration.intrinsics, calibration.time_offset) = (true, true, true);
    calibration.sigma_rotation_rad = SIGMA_ROTATION;
    calibration.sigma_position_m = SIGMA_POSITION;
    calibration.sigma_time_offset_s = SIGMA_TIME_OFFSET;
    online
}

/// What is found of a recording whose frames are later by a time (s); they have their own times again afterwards.
fn at_moved_times<T>(sequence: &mut Sequence, by_s: f64, find: impl FnOnce(&mut Sequence) -> T) -> T {
    let by_ns = (by_s * 1e9).round() as i64;
    sequence.frames.iter_mut().for_each(|frame| frame.stamp_ns += by_ns);
    let found = find(sequence);
    sequence.frames.iter_mut().for_each(|frame| frame.stamp_ns -= by_ns);
    found
}
