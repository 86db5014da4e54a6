//! Preintegration of the wheels between two images.
//!
//! Wheels of the radii `r_l`, `r_r` at the distance `b` that turn by `α_l`, `α_r` move the base along an arc of the length `s`
//! by the angle `a`:
//! ```text
//! s = (r_l α_l + r_r α_r) / 2        a = (r_r α_r - r_l α_l) / b
//! θ ← θ + a                          p ← p + R(θ) s sinc(a/2) [cos(a/2), sin(a/2)]
//! ```
//! in the frame of the base at the begin. Covariance and Jacobians with respect to the calibration follow to first order.
//!
//! Source: Lee, Eckenhoff, Yang, Geneva & Huang, IROS 2020.

use super::buffer::WheelInterval;
use super::calibration::WheelCalibration;
use super::config::WheelNoise;
use nalgebra::{Matrix2, Matrix2x3, Matrix3, Matrix3x4, RowVector3, Vector2, Vector3};
use types::WheelReading;

/// Half angle below which an arc is straight, rad.
const STRAIGHT: f64 = 1e-4;

/// Motion of the base between two times, in its frame at the first one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanarMotion {
    /// Heading, x and y at the end (rad, metres).
    pub motion: Vector3<f64>,
    /// Covariance of its noise.
    pub covariance: Matrix3<f64>,
    /// With respect to both radii, the track (metres) and the time offset (seconds).
    pub wrt_calibration: Matrix3x4<f64>,
    /// Length of the way, metres.
    pub distance_m: f64,
    /// Duration, seconds.
    pub seconds: f64,
}

/// Speed of the base.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Speed {
    /// Forward, m/s.
    pub forward: f64,
    /// rad/s.
    pub turn: f64,
}

impl Speed {
    fn of(reading: &WheelReading, calibration: &WheelCalibration) -> Self {
        let left = calibration.radius_left_m * reading.left;
        let right = calibration.radius_right_m * reading.right;
        Self { forward: f64::midpoint(left, right), turn: (right - left) / calibration.track_m }
    }
}

/// Displacement along an arc, and its derivatives with respect to length and angle.
struct Arc {
    displacement: Vector2<f64>,
    wrt_length: Vector2<f64>,
    wrt_angle: Vector2<f64>,
}

impl Arc {
    /// # Arguments
    /// * `length`: metres.
    /// * `angle`: rad.
    fn new(length: f64, angle: f64) -> Self {
        let half = angle / 2.0;
        let (sin, cos) = half.sin_cos();
        let (sinc, slope) = if half.abs() < STRAIGHT {
            (1.0 - half * half / 6.0, -half / 3.0)
        } else {
            (sin / half, (cos - sin / half) / half)
        };
        let (direction, across) = (Vector2::new(cos, sin), Vector2::new(-sin, cos));
        Self {
            displacement: direction * (length * sinc),
            wrt_length: direction * sinc,
            wrt_angle: (direction * slope + across * sinc) * (length / 2.0),
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
    let WheelCalibration { radius_left_m, radius_right_m, track_m, .. } = *calibration;
    let mut result = PlanarMotion {
        motion: Vector3::zeros(),
        covariance: Matrix3::zeros(),
        wrt_calibration: Matrix3x4::zeros(),
        distance_m: 0.0,
        seconds,
    };
    for pair in readings.windows(2) {
        let dt = (pair[1].stamp_ns - pair[0].stamp_ns) as f64 * 1e-9;
        let turned = [
            f64::midpoint(pair[0].left, pair[1].left) * dt,
            f64::midpoint(pair[0].right, pair[1].right) * dt,
        ];
        let rolled = [radius_left_m * turned[0], radius_right_m * turned[1]];
        let (length, angle) = (f64::midpoint(rolled[0], rolled[1]), (rolled[1] - rolled[0]) / track_m);
        let arc = Arc::new(length, angle);
        let (sin, cos) = result.motion.x.sin_cos();
        let heading = Matrix2::new(cos, -sin, sin, cos);
        let moved = heading * arc.displacement;

        // What a step does to the error of the motion so far.
        let mut transition = Matrix3::identity();
        transition.fixed_view_mut::<2, 1>(1, 0).copy_from(&Vector2::new(-moved.y, moved.x));
        // With respect to what the left and the right wheel roll, and to the track.
        let angle_wrt = RowVector3::new(-1.0 / track_m, 1.0 / track_m, -angle / track_m);
        let length_wrt = RowVector3::new(0.5, 0.5, 0.0);
        let moved_wrt: Matrix2x3<f64> = heading * (arc.wrt_length * length_wrt + arc.wrt_angle * angle_wrt);
        let mut by_roll = Matrix3::zeros();
        by_roll.fixed_view_mut::<1, 3>(0, 0).copy_from(&angle_wrt);
        by_roll.fixed_view_mut::<2, 3>(1, 0).copy_from(&moved_wrt);

        let variance = |radius: f64, rolled: f64| {
            (radius * noise.sigma_speed_rad_s).powi(2) * interval.period_s * dt
                + noise.sigma_rolling_m_sqrt_m.powi(2) * rolled.abs()
        };
        let variances =
            Vector3::new(variance(radius_left_m, rolled[0]), variance(radius_right_m, rolled[1]), 0.0);
        result.covariance = transition * result.covariance * transition.transpose()
            + by_roll * Matrix3::from_diagonal(&variances) * by_roll.transpose();
        let by_calibration = by_roll * Matrix3::from_diagonal(&Vector3::new(turned[0], turned[1], 1.0));
        let so_far = transition * result.wrt_calibration.fixed_columns::<3>(0);
        result.wrt_calibration.fixed_columns_mut::<3>(0).copy_from(&(so_far + by_calibration));

        result.motion += Vector3::new(angle, moved.x, moved.y);
        result.distance_m += length.abs();
    }
    result.set_speeds(&Speed::of(first, calibration), &Speed::of(last, calibration));
    Some(result)
}

impl PlanarMotion {
    /// Sets the derivative with respect to the time offset from the speeds at begin and end.
    ///
    /// A larger offset shifts the interval to earlier readings: the motion at its end is not made, that before its begin is.
    pub fn set_speeds(&mut self, first: &Speed, last: &Speed) {
        let (motion, (sin, cos)) = (&self.motion, self.motion.x.sin_cos());
        let by_offset = Vector3::new(
            first.turn - last.turn,
            first.forward - first.turn * motion.z - last.forward * cos,
            first.turn * motion.y - last.forward * sin,
        );
        self.wrt_calibration.set_column(3, &by_offset);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wheels::config::WheelConfig;
    use geometry::numeric::numeric_jacobian;
    use nalgebra::DVector;

    fn calibration() -> WheelCalibration {
        let mut config = WheelConfig::new(0.10, 0.50);
        config.radius_right_m = 0.11;
        WheelCalibration::new(&config)
    }

    /// Readings every 20 ms, with the ends of the interval between them.
    fn interval(from_ns: i64, to_ns: i64, reading: impl Fn(i64) -> WheelReading) -> WheelInterval {
        let inside = (from_ns / 20_000_000 + 1) * 20_000_000;
        let inner = (inside..to_ns).step_by(20_000_000);
        let readings = std::iter::once(from_ns).chain(inner).chain([to_ns]).map(reading).collect();
        WheelInterval { readings, period_s: 0.02 }
    }

    fn reading(stamp_ns: i64) -> WheelReading {
        let t = stamp_ns as f64 * 1e-9;
        WheelReading { stamp_ns, left: 8.0 + 3.0 * t, right: 12.0 - 2.0 * t }
    }

    #[test]
    fn constant_speeds_are_an_arc() {
        let calibration = calibration();
        for (left, right) in [(10.0, 12.0), (10.0, 100.0 / 11.0), (-5.0, 5.0), (0.0, 0.0)] {
            let steady = interval(0, 1_000_000_000, |stamp_ns| WheelReading { stamp_ns, left, right });
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
        let (calibration, noise) = (calibration(), WheelNoise::default());
        let (from_ns, to_ns) = (107_000_000, 1_333_000_000);
        let found = preintegrate(&interval(from_ns, to_ns, reading), &calibration, &noise).unwrap();
        let numeric = numeric_jacobian(4, |error| {
            let mut moved = calibration;
            moved.radius_left_m += error[0];
            moved.radius_right_m += error[1];
            moved.track_m += error[2];
            let shift_ns = (error[3] * 1e9).round() as i64;
            let shifted = interval(from_ns - shift_ns, to_ns - shift_ns, reading);
            let motion = preintegrate(&shifted, &moved, &noise).unwrap().motion;
            DVector::from_column_slice(motion.as_slice())
        });
        let difference = numeric - found.wrt_calibration;
        assert!(difference.columns(0, 3).amax() < 1e-6, "{difference}");
        // The speeds between readings are interpolated, and a chord is not an arc.
        assert!(difference.column(3).amax() < 1e-3, "{difference}");
    }

    #[test]
    fn the_covariance_is_that_of_noisy_readings() {
        use rand::{RngExt as _, SeedableRng, rngs::StdRng};
        let mut rng = StdRng::seed_from_u64(5);
        let mut normal = || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
        let (calibration, mut noise) = (calibration(), WheelNoise::default());
        (noise.sigma_speed_rad_s, noise.sigma_rolling_m_sqrt_m) = (0.5, 1e-9);
        let exact = interval(0, 1_000_000_000, reading);
        let found = preintegrate(&exact, &calibration, &noise).unwrap();
        let mut sum = Matrix3::zeros();
        let runs = 4000;
        for _ in 0..runs {
            let mut noisy = exact.clone();
            for reading in &mut noisy.readings {
                reading.left += 0.5 * normal();
                reading.right += 0.5 * normal();
            }
            let error = preintegrate(&noisy, &calibration, &noise).unwrap().motion - found.motion;
            sum += error * error.transpose();
        }
        let sampled = sum / f64::from(runs);
        for k in 0..3 {
            let ratio = found.covariance[(k, k)] / sampled[(k, k)];
            assert!((ratio - 1.0).abs() < 0.1, "{ratio} {sampled} {}", found.covariance);
        }
        let slower = noise;
        noise.sigma_rolling_m_sqrt_m = 0.01;
        let rolling = preintegrate(&exact, &calibration, &noise).unwrap().covariance;
        let white = preintegrate(&exact, &calibration, &slower).unwrap().covariance;
        assert!((rolling - white)[(1, 1)] > 0.0);
    }
}
