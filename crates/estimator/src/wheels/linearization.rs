//! Derivatives with respect to the calibration of the wheels, at the motion that the clones state.
//!
//! The readings are noisy, and derivatives at noisy readings have the same noise as the residual: each interval would push the
//! radii down and the track up, by a few standard deviations over a minute, since their product has a mean that is not zero
//! (errors in variables). The motion of the clones before the update has no part in the noise of the interval.

use super::buffer::WheelInterval;
use super::calibration::WheelCalibration;
use super::config::WheelNoise;
use super::kinematics::values_of_excess;
use super::measurement::relative_motion;
use super::preintegration::{PlanarMotion, preintegrate};
use geometry::Pose;
use nalgebra::Vector3;

/// The pose of a clone, and its time by the clock of the IMU.
#[derive(Clone, Copy, Debug)]
pub struct TimedPose {
    /// Pose of the body in L.
    pub local_from_imu: Pose,
    /// Nanoseconds.
    pub stamp_ns: i64,
}

/// The clones at both ends of an interval, with those before and after it where they are known.
#[derive(Clone, Copy, Debug)]
pub struct ClonesAround {
    /// The clone before the begin.
    pub before: Option<TimedPose>,
    /// Begin of the interval.
    pub first: TimedPose,
    /// End of the interval.
    pub second: TimedPose,
    /// The clone after the end.
    pub after: Option<TimedPose>,
}

/// A preintegrated motion with its derivatives at the motion of the clones.
///
/// # Returns
/// `None` for fewer than two readings.
pub fn linearize(
    motion: &PlanarMotion,
    interval: &WheelInterval,
    clones: &ClonesAround,
    calibration: &WheelCalibration,
    noise: &WheelNoise,
) -> Option<PlanarMotion> {
    let base = &calibration.imu_from_base;
    let ClonesAround { before, first, second, after } = clones;
    let stated = relative_motion(&first.local_from_imu, &second.local_from_imu, base);
    let mut excess = motion.motion - stated.xyz();
    if !calibration.base.kind().moves_sideways() {
        excess.z = 0.0;
    }
    let seconds = motion.seconds.max(1e-9);
    let surplus = values_of_excess(&calibration.base, &interval.readings, &excess, seconds);
    let mut expected = interval.clone();
    for reading in &mut expected.readings {
        reading.values.iter_mut().zip(surplus).for_each(|(value, surplus)| *value -= surplus);
    }
    let mut expected = preintegrate(&expected, calibration, noise)?;
    let mut from = speed_between(before.as_ref().unwrap_or(first), second, base);
    let mut to = speed_between(first, after.as_ref().unwrap_or(second), base);
    if !calibration.base.kind().moves_sideways() {
        (from.z, to.z) = (0.0, 0.0);
    }
    expected.set_speeds(calibration.clock(), &from, &to);
    Some(PlanarMotion { wrt_calibration: expected.wrt_calibration, ..*motion })
}

/// Mean speed of the base between two clones: turn, ahead and left (rad/s, m/s).
fn speed_between(begin: &TimedPose, end: &TimedPose, imu_from_base: &Pose) -> Vector3<f64> {
    let moved = relative_motion(&begin.local_from_imu, &end.local_from_imu, imu_from_base);
    let seconds = ((end.stamp_ns - begin.stamp_ns) as f64 * 1e-9).max(1e-9);
    let (sin, cos) = (moved.x / 2.0).sin_cos();
    Vector3::new(moved.x, moved.y * cos + moved.z * sin, moved.z * cos - moved.y * sin) / seconds
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wheels::config::WheelConfig;
    use geometry::rotation;
    use types::{BaseKind, WheelBase, WheelReading};

    /// Readings with any noise of the whole interval have the derivatives of those without.
    #[test]
    fn derivatives_do_not_depend_on_what_the_wheels_slipped() {
        let mut config = WheelConfig::new(WheelBase::new(BaseKind::Differential, 0.1, 0.5));
        config.base_position_m = [-0.1, 0.05, -0.2];
        let (calibration, noise) = (WheelCalibration::new(&config), WheelNoise::default());
        let interval = |left: f64, right: f64| WheelInterval {
            readings: (0..=5).map(|k| WheelReading::new(k * 20_000_000, [left, right])).collect(),
            period_s: 0.02,
        };
        let exact = interval(10.0, 14.0);
        let motion = preintegrate(&exact, &calibration, &noise).unwrap();
        let (forward, turn) = (1.2, 0.8);
        let base_from_imu = calibration.imu_from_base.inverse();
        let clone = |k: i64| {
            let angle = turn * k as f64 * 0.1;
            let radius = forward / turn;
            let position = Vector3::new(radius * angle.sin(), radius * (1.0 - angle.cos()), 0.0);
            let local_from_base = Pose::new(rotation::exp(&(Vector3::z() * angle)), position);
            TimedPose { local_from_imu: local_from_base * base_from_imu, stamp_ns: k * 100_000_000 }
        };
        let clones = ClonesAround {
            before: Some(clone(-1)),
            first: clone(0),
            second: clone(1),
            after: Some(clone(2)),
        };
        let found = linearize(&motion, &exact, &clones, &calibration, &noise).unwrap();
        assert!((found.wrt_calibration - motion.wrt_calibration).amax() < 1e-3);
        let slipped = interval(12.5, 13.0);
        let other = preintegrate(&slipped, &calibration, &noise).unwrap();
        let again = linearize(&other, &slipped, &clones, &calibration, &noise).unwrap();
        assert!((again.wrt_calibration - found.wrt_calibration).amax() < 1e-2, "a chord is not an arc");
        assert!((other.wrt_calibration - motion.wrt_calibration).amax() > 0.1, "at the readings they do");
        assert_eq!((again.motion, again.covariance), (other.motion, other.covariance));
    }
}
