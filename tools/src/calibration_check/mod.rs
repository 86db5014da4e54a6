//! Whether a calibration agrees with a recording: odometry runs with it, and again while estimating it.

mod gross_errors;

use anyhow::{Result, bail};
use estimator::{Estimator, EstimatorConfig, LearnedNoise};
use mapping::{OdometryRun, run_configured};
use nalgebra::{DMatrix, DVector};
use sensors::Sequence;
use serde::Serialize;

/// Standard deviations of a calibration that may be wrong (rad, m, s): larger than those of online calibration.
const SIGMA_ROTATION: f64 = 0.09;
const SIGMA_POSITION: f64 = 0.05;
const SIGMA_TIME_OFFSET: f64 = 0.03;
/// A motion that leaves more than this part of the initial standard deviation does not show a parameter.
const SHOWN: f64 = 0.5;
/// Differences within this many standard deviations agree: recordings are less linear and less independent than filters take
/// them for.
const AGREEING_SIGMAS: f64 = 5.0;
/// Smaller differences do not matter, and good calibrations have them (s, rad, m, parts of the focal length, of the width).
const TIME_TOLERANCE: f64 = 2e-3;
const ROTATION_TOLERANCE: f64 = 0.01;
const POSITION_TOLERANCE: f64 = 0.02;
const FOCAL_TOLERANCE: f64 = 0.01;
const CENTRE_TOLERANCE: f64 = 0.01;
/// More noise of the IMU than stated by more than this is no usual sensor.
const MAX_IMU_NOISE_SCALE: f64 = 12.0;
/// Tracks that fit worse than this (px) fit no trajectory.
const MAX_SIGMA_TRACK_PX: f64 = 3.0;

/// What a recording says of a parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Agreement {
    /// The stated value is right, within what matters or what is known.
    Agrees,
    /// The stated value is wrong.
    Differs,
    /// The motion does not show it.
    NotShown,
}

/// A parameter, or three that belong together.
#[derive(Clone, Debug, Serialize)]
pub struct Parameter {
    /// What it is, with the camera.
    pub name: String,
    /// Its unit.
    pub unit: &'static str,
    /// Found minus stated.
    pub difference: Vec<f64>,
    /// Standard deviations of the difference.
    pub sigma: Vec<f64>,
    /// What the recording says.
    pub agreement: Agreement,
    /// What to do where it differs.
    #[serde(skip)]
    pub advice: String,
}

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
    /// Odometry with the calibration as stated.
    pub stated: Fit,
    /// Odometry that estimates it.
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
/// * `progress`: called with the number of frames done, twice.
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
    let stated = run_configured(sequence, cameras, config, |done, all| progress(done, 2 * all), |_, _| ())?;
    let mut online = config.clone();
    let calibration = &mut online.calibration;
    (calibration.extrinsics, calibration.intrinsics, calibration.time_offset) = (true, true, true);
    calibration.sigma_rotation_rad = SIGMA_ROTATION;
    calibration.sigma_position_m = SIGMA_POSITION;
    calibration.sigma_time_offset_s = SIGMA_TIME_OFFSET;
    let estimated =
        run_configured(sequence, cameras, &online, |done, all| progress(all + done, 2 * all), |_, _| ())?;
    let parameters = estimated.supervisor.estimator();
    let parameters = parameters.map_or_else(Vec::new, |estimator| parameters_of(estimator, sequence, config));
    let (stated, estimated) = (Fit::of(&stated), Fit::of(&estimated));
    let fits = gross_errors::fits(&stated, sequence);
    let mistake = if fits { None } else { gross_errors::find(sequence, cameras, config)? };
    let differs = parameters.iter().any(|parameter| parameter.agreement == Agreement::Differs);
    let checked = stated.noise.is_some() || estimated.noise.is_some() || mistake.is_some();
    let agrees = fits && !differs;
    Ok(CalibrationCheck { seconds, stated, estimated, mistake, parameters, agrees, checked })
}

/// Compares the estimated calibration with the stated one.
fn parameters_of(estimator: &Estimator, sequence: &Sequence, config: &EstimatorConfig) -> Vec<Parameter> {
    let found = estimator.calibration();
    let covariance = estimator.calibration_covariance();
    let initial = found.initial_covariance();
    let part = |begin: usize, difference: &[f64]| Part {
        difference: DVector::from_column_slice(difference),
        covariance: covariance.view((begin, begin), (difference.len(), difference.len())).into_owned(),
        initial: initial.view((begin, begin), (difference.len(), difference.len())).into_owned(),
    };
    let mut parameters = vec![part(0, &[found.time_offset - config.camera_time_offset_s]).parameter(
        "time offset",
        ("ms", 1e3, TIME_TOLERANCE),
        |difference| {
            format!(
                "add {:.1} ms to the offset that is added to the cameras' stamps (timeshift_cam_imu of Kalibr)",
                1e3 * difference[0]
            )
        },
    )];
    for (index, (calibrated, sensor)) in found.cameras.iter().zip(&sequence.cameras).enumerate() {
        let begin = found.camera_range(index).start;
        let turned = sensor.imu_from_camera.local(&calibrated.imu_from_camera);
        let (camera, stated) = (&calibrated.camera, &sensor.camera);
        let focal = [0, 1].map(|axis| camera.focal[axis] - stated.focal[axis]);
        let centre = [0, 1].map(|axis| camera.centre[axis] - stated.centre[axis]);
        let of_camera = |what: &str| format!("cam{index} {what}");
        let again = |_: &DVector<f64>| "calibrate again".to_owned();
        parameters.extend([
            part(begin, turned.fixed_rows::<3>(0).as_slice()).parameter(
                &of_camera("rotation in the IMU's frame"),
                ("deg", 1.0_f64.to_degrees(), ROTATION_TOLERANCE),
                |_| {
                    "check the direction of the extrinsics (T_BS is imu_from_camera), or calibrate again"
                        .to_owned()
                },
            ),
            part(begin + 3, turned.fixed_rows::<3>(3).as_slice()).parameter(
                &of_camera("position in the IMU's frame"),
                ("mm", 1e3, POSITION_TOLERANCE),
                |_| "measure it, or calibrate again".to_owned(),
            ),
            part(begin + 6, &focal).parameter(
                &of_camera("focal length"),
                ("px", 1.0, FOCAL_TOLERANCE * stated.focal[0]),
                again,
            ),
            part(begin + 8, &centre).parameter(
                &of_camera("principal point"),
                ("px", 1.0, CENTRE_TOLERANCE * f64::from(stated.width)),
                again,
            ),
        ]);
    }
    parameters
}

/// Errors of a parameter.
struct Part {
    difference: DVector<f64>,
    covariance: DMatrix<f64>,
    initial: DMatrix<f64>,
}

impl Part {
    /// # Arguments
    /// * `unit`: its name, its number in one of the estimator's, and the difference that matters, in the estimator's.
    fn parameter(
        &self,
        name: &str,
        (unit, factor, tolerance): (&'static str, f64, f64),
        advice: impl Fn(&DVector<f64>) -> String,
    ) -> Parameter {
        let sigmas =
            |covariance: &DMatrix<f64>| covariance.diagonal().map(|variance| variance.max(0.0).sqrt());
        let sigma = sigmas(&self.covariance);
        let is_large = self.difference.norm() > tolerance;
        let solved = self.covariance.clone().cholesky().map(|factor| factor.solve(&self.difference));
        let squared = solved.map_or(0.0, |solved| solved.dot(&self.difference));
        let limit = AGREEING_SIGMAS * (self.difference.len() as f64).sqrt();
        let agreement = if is_large && squared.sqrt() > limit {
            Agreement::Differs
        } else if sigma.norm() > SHOWN * sigmas(&self.initial).norm() {
            Agreement::NotShown
        } else {
            Agreement::Agrees
        };
        Parameter {
            name: name.to_owned(),
            unit,
            difference: self.difference.iter().map(|value| value * factor).collect(),
            sigma: sigma.iter().map(|value| value * factor).collect(),
            agreement,
            advice: advice(&self.difference),
        }
    }
}
