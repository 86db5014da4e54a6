//! The initial state of a run: the truth minus a sample of the covariance that the filter starts from.
//!
//! L is known from the truth alone: its origin is the true first position, z is up, and its yaw is that of the true first
//! attitude. So the errors of the very first estimate are a sample of its covariance in all 15 numbers, yaw and position
//! included, and the NEES has its expectation from the first image on.

use crate::random::{Purpose, normal, stream};
use crate::spline::Motion;
use estimator::propagation::{ACCELEROMETER_BIAS, GYROSCOPE_BIAS, IMU_DIM, VELOCITY};
use estimator::{InitialSigmas, InitialState};
use geometry::Pose;
use nalgebra::{SVector, Vector3, Vector6};

/// The start of a run.
pub(crate) struct Start {
    /// The initial state that the filter is given.
    pub(crate) initial: InitialState,
    /// The true pose of L in G.
    pub(crate) global_from_local: Pose,
}

/// Samples the initial state.
///
/// The sample is the same for every variant of a seed, in units of the variant's standard deviations.
///
/// # Arguments
/// * `motion`: the truth at `stamp_ns`, of the IMU in the simulated world.
/// * `biases`: true biases of gyroscope (rad/s) and accelerometer (m/s^2) then.
/// * `global_from_world`: the world's frame in G.
pub(crate) fn draw(
    seed: u64,
    stamp_ns: i64,
    motion: &Motion,
    biases: (Vector3<f64>, Vector3<f64>),
    sigmas: &InitialSigmas,
    global_from_world: &Pose,
) -> Start {
    let mut initial =
        InitialState::from_truth(stamp_ns, &motion.pose, &motion.velocity, &-Vector3::z(), *sigmas);
    let true_local_from_imu = initial.imu.local_from_imu;
    let world_from_local = motion.pose * true_local_from_imu.inverse();

    let error = sample(seed, sigmas);
    let pose_error: Vector6<f64> = error.fixed_rows::<6>(0).into();
    initial.imu.local_from_imu = true_local_from_imu.retract(&-pose_error);
    initial.imu.velocity -= error.fixed_rows::<3>(VELOCITY);
    initial.imu.gyroscope_bias = biases.0 - error.fixed_rows::<3>(GYROSCOPE_BIAS);
    initial.imu.accelerometer_bias = biases.1 - error.fixed_rows::<3>(ACCELEROMETER_BIAS);
    Start { initial, global_from_local: *global_from_world * world_from_local }
}

/// A sample of the error `[dtheta, dp, dv, db_g, db_a]`.
fn sample(seed: u64, sigmas: &InitialSigmas) -> SVector<f64, IMU_DIM> {
    let mut rng = stream(seed, 1, Purpose::Start);
    let of_block = |k: usize| match k {
        0 | 1 => sigmas.sigma_tilt_rad,
        2 => sigmas.sigma_yaw_rad,
        3..VELOCITY => sigmas.sigma_position_m,
        VELOCITY..GYROSCOPE_BIAS => sigmas.sigma_velocity_m_s,
        GYROSCOPE_BIAS..ACCELEROMETER_BIAS => sigmas.sigma_gyroscope_bias_rad_s,
        _ => sigmas.sigma_accelerometer_bias_m_s2,
    };
    SVector::from_fn(|k, _| of_block(k) * normal(&mut rng))
}
