//! The initial state, from ground truth or from an IMU at rest (static initialization).

use crate::config::{EstimatorConfig, InitialSigmas};
use crate::propagation::{ACCELEROMETER_BIAS, GYROSCOPE_BIAS, ImuMatrix, ImuState, VELOCITY};
use geometry::{Pose, Rotation, rotation};
use nalgebra::{Matrix3, SMatrix, UnitVector3, Vector3};
use types::ImuSample;

/// Initial IMU state with its covariance.
#[derive(Clone, Debug, PartialEq)]
pub struct InitialState {
    /// Time, nanoseconds.
    pub stamp_ns: i64,
    /// Initial estimate.
    pub imu: ImuState,
    /// Covariance of its error `[δθ, δp, δv, δb_g, δb_a]`.
    pub covariance: ImuMatrix,
}

/// Why the static initialization failed.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum StaticInitError {
    /// Not enough samples yet.
    #[error("{have:.2} s of IMU samples, {need:.2} s at rest are needed")]
    TooShort {
        /// Duration of the samples, seconds.
        have: f64,
        /// Duration needed, seconds.
        need: f64,
    },
    /// The IMU moves.
    #[error(
        "the IMU moves (standard deviations: accelerometer {accelerometer:.2} m/s^2, gyroscope {gyroscope:.3} rad/s): \
         keep it still"
    )]
    Moving {
        /// Standard deviation of the specific force, m/s^2.
        accelerometer: f64,
        /// Standard deviation of the angular velocity, rad/s.
        gyroscope: f64,
    },
    /// The features of the images move.
    #[error(
        "the IMU is at rest or in uniform motion, and the features of the images move: it is in uniform motion"
    )]
    UniformMotion,
    /// Too few features are tracked after the filter was lost.
    #[error(
        "the IMU is at rest or in uniform motion, and too few features are tracked to tell which after the pose was lost: uncover the cameras"
    )]
    RestUnseen,
    /// The specific force does not have the magnitude of gravity.
    #[error(
        "at rest the accelerometer reads {norm:.2} m/s^2, gravity is {gravity:.2}: check units and calibration"
    )]
    NotGravity {
        /// Magnitude of the mean specific force, m/s^2.
        norm: f64,
        /// The configured gravity, m/s^2.
        gravity: f64,
    },
}

/// Duration of the samples of a static initialization, seconds.
pub const REST_SECONDS: f64 = 0.5;
/// Standard deviation of the specific force above which the IMU moves, m/s^2. The IMUs of EuRoC and of a tablet have 0.02
/// to 0.1 at rest; a hand-held one 0.3 and more.
const MAX_ACCELEROMETER_SIGMA: f64 = 0.25;
/// Standard deviation of the angular velocity above which it moves, rad/s.
const MAX_GYROSCOPE_SIGMA: f64 = 0.03;
/// Maximum difference between the specific force at rest and gravity, m/s^2.
const GRAVITY_TOLERANCE: f64 = 0.6;
/// Standard deviation of roll and pitch before the specific force is known, rad.
const UNKNOWN_TILT_SIGMA_RAD: f64 = 1.0;
/// Lower bound of the standard deviation of the mean specific force at rest, m/s^2 on each axis: vibration, scale-factor
/// errors of the accelerometer, and motion so slow that half a second of images does not show it.
const MIN_FORCE_SIGMA_M_S2: f64 = 0.1;
/// Standard deviation of the velocity at rest, m/s.
const REST_VELOCITY_SIGMA_M_S: f64 = 0.05;
/// Lower bound of the standard deviation of the gyroscope bias, rad/s.
const MIN_GYROSCOPE_BIAS_SIGMA_RAD_S: f64 = 2e-3;

impl InitialState {
    /// From ground truth: L has its origin at the IMU, z up and no yaw.
    ///
    /// # Arguments
    /// * `stamp_ns`: by the IMU's clock, nanoseconds.
    /// * `world_from_imu`: true pose, in any frame with known gravity.
    /// * `velocity_in_world`: m/s.
    /// * `gravity_in_world`: unit vector along gravity.
    pub fn from_truth(
        stamp_ns: i64,
        world_from_imu: &Pose,
        velocity_in_world: &Vector3<f64>,
        gravity_in_world: &Vector3<f64>,
        sigmas: InitialSigmas,
    ) -> Self {
        let imu_from_world = world_from_imu.rotation.inverse();
        let local_from_imu = gravity_aligned(&(imu_from_world * -gravity_in_world));
        Self {
            stamp_ns,
            imu: ImuState {
                local_from_imu: Pose::new(local_from_imu, Vector3::zeros()),
                velocity: local_from_imu * (imu_from_world * velocity_in_world),
                gyroscope_bias: Vector3::zeros(),
                accelerometer_bias: Vector3::zeros(),
            },
            covariance: sigmas.covariance(),
        }
    }

    /// From IMU samples at rest: roll and pitch from gravity, gyroscope bias from the mean angular velocity.
    ///
    /// # Arguments
    /// * `samples`: about [`REST_SECONDS`] of them, oldest first.
    ///
    /// # Returns
    /// The state at the last sample, with its origin at the IMU, z up and no yaw.
    ///
    /// # Errors
    /// [`StaticInitError`]: too few samples, motion, or a wrong gravity.
    ///
    /// ```
    /// use estimator::{EstimatorConfig, ImuSample, InitialState};
    /// use nalgebra::Vector3;
    ///
    /// let samples: Vec<ImuSample> = (0..=100)
    ///     .map(|k| ImuSample {
    ///         stamp_ns: k * 5_000_000,
    ///         gyroscope: Vector3::new(0.01, 0.0, 0.0),
    ///         accelerometer: Vector3::new(0.0, 9.81, 0.0), // y is up
    ///     })
    ///     .collect();
    /// let initial = InitialState::from_rest(&samples, &EstimatorConfig::default())?;
    /// assert!((initial.imu.gyroscope_bias.x - 0.01).abs() < 1e-9);
    /// assert!((initial.imu.local_from_imu.rotation * Vector3::y() - Vector3::z()).norm() < 1e-9);
    /// # Ok::<(), estimator::initialization::static_init::StaticInitError>(())
    /// ```
    pub fn from_rest(samples: &[ImuSample], config: &EstimatorConfig) -> Result<Self, StaticInitError> {
        let (Some(first), Some(last)) = (samples.first(), samples.last()) else {
            return Err(StaticInitError::TooShort { have: 0.0, need: REST_SECONDS });
        };
        let have = (last.stamp_ns - first.stamp_ns) as f64 * 1e-9;
        if have < REST_SECONDS * 0.9 {
            return Err(StaticInitError::TooShort { have, need: REST_SECONDS });
        }
        let (force, force_sigma) = statistics(samples, |sample| sample.accelerometer);
        let (rate, rate_sigma) = statistics(samples, |sample| sample.gyroscope);
        if force_sigma > MAX_ACCELEROMETER_SIGMA || rate_sigma > MAX_GYROSCOPE_SIGMA {
            return Err(StaticInitError::Moving { accelerometer: force_sigma, gyroscope: rate_sigma });
        }
        if (force.norm() - config.gravity).abs() > GRAVITY_TOLERANCE {
            return Err(StaticInitError::NotGravity { norm: force.norm(), gravity: config.gravity });
        }
        let sigmas = InitialSigmas {
            sigma_tilt_rad: UNKNOWN_TILT_SIGMA_RAD,
            sigma_velocity_m_s: REST_VELOCITY_SIGMA_M_S,
            // Small oscillations do not average out over half a second.
            sigma_gyroscope_bias_rad_s: (0.5 * rate_sigma).max(MIN_GYROSCOPE_BIAS_SIGMA_RAD_S),
            ..config.initial
        };
        let local_from_imu = gravity_aligned(&force);
        let force_sigma = (0.5 * force_sigma).max(MIN_FORCE_SIGMA_M_S2);
        Ok(Self {
            stamp_ns: last.stamp_ns,
            imu: ImuState {
                local_from_imu: Pose::new(local_from_imu, Vector3::zeros()),
                velocity: Vector3::zeros(),
                gyroscope_bias: rate,
                // Only the component of the bias along gravity is observable at rest.
                accelerometer_bias: force.normalize() * (force.norm() - config.gravity),
            },
            covariance: at_rest(&sigmas.covariance(), &local_from_imu, config.gravity, force_sigma),
        })
    }

    /// The same state in another local frame.
    ///
    /// # Arguments
    /// * `new_from_old`: a translation and a rotation about z.
    pub fn transformed(&self, new_from_old: &Pose) -> Self {
        let blocks = imu_rotation_adjoint(&new_from_old.rotation);
        Self {
            stamp_ns: self.stamp_ns,
            imu: ImuState {
                local_from_imu: *new_from_old * self.imu.local_from_imu,
                velocity: new_from_old.rotation * self.imu.velocity,
                ..self.imu
            },
            covariance: blocks * self.covariance * blocks.transpose(),
        }
    }
}

impl InitialSigmas {
    /// The diagonal 15x15 covariance of the IMU error `[δθ, δp, δv, δb_g, δb_a]`.
    pub fn covariance(&self) -> ImuMatrix {
        let mut covariance = ImuMatrix::zeros();
        let mut put = |begin: usize, sigmas: [f64; 3]| {
            for (k, sigma) in sigmas.iter().enumerate() {
                covariance[(begin + k, begin + k)] = sigma * sigma;
            }
        };
        put(0, [self.sigma_tilt_rad, self.sigma_tilt_rad, self.sigma_yaw_rad]);
        put(3, [self.sigma_position_m; 3]);
        put(VELOCITY, [self.sigma_velocity_m_s; 3]);
        put(GYROSCOPE_BIAS, [self.sigma_gyroscope_bias_rad_s; 3]);
        put(ACCELEROMETER_BIAS, [self.sigma_accelerometer_bias_m_s2; 3]);
        covariance
    }
}

/// The covariance of an IMU error that was `covariance` before the body was found not to accelerate.
///
/// The acceleration is `R (f - b_a) + g`, its error `-[z g]x δθ - R δb_a`. It does not distinguish tilt and accelerometer
/// bias: the sigma of the tilt follows from that of the bias, and both errors cancel each other in the acceleration.
///
/// # Arguments
/// * `local_from_imu`: rotation at rest.
/// * `gravity`: m/s^2.
/// * `sigma`: standard deviation of the acceleration on each axis, m/s^2.
fn at_rest(covariance: &ImuMatrix, local_from_imu: &Rotation, gravity: f64, sigma: f64) -> ImuMatrix {
    let mut jacobian = SMatrix::<f64, 3, 15>::zeros();
    jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&-rotation::skew(&Vector3::new(0.0, 0.0, gravity)));
    jacobian
        .fixed_view_mut::<3, 3>(0, ACCELEROMETER_BIAS)
        .copy_from(&-local_from_imu.to_rotation_matrix().into_inner());
    let cross = covariance * jacobian.transpose();
    let innovation = jacobian * cross + Matrix3::identity() * (sigma * sigma);
    // The innovation has the variance of the noise at least.
    let Some(inverse) = innovation.try_inverse() else { return *covariance };
    let updated = covariance - cross * inverse * cross.transpose();
    0.5 * (updated + updated.transpose())
}

/// `diag(R, R, R, I, I)`: maps an IMU error to rotated axes of the local frame.
fn imu_rotation_adjoint(rotation: &Rotation) -> ImuMatrix {
    let rotation = rotation.to_rotation_matrix().into_inner();
    let mut blocks = ImuMatrix::identity();
    for begin in [0, 3, VELOCITY] {
        blocks.fixed_view_mut::<3, 3>(begin, begin).copy_from(&rotation);
    }
    blocks
}

/// The rotation about z that gives `from` the yaw of `to`.
pub(crate) fn yaw_between(from: &Rotation, to: &Rotation) -> Rotation {
    let difference = to * from.inverse();
    // The rotation about z of a quaternion is given by its components k and w.
    let yaw = 2.0 * difference.k.atan2(difference.w);
    rotation::exp(&Vector3::new(0.0, 0.0, yaw))
}

/// The smallest rotation from the direction `up` of the body to z: no rotation about gravity.
pub(crate) fn gravity_aligned(up: &Vector3<f64>) -> Rotation {
    let up = UnitVector3::new_normalize(*up);
    // If `up` is -z, any horizontal axis will do.
    Rotation::rotation_between_axis(&up, &Vector3::z_axis())
        .unwrap_or_else(|| Rotation::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI))
}

/// Mean, and standard deviation of the distance from it.
fn statistics(samples: &[ImuSample], value: impl Fn(&ImuSample) -> Vector3<f64>) -> (Vector3<f64>, f64) {
    let count = samples.len().max(1) as f64;
    let mean = samples.iter().map(&value).sum::<Vector3<f64>>() / count;
    let variance = samples.iter().map(|sample| (value(sample) - mean).norm_squared()).sum::<f64>() / count;
    (mean, variance.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix2;
    use rand::{RngExt as _, SeedableRng as _, rngs::StdRng};
    use rand_distr::StandardNormal;

    #[test]
    fn at_rest_tilt_and_gyroscope_bias_are_found() {
        let config = EstimatorConfig::default();
        let tilted = rotation::exp(&Vector3::new(0.4, -1.2, 0.7));
        let bias = Vector3::new(0.01, 0.08, -0.03);
        let samples: Vec<ImuSample> = (0..200)
            .map(|k| ImuSample {
                stamp_ns: k * 5_000_000,
                gyroscope: bias + Vector3::repeat(0.002 * (k as f64).sin()),
                accelerometer: tilted.inverse() * Vector3::new(0.0, 0.0, 9.81),
            })
            .collect();
        let start = InitialState::from_rest(&samples, &config).unwrap();
        let up = start.imu.local_from_imu.rotation * (tilted.inverse() * Vector3::z());
        assert!((up - Vector3::z()).norm() < 1e-9);
        assert!((start.imu.gyroscope_bias - bias).norm() < 1e-3);

        let shaken: Vec<ImuSample> = samples
            .iter()
            .map(|sample| ImuSample {
                accelerometer: sample.accelerometer + Vector3::repeat((sample.stamp_ns as f64 * 1e-8).sin()),
                ..*sample
            })
            .collect();
        assert!(matches!(InitialState::from_rest(&shaken, &config), Err(StaticInitError::Moving { .. })));
        assert!(InitialState::from_rest(&samples[..20], &config).is_err());
    }

    #[test]
    fn at_rest_tilt_and_accelerometer_bias_cancel_each_other_in_the_acceleration() {
        let config = EstimatorConfig::default();
        let tilted = rotation::exp(&Vector3::new(0.4, -1.2, 0.7));
        let force = tilted.inverse() * Vector3::new(0.0, 0.0, config.gravity);
        let at =
            |k: i64| ImuSample { stamp_ns: k * 5_000_000, gyroscope: Vector3::zeros(), accelerometer: force };
        let samples: Vec<ImuSample> = (0..=100).map(at).collect();
        let start = InitialState::from_rest(&samples, &config).unwrap();
        for axis in [Vector3::x(), Vector3::y()] {
            let mut known = nalgebra::SVector::<f64, 15>::zeros();
            // An error of the tilt that a bias explains leaves the acceleration as it is.
            let tilt = 0.01 * axis;
            let bias = start.imu.local_from_imu.rotation.inverse()
                * (-rotation::skew(&Vector3::new(0.0, 0.0, config.gravity)) * tilt);
            known.fixed_rows_mut::<3>(0).copy_from(&tilt);
            known.fixed_rows_mut::<3>(ACCELEROMETER_BIAS).copy_from(&bias);
            let state = start.imu.retract(&known);
            let acceleration = state.local_from_imu.rotation * (force - state.accelerometer_bias)
                - Vector3::new(0.0, 0.0, config.gravity);
            assert!(acceleration.norm() < 1e-3, "second order only: {acceleration}");
            let information = start.covariance.try_inverse().unwrap();
            let deviations = (known.transpose() * information * known)[0].sqrt();
            let of_bias = 0.01 * config.gravity / config.initial.sigma_accelerometer_bias_m_s2;
            assert!((deviations / of_bias - 1.0).abs() < 0.01, "{deviations} instead of {of_bias}");

            known.fixed_rows_mut::<3>(ACCELEROMETER_BIAS).copy_from(&-bias);
            let deviations = (known.transpose() * information * known)[0].sqrt();
            let expected = 0.02 * config.gravity / MIN_FORCE_SIGMA_M_S2;
            assert!(deviations > 0.99 * expected, "{deviations}, {expected}: they do not cancel");
        }
    }

    #[test]
    fn the_tilt_found_at_rest_is_consistent_with_an_unknown_bias() {
        let config = EstimatorConfig::default();
        let mut rng = StdRng::seed_from_u64(5);
        let mut normal = |sigma: f64| Vector3::from_fn(|_, _| sigma * rng.sample::<f64, _>(StandardNormal));
        let (mut runs, mut nees) = (0, [0.0; 2]);
        while runs < 500 {
            let bias = normal(config.initial.sigma_accelerometer_bias_m_s2);
            let truth = rotation::exp(&normal(0.7));
            let force = truth.inverse() * Vector3::new(0.0, 0.0, config.gravity) + bias;
            let samples: Vec<ImuSample> = (0..=100)
                .map(|k| ImuSample {
                    stamp_ns: k * 5_000_000,
                    gyroscope: normal(1e-3),
                    accelerometer: force + normal(0.03),
                })
                .collect();
            // A bias of three deviations along gravity is refused as a wrong unit.
            let Ok(start) = InitialState::from_rest(&samples, &config) else { continue };
            runs += 1;
            let found = start.imu.local_from_imu.rotation;
            let truth = yaw_between(&truth, &found) * truth;
            let tilt = rotation::log(&(truth * found.inverse())).xy();
            let tilt_covariance: Matrix2<f64> = start.covariance.fixed_view::<2, 2>(0, 0).into();
            nees[0] += tilt.dot(&(tilt_covariance.try_inverse().unwrap() * tilt)) / 2.0;
            let of_bias: Matrix3<f64> =
                start.covariance.fixed_view::<3, 3>(ACCELEROMETER_BIAS, ACCELEROMETER_BIAS).into();
            let error = bias - start.imu.accelerometer_bias;
            nees[1] += error.dot(&(of_bias.try_inverse().unwrap() * error)) / 3.0;
        }
        let [tilt, bias] = nees.map(|sum| sum / f64::from(runs));
        // Noise is less than what is stated of vibration: 0.8 is expected of the tilt, with a deviation of 0.04.
        assert!((tilt - 0.8).abs() < 0.15, "tilt: {tilt}");
        // Along gravity the bias is known better than is stated.
        assert!((bias - 0.67).abs() < 0.12, "bias: {bias}");
    }

    #[test]
    fn ground_truth_in_any_frame_gives_a_local_frame_with_z_up_and_no_yaw() {
        let gravity = -Vector3::x();
        let pose = Pose::new(rotation::exp(&Vector3::new(1.0, 0.2, -0.4)), Vector3::new(5.0, 6.0, 7.0));
        let start = InitialState::from_truth(7, &pose, &Vector3::x(), &gravity, InitialSigmas::default());
        let in_body = pose.rotation.inverse() * gravity;
        assert!((start.imu.local_from_imu.rotation * in_body + Vector3::z()).norm() < 1e-12);
        assert!((start.imu.velocity - Vector3::z()).norm() < 1e-12);
        // The rotation axis is horizontal: no rotation about gravity.
        assert!(rotation::log(&start.imu.local_from_imu.rotation).z.abs() < 1e-12);
    }
}
