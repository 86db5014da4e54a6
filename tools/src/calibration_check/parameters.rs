//! What an estimated calibration says of the stated one, parameter by parameter.

use estimator::{Estimator, EstimatorConfig};
use nalgebra::{DMatrix, DVector};
use sensors::Sequence;
use serde::Serialize;

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

/// Compares the estimated calibration with the stated one.
///
/// # Arguments
/// * `moved_s`: by which the images were later for the estimator.
pub(super) fn parameters_of(
    estimator: &Estimator,
    sequence: &Sequence,
    config: &EstimatorConfig,
    moved_s: f64,
) -> Vec<Parameter> {
    let found = estimator.calibration();
    let covariance = estimator.calibration_covariance();
    let initial = found.initial_covariance();
    let part = |begin: usize, difference: &[f64]| Part {
        difference: DVector::from_column_slice(difference),
        covariance: covariance.view((begin, begin), (difference.len(), difference.len())).into_owned(),
        initial: initial.view((begin, begin), (difference.len(), difference.len())).into_owned(),
    };
    let mut parameters = vec![part(0, &[moved_s + found.time_offset - config.camera_time_offset_s]).parameter(
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
