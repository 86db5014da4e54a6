//! Preintegration of the wheels between two images.
//!
//! Between two readings the base [turns](super::kinematics) by `a` and moves by `s_x` ahead and `s_y` to the left, along an arc:
//! ```text
//! θ ← θ + a        p ← p + R(θ) sinc(a/2) R(a/2) [s_x, s_y]
//! ```
//! in the frame of the base at the begin. Covariance and Jacobians with respect to the calibration follow to first order.
//!
//! Source: Lee, Eckenhoff, Yang, Geneva & Huang, IROS 2020.

use super::buffer::WheelInterval;
use super::calibration::WheelCalibration;
use super::config::WheelNoise;
use super::kinematics::Step;
use nalgebra::{Matrix2, Matrix3, Matrix3x4, SMatrix, Vector2, Vector3};
use types::{MAX_WHEEL_PARAMETERS, MAX_WHEELS, WheelBase};

/// Derivatives with respect to the base and the time offset.
pub type ByCalibration = SMatrix<f64, 3, { MAX_WHEEL_PARAMETERS + 1 }>;

/// Speed to which the noise of steering and of motion across the track falls at rest, m/s: a vibrating body is not exactly still.
pub(super) const LEAST_SPEED: f64 = 0.05;
/// Half angle below which an arc is straight, rad.
const STRAIGHT: f64 = 1e-4;

/// Motion of the base between two times, in its frame at the first one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanarMotion {
    /// Heading, x and y at the end (rad, metres).
    pub motion: Vector3<f64>,
    /// Covariance of its noise.
    pub covariance: Matrix3<f64>,
    /// With respect to the parameters of the base (metres, rad) and, behind them, the time offset (seconds); further columns are
    /// zero.
    pub wrt_calibration: ByCalibration,
    /// Length of the way, metres.
    pub distance_m: f64,
    /// Duration, seconds.
    pub seconds: f64,
}

/// Displacement along an arc, and its derivatives with respect to ways (ahead, to the left) and angle.
struct Arc {
    displacement: Vector2<f64>,
    wrt_ways: Matrix2<f64>,
    wrt_angle: Vector2<f64>,
}

impl Arc {
    /// # Arguments
    /// * `motion`: angle (rad), way ahead and to the left (metres).
    fn new(motion: &Vector3<f64>) -> Self {
        let half = motion.x / 2.0;
        let (sin, cos) = half.sin_cos();
        let (sinc, slope) = if half.abs() < STRAIGHT {
            (1.0 - half * half / 6.0, -half / 3.0)
        } else {
            (sin / half, (cos - sin / half) / half)
        };
        let (direction, across) = (Vector2::new(cos, sin), Vector2::new(-sin, cos));
        let (ahead, left) = (motion.y, motion.z);
        Self {
            displacement: direction * (ahead * sinc) + across * (left * sinc),
            wrt_ways: Matrix2::from_columns(&[direction * sinc, across * sinc]),
            wrt_angle: (direction * slope + across * sinc) * (ahead / 2.0)
                + (across * slope - direction * sinc) * (left / 2.0),
        }
    }
}

/// Integrates the readings of an interval.
///
/// # Returns
/// `None` for fewer than two readings.
pub fn preintegrate(
    interval: &WheelInterval,
    calibration: &WheelCalibration,
    noise: &WheelNoise,
) -> Option<PlanarMotion> {
    let readings = &interval.readings;
    let [first, .., last] = readings.as_slice() else { return None };
    let seconds = (last.stamp_ns - first.stamp_ns) as f64 * 1e-9;
    let base = &calibration.base;
    let clock = calibration.clock();
    let mut result = PlanarMotion {
        motion: Vector3::zeros(),
        covariance: Matrix3::zeros(),
        wrt_calibration: ByCalibration::zeros(),
        distance_m: 0.0,
        seconds,
    };
    let steps = readings.len() - 1;
    for (index, pair) in readings.windows(2).enumerate() {
        let dt = (pair[1].stamp_ns - pair[0].stamp_ns) as f64 * 1e-9;
        let mean = std::array::from_fn(|value| f64::midpoint(pair[0].values[value], pair[1].values[value]));
        let step = Step::new(base, &mean, dt);
        let arc = Arc::new(&step.motion);
        let (sin, cos) = result.motion.x.sin_cos();
        let heading = Matrix2::new(cos, -sin, sin, cos);
        let moved = heading * arc.displacement;

        // What a step does to the error of the motion so far.
        let mut transition = Matrix3::identity();
        transition.fixed_view_mut::<2, 1>(1, 0).copy_from(&Vector2::new(-moved.y, moved.x));
        // What an error of the step does.
        let mut by_step = Matrix3::identity();
        by_step.fixed_view_mut::<2, 1>(1, 0).copy_from(&(heading * arc.wrt_angle));
        by_step.fixed_view_mut::<2, 2>(1, 1).copy_from(&(heading * arc.wrt_ways));

        // Steps of an encoder are unknown at both ends of the interval, and nowhere else.
        let ends = f64::from(u8::from(index == 0) + u8::from(index + 1 == steps));
        let of_step = covariance_of(&step, base, noise, &StepTimes { dt, period_s: interval.period_s, ends });
        result.covariance =
            transition * result.covariance * transition.transpose() + by_step * of_step * by_step.transpose();
        let mut by_calibration = transition * result.wrt_calibration;
        for (wheel, speed) in mean.iter().enumerate().take(base.kind().wheels()) {
            let by_radius = step.by_values.column(wheel) * (speed * dt);
            by_calibration.set_column(wheel, &(by_calibration.column(wheel) + by_step * by_radius));
        }
        for (column, by_geometry) in (base.kind().wheels()..clock).zip(&step.by_geometry) {
            by_calibration.set_column(column, &(by_calibration.column(column) + by_step * by_geometry));
        }
        result.wrt_calibration = by_calibration;

        result.motion += Vector3::new(step.motion.x, moved.x, moved.y);
        result.distance_m += step.motion.yz().norm();
    }
    result.set_speeds(clock, &Step::speed(base, first), &Step::speed(base, last));
    Some(result)
}

/// When a step of the integration is.
struct StepTimes {
    /// Its duration, seconds.
    dt: f64,
    /// Between two readings, seconds.
    period_s: f64,
    /// Ends of the interval that are its own.
    ends: f64,
}

/// Covariance of the motion of a step.
fn covariance_of(step: &Step, base: &WheelBase, noise: &WheelNoise, times: &StepTimes) -> Matrix3<f64> {
    let StepTimes { dt, period_s, ends } = *times;
    let rolling_variance = noise.sigma_rolling_m_sqrt_m.powi(2);
    let mut variances = [0.0; MAX_WHEELS];
    for (wheel, variance) in variances.iter_mut().enumerate().take(base.kind().wheels()) {
        let radius = base.radius_m(wheel);
        *variance = (radius * noise.sigma_speed_rad_s).powi(2) * period_s * dt
            + rolling_variance * step.rolled[wheel].abs()
            + ends * (radius * noise.sigma_angle_rad).powi(2);
    }
    let mut of_turn = 0.0;
    if let WheelBase::Ackermann { wheelbase_m, .. } = base {
        variances[1] = noise.sigma_steering_rad.powi(2) * period_s * dt;
        // Front wheels that roll sideways turn the base; at rest nothing is known of the steering.
        of_turn = rolling_variance * (step.rolled[0].abs() + LEAST_SPEED * dt) / wheelbase_m.powi(2);
    }
    let by_values: &Matrix3x4<f64> = &step.by_values;
    let mut covariance = Matrix3::zeros();
    for (column, variance) in by_values.column_iter().zip(variances) {
        covariance += column * column.transpose() * variance;
    }
    covariance[(0, 0)] += of_turn;
    covariance
}

impl PlanarMotion {
    /// Sets the derivative with respect to the time offset from the speeds at begin and end: turn, ahead and left (rad/s, m/s).
    ///
    /// A larger offset shifts the interval to earlier readings: the motion at its end is not made, that before its begin is.
    ///
    /// # Arguments
    /// * `clock`: index of the time offset in the calibration.
    pub fn set_speeds(&mut self, clock: usize, first: &Vector3<f64>, last: &Vector3<f64>) {
        let (motion, (sin, cos)) = (&self.motion, self.motion.x.sin_cos());
        let by_offset = Vector3::new(
            first.x - last.x,
            first.y - first.x * motion.z - (last.y * cos - last.z * sin),
            first.z + first.x * motion.y - (last.y * sin + last.z * cos),
        );
        self.wrt_calibration.set_column(clock, &by_offset);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wheels::config::WheelConfig;
    use crate::wheels::kinematics::ways_of_wheels;
    use geometry::numeric::numeric_jacobian;
    use nalgebra::DVector;
    use types::{BaseKind, WheelReading};

    fn calibration() -> WheelCalibration {
        calibration_of(BaseKind::Differential)
    }

    /// The last wheel is larger.
    fn calibration_of(kind: BaseKind) -> WheelCalibration {
        let mut base = WheelBase::new(kind, 0.10, 0.50);
        let mut steps = vec![0.0; kind.wheels()];
        steps[kind.wheels() - 1] = 0.01;
        base.add(&steps);
        WheelCalibration::new(&WheelConfig::new(base))
    }

    /// Readings every 20 ms, with the ends of the interval between them.
    fn interval(from_ns: i64, to_ns: i64, reading: impl Fn(i64) -> WheelReading) -> WheelInterval {
        let inside = (from_ns / 20_000_000 + 1) * 20_000_000;
        let inner = (inside..to_ns).step_by(20_000_000);
        let readings = std::iter::once(from_ns).chain(inner).chain([to_ns]).map(reading).collect();
        WheelInterval { readings, period_s: 0.02 }
    }

    /// Readings of a base that moves in all its directions, without a contradiction among its wheels.
    fn reading_of(base: &WheelBase, stamp_ns: i64) -> WheelReading {
        let t = stamp_ns as f64 * 1e-9;
        if base.kind() == BaseKind::Ackermann {
            return WheelReading::new(stamp_ns, [8.0 + 3.0 * t, 0.3 - 0.2 * t]);
        }
        let left = if base.kind().moves_sideways() { 0.7 - 0.3 * t } else { 0.0 };
        let ways = ways_of_wheels(base, &Vector3::new(0.4 * t, 1.0 - 0.1 * t, left));
        let speed = |wheel| ways[wheel] / base.radius_m(wheel);
        WheelReading { stamp_ns, values: std::array::from_fn(speed) }
    }

    #[test]
    fn constant_speeds_are_an_arc() {
        let calibration = calibration();
        for (left, right) in [(10.0, 12.0), (10.0, 100.0 / 11.0), (-5.0, 5.0), (0.0, 0.0)] {
            let steady = interval(0, 1_000_000_000, |stamp_ns| WheelReading::new(stamp_ns, [left, right]));
            let motion = preintegrate(&steady, &calibration, &WheelNoise::default()).unwrap();
            let speed = f64::midpoint(0.10 * left, 0.11 * right);
            let angle: f64 = (0.11 * right - 0.10 * left) / 0.50;
            let expected = if angle.abs() < 1e-12 {
                Vector3::new(0.0, speed, 0.0)
            } else {
                let radius = speed / angle;
                Vector3::new(angle, radius * angle.sin(), radius * (1.0 - angle.cos()))
            };
            assert!((motion.motion - expected).amax() < 1e-9, "{} {expected}", motion.motion);
        }
    }

    #[test]
    fn the_jacobians_are_the_numeric_ones() {
        for kind in BaseKind::ALL {
            let (calibration, noise) = (calibration_of(kind), WheelNoise::default());
            let reading = |stamp_ns: i64| reading_of(&calibration.base, stamp_ns);
            let (from_ns, to_ns) = (107_000_000, 1_333_000_000);
            let found = preintegrate(&interval(from_ns, to_ns, reading), &calibration, &noise).unwrap();
            let clock = calibration.clock();
            let numeric = numeric_jacobian(clock + 1, |error| {
                let mut moved = calibration;
                moved.base.add(&error.as_slice()[..clock]);
                let shift_ns = (error[clock] * 1e9).round() as i64;
                let shifted = interval(from_ns - shift_ns, to_ns - shift_ns, reading);
                let motion = preintegrate(&shifted, &moved, &noise).unwrap().motion;
                DVector::from_column_slice(motion.as_slice())
            });
            let difference = numeric - found.wrt_calibration.columns(0, clock + 1);
            assert!(difference.columns(0, clock).amax() < 1e-6, "{kind}: {difference}");
            // The speeds between readings are interpolated, and a chord is not an arc.
            assert!(difference.column(clock).amax() < 1e-3, "{kind}: {difference}");
        }
    }

    #[test]
    fn the_covariance_is_that_of_noisy_readings() {
        use rand::{RngExt as _, SeedableRng, rngs::StdRng};
        for kind in BaseKind::ALL {
            let mut rng = StdRng::seed_from_u64(5);
            let mut normal = || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
            let (calibration, mut noise) = (calibration_of(kind), WheelNoise::default());
            (noise.sigma_speed_rad_s, noise.sigma_rolling_m_sqrt_m) = (0.5, 1e-9);
            noise.sigma_steering_rad = 0.02;
            let exact = interval(0, 1_000_000_000, |stamp_ns| reading_of(&calibration.base, stamp_ns));
            let found = preintegrate(&exact, &calibration, &noise).unwrap();
            let mut sum = Matrix3::zeros();
            let runs = 2000;
            for _ in 0..runs {
                let mut noisy = exact.clone();
                for reading in &mut noisy.readings {
                    let columns = kind.columns().len();
                    for (index, value) in reading.values.iter_mut().enumerate().take(columns) {
                        *value += if index < kind.wheels() { 0.5 } else { 0.02 } * normal();
                    }
                }
                let error = preintegrate(&noisy, &calibration, &noise).unwrap().motion - found.motion;
                sum += error * error.transpose();
            }
            let sampled = sum / f64::from(runs);
            for k in 0..3 {
                let ratio = found.covariance[(k, k)] / sampled[(k, k)];
                assert!((ratio - 1.0).abs() < 0.15, "{kind}: {ratio} {sampled} {}", found.covariance);
            }
            let white = found.covariance;
            noise.sigma_rolling_m_sqrt_m = 0.01;
            let rolling = preintegrate(&exact, &calibration, &noise).unwrap().covariance;
            assert!((rolling - white)[(1, 1)] > 0.0);
            noise.sigma_angle_rad = 0.01;
            let stepping = preintegrate(&exact, &calibration, &noise).unwrap().covariance - rolling;
            // Of two ends, by each wheel.
            let by_wheels = Step::new(&calibration.base, &exact.readings[0].values, 1.0).by_values;
            let of_wheels = by_wheels.columns(0, kind.wheels());
            let ahead = 2.0 * 0.001_f64.powi(2) * of_wheels.row(1).norm_squared();
            assert!((stepping[(1, 1)] / ahead).ln().abs() < 0.7, "{kind}: {} {ahead}", stepping[(1, 1)]);
        }
    }
}
