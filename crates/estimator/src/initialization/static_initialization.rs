//! The state that the filter starts from: from truth, or from an IMU at rest.

use crate::config::{EstimatorConfig, InitialSigmas};
use crate::imu::ImuSample;
use crate::propagation::{ACCELEROMETER_BIAS, GYROSCOPE_BIAS, ImuMatrix, ImuState, VELOCITY};
use geometry::{Pose, Rotation};
use nalgebra::{UnitVector3, Vector3};

/// Mean and covariance of the IMU state at the start.
#[derive(Clone, Debug, PartialEq)]
pub struct InitialState {
    /// Time, nanoseconds.
    pub stamp_ns: i64,
    /// The state.
    pub imu: ImuState,
    /// Covariance of its error `[δθ, δp, δv, δb_g, δb_a]`.
    pub covariance: ImuMatrix,
}

/// Why no state could be found.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum InitializationError {
    /// Not enough readings yet.
    #[error("{have:.2} s of IMU readings, {need:.2} s at rest are needed")]
    TooShort {
        /// Seconds at hand.
        have: f64,
        /// Seconds needed.
        need: f64,
    },
    /// The IMU moves.
    #[error(
        "the IMU moves (accelerometer {accelerometer:.2} m/s^2, gyroscope {gyroscope:.3} rad/s of standard \
         deviation): keep it still"
    )]
    Moving {
        /// Standard deviation of the specific force, m/s^2.
        accelerometer: f64,
        /// Standard deviation of the angular velocity, rad/s.
        gyroscope: f64,
    },
    /// The images move.
    #[error("the IMU reads as if at rest, but the images move: it glides or turns evenly")]
    Gliding,
    /// The specific force is not gravity.
    #[error(
        "at rest the accelerometer reads {norm:.2} m/s^2, gravity is {gravity:.2}: check units and calibration"
    )]
    NotGravity {
        /// Mean specific force, m/s^2.
        norm: f64,
        /// The configured gravity.
        gravity: f64,
    },
}

/// Length of the window that must be at rest, seconds.
pub const REST_SECONDS: f64 = 0.5;
/// Standard deviation of the specific force above which the IMU moves, m/s^2. EuRoC's and a tablet's
/// IMU at rest show 0.02 to 0.1; a hand-held one 0.3 and more.
const REST_ACCELEROMETER: f64 = 0.25;
/// Standard deviation of the angular velocity above which it moves, rad/s.
const REST_GYROSCOPE: f64 = 0.03;
/// How far the specific force at rest may be from gravity, m/s^2.
const GRAVITY_TOLERANCE: f64 = 0.6;

impl InitialState {
    /// From a pose in a frame of known gravity: L gets its origin at the body, z up and no yaw.
    ///
    /// # Arguments
    /// * `world_from_imu`: true pose.
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
        let local_from_imu = upright(&(imu_from_world * -gravity_in_world));
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

    /// From readings at rest: gravity gives roll and pitch, the gyroscope its bias.
    ///
    /// # Errors
    /// [`InitializationError`] says what is missing.
    pub fn from_rest(samples: &[ImuSample], config: &EstimatorConfig) -> Result<Self, InitializationError> {
        let (Some(first), Some(last)) = (samples.first(), samples.last()) else {
            return Err(InitializationError::TooShort { have: 0.0, need: REST_SECONDS });
        };
        let have = (last.stamp_ns - first.stamp_ns) as f64 * 1e-9;
        if have < REST_SECONDS * 0.9 {
            return Err(InitializationError::TooShort { have, need: REST_SECONDS });
        }
        let (force, force_deviation) = statistics(samples, |sample| sample.accelerometer);
        let (rate, rate_deviation) = statistics(samples, |sample| sample.gyroscope);
        if force_deviation > REST_ACCELEROMETER || rate_deviation > REST_GYROSCOPE {
            return Err(InitializationError::Moving {
                accelerometer: force_deviation,
                gyroscope: rate_deviation,
            });
        }
        if (force.norm() - config.gravity).abs() > GRAVITY_TOLERANCE {
            return Err(InitializationError::NotGravity { norm: force.norm(), gravity: config.gravity });
        }
        // A tilt and an accelerometer bias cannot be told apart at rest: the tilt is as uncertain as
        // the bias makes it.
        let tilt = (config.initial.accelerometer_bias / config.gravity).max(0.005);
        let sigmas = InitialSigmas {
            tilt,
            velocity: 0.05,
            // A body that rocks a little has no mean rate of zero over half a second.
            gyroscope_bias: (0.5 * rate_deviation).max(2e-3),
            ..config.initial
        };
        Ok(Self {
            stamp_ns: last.stamp_ns,
            imu: ImuState {
                local_from_imu: Pose::new(upright(&force), Vector3::zeros()),
                velocity: Vector3::zeros(),
                gyroscope_bias: rate,
                // Of the bias, only the part along gravity shows at rest.
                accelerometer_bias: force.normalize() * (force.norm() - config.gravity),
            },
            covariance: sigmas.covariance(),
        })
    }

    /// The same state in axes that are turned about gravity, or moved.
    ///
    /// # Arguments
    /// * `new_from_old`: its rotation is one about z.
    pub fn seen_from(&self, new_from_old: &Pose) -> Self {
        let blocks = turned_imu(&new_from_old.rotation);
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
    /// The covariance of an IMU error whose parts are independent.
    pub fn covariance(&self) -> ImuMatrix {
        let mut covariance = ImuMatrix::zeros();
        let mut put = |begin: usize, sigmas: [f64; 3]| {
            for (k, sigma) in sigmas.iter().enumerate() {
                covariance[(begin + k, begin + k)] = sigma * sigma;
            }
        };
        put(0, [self.tilt, self.tilt, self.yaw]);
        put(3, [self.position; 3]);
        put(VELOCITY, [self.velocity; 3]);
        put(GYROSCOPE_BIAS, [self.gyroscope_bias; 3]);
        put(ACCELEROMETER_BIAS, [self.accelerometer_bias; 3]);
        covariance
    }
}

/// `diag(R, R, R, I, I)`: an IMU error told in axes that are turned.
fn turned_imu(turn: &Rotation) -> ImuMatrix {
    let rotation = turn.to_rotation_matrix().into_inner();
    let mut blocks = ImuMatrix::identity();
    for begin in [0, 3, VELOCITY] {
        blocks.fixed_view_mut::<3, 3>(begin, begin).copy_from(&rotation);
    }
    blocks
}

/// The smallest rotation that carries the direction `up` of the body to z: no rotation about gravity.
pub(crate) fn upright(up: &Vector3<f64>) -> Rotation {
    let up = UnitVector3::new_normalize(*up);
    // Upside down every horizontal axis is as good as any other.
    Rotation::rotation_between_axis(&up, &Vector3::z_axis())
        .unwrap_or_else(|| Rotation::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI))
}

fn statistics(samples: &[ImuSample], value: impl Fn(&ImuSample) -> Vector3<f64>) -> (Vector3<f64>, f64) {
    let count = samples.len().max(1) as f64;
    let mean = samples.iter().map(&value).sum::<Vector3<f64>>() / count;
    let variance = samples.iter().map(|sample| (value(sample) - mean).norm_squared()).sum::<f64>() / count;
    (mean, variance.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::rotation;

    #[test]
    fn a_body_at_rest_finds_up_and_its_gyroscope_bias() {
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
        assert!(matches!(InitialState::from_rest(&shaken, &config), Err(InitializationError::Moving { .. })));
        assert!(InitialState::from_rest(&samples[..20], &config).is_err());
    }

    #[test]
    fn truth_in_any_frame_gives_a_local_frame_with_z_up_and_no_yaw() {
        let gravity = -Vector3::x();
        let pose = Pose::new(rotation::exp(&Vector3::new(1.0, 0.2, -0.4)), Vector3::new(5.0, 6.0, 7.0));
        let start = InitialState::from_truth(7, &pose, &Vector3::x(), &gravity, InitialSigmas::default());
        let in_body = pose.rotation.inverse() * gravity;
        assert!((start.imu.local_from_imu.rotation * in_body + Vector3::z()).norm() < 1e-12);
        assert!((start.imu.velocity - Vector3::z()).norm() < 1e-12);
        // The axis of the rotation is horizontal: nothing turns about gravity.
        assert!(rotation::log(&start.imu.local_from_imu.rotation).z.abs() < 1e-12);
    }
}
