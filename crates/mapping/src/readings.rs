//! The readings of a recording's IMU, and what they say of consecutive views.

use adjustment::ViewMotion;
use estimator::EstimatorConfig;
use estimator::imu::ImuBuffer;
use estimator::inertial_chain::InertialChain;
use estimator::preintegration::PreintegratedImu;
use geometry::pose::Pose;
use sensors::ImuSample;

/// How far the first and the last reading of an interval may be extrapolated (ns): a few periods of any IMU.
pub(super) const IMU_SLACK_NS: i64 = 20_000_000;

/// All readings of a recording. Those that are not finite or not newer than the one before are left out.
pub(super) fn buffered(readings: &[ImuSample]) -> ImuBuffer {
    let mut buffer = ImuBuffer::default();
    for reading in readings {
        // The odometry has counted and named them.
        let _ = buffer.push(*reading);
    }
    buffer
}

/// Preintegrates the readings between views. Intervals that the readings do not cover are left out.
///
/// # Arguments
/// * `stamps_ns`: of the views, on the clock of the IMU.
/// * `motions`: of the views; the readings are integrated with their biases, those of the first view are the prior.
pub(super) fn inertial_chain(
    readings: &ImuBuffer,
    stamps_ns: &[i64],
    motions: &[ViewMotion],
    imu_from_camera: Pose,
    config: &EstimatorConfig,
) -> InertialChain {
    let interval = |(begin, ends): (usize, &[i64])| {
        let between = readings.interval(ends[0], ends[1], IMU_SLACK_NS).ok()?;
        let ViewMotion { gyroscope_bias, accelerometer_bias, .. } = motions[begin];
        let preintegrated = PreintegratedImu::new(&between, &gyroscope_bias, &accelerometer_bias, config)?;
        Some((begin, preintegrated))
    };
    let intervals = stamps_ns.windows(2).enumerate().filter_map(interval).collect();
    InertialChain::new(intervals, motions[0], imu_from_camera, config).with_weak_priors()
}
