//! Scale, misalignment and g-sensitivity of an IMU.

use nalgebra::Matrix3;
use types::ImuSample;

/// Entries of a matrix that are farther from those of an ideal IMU are of no sensor; 1 is one of twice the true scale.
const MAX_DEVIATION: f64 = 0.5;
/// G-sensitivities beyond this are of no sensor, (rad/s)/(m/s^2): consumer sensors reach 1e-3.
const MAX_G_SENSITIVITY: f64 = 0.1;

/// What an IMU reads in place of the true angular velocity and specific force, beside biases and noise:
///
/// ```text
/// accelerometer = M_a f,     gyroscope = M_g C w + A C f
/// ```
///
/// `f` is the specific force and `w` the angular velocity in the frame of the IMU, which is that of the accelerometers; `C` rotates from it to that of
/// the gyroscopes. It is Kalibr's model `scale-misalignment`, whose `M_a` and `M_g` are lower triangular.
///
/// ```
/// use calibration::ImuIntrinsics;
/// use nalgebra::{Matrix3, Vector3};
/// use types::ImuSample;
///
/// let scale = Matrix3::from_diagonal(&Vector3::new(1.02, 0.99, 1.0));
/// let intrinsics = ImuIntrinsics::new(scale, scale, Matrix3::identity(), Matrix3::zeros()).unwrap();
/// let reading = ImuSample { stamp_ns: 0, gyroscope: Vector3::x() * 1.02, accelerometer: Vector3::z() * 9.81 };
/// assert!((intrinsics.corrected(reading).gyroscope - Vector3::x()).norm() < 1e-12);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuIntrinsics {
    accelerometer: Matrix3<f64>,
    gyroscope: Matrix3<f64>,
    g_sensitivity: Matrix3<f64>,
    force_from_accelerometer: Matrix3<f64>,
    rate_from_gyroscope: Matrix3<f64>,
}

impl ImuIntrinsics {
    /// # Arguments
    /// * `accelerometer`: `M_a`.
    /// * `gyroscope`: `M_g`.
    /// * `gyroscope_from_imu`: `C`, a rotation.
    /// * `g_sensitivity`: `A`, (rad/s)/(m/s^2).
    ///
    /// # Returns
    /// `None` for matrices that are those of no sensor: not finite, or far from the ideal ones.
    pub fn new(
        accelerometer: Matrix3<f64>,
        gyroscope: Matrix3<f64>,
        gyroscope_from_imu: Matrix3<f64>,
        g_sensitivity: Matrix3<f64>,
    ) -> Option<Self> {
        let is_near = |matrix: &Matrix3<f64>, ideal: Matrix3<f64>, by: f64| {
            (matrix - ideal).iter().all(|difference| difference.abs() <= by)
        };
        let is_a_sensor = is_near(&accelerometer, Matrix3::identity(), MAX_DEVIATION)
            && is_near(&gyroscope, Matrix3::identity(), MAX_DEVIATION)
            && is_near(&g_sensitivity, Matrix3::zeros(), MAX_G_SENSITIVITY);
        let gyroscope = gyroscope * gyroscope_from_imu;
        Some(Self {
            accelerometer,
            gyroscope,
            g_sensitivity: g_sensitivity * gyroscope_from_imu,
            force_from_accelerometer: accelerometer.try_inverse()?,
            rate_from_gyroscope: gyroscope.try_inverse()?,
        })
        .filter(|_| is_a_sensor)
    }

    /// The reading without scale, misalignment and g-sensitivity; biases and noise remain.
    #[must_use]
    pub fn corrected(&self, reading: ImuSample) -> ImuSample {
        let accelerometer = self.force_from_accelerometer * reading.accelerometer;
        let gyroscope = self.rate_from_gyroscope * (reading.gyroscope - self.g_sensitivity * accelerometer);
        ImuSample { gyroscope, accelerometer, ..reading }
    }

    /// What the IMU reads of a motion: the inverse of [`Self::corrected`].
    #[must_use]
    pub fn distorted(&self, motion: ImuSample) -> ImuSample {
        let accelerometer = self.accelerometer * motion.accelerometer;
        let gyroscope = self.gyroscope * motion.gyroscope + self.g_sensitivity * motion.accelerometer;
        ImuSample { gyroscope, accelerometer, ..motion }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Rotation3, Vector3};

    fn lower(numbers: [f64; 6]) -> Matrix3<f64> {
        let [a, b, c, d, e, f] = numbers;
        Matrix3::new(a, 0.0, 0.0, b, c, 0.0, d, e, f)
    }

    #[test]
    fn what_an_imu_reads_of_a_motion_gives_the_motion_again() {
        let (accelerometer, gyroscope) =
            (lower([1.02, 0.01, 0.98, -0.02, 0.003, 1.01]), lower([0.97, -0.004, 1.03, 0.006, 0.01, 0.99]));
        let gyroscope_from_imu = Rotation3::new(Vector3::new(0.02, -0.03, 0.01)).into_inner();
        let g_sensitivity = Matrix3::new(1e-3, -2e-4, 3e-4, 5e-4, 2e-3, 0.0, -1e-4, 4e-4, -6e-4);
        let intrinsics =
            ImuIntrinsics::new(accelerometer, gyroscope, gyroscope_from_imu, g_sensitivity).unwrap();
        for step in 0..20 {
            let t = f64::from(step);
            let motion = ImuSample {
                stamp_ns: step.into(),
                gyroscope: Vector3::new(t.sin(), (2.0 * t).cos(), 0.3),
                accelerometer: Vector3::new(t.cos(), -0.7, 9.81 + (3.0 * t).sin()),
            };
            // Kalibr's error terms, written out.
            let (rate, force) = (motion.gyroscope, motion.accelerometer);
            let read = ImuSample {
                stamp_ns: step.into(),
                gyroscope: gyroscope * (gyroscope_from_imu * rate)
                    + g_sensitivity * (gyroscope_from_imu * force),
                accelerometer: accelerometer * force,
            };
            let distorted = intrinsics.distorted(motion);
            assert!((distorted.gyroscope - read.gyroscope).norm() < 1e-14);
            assert!((distorted.accelerometer - read.accelerometer).norm() < 1e-14);
            let back = intrinsics.corrected(read);
            assert_eq!(back.stamp_ns, motion.stamp_ns);
            assert!((back.gyroscope - rate).norm() < 1e-13, "{back:?}");
            assert!((back.accelerometer - force).norm() < 1e-13, "{back:?}");
        }
    }

    #[test]
    fn matrices_of_no_sensor_are_refused() {
        let (one, zero) = (Matrix3::identity(), Matrix3::zeros());
        assert!(ImuIntrinsics::new(one, one, one, zero).is_some());
        for (accelerometer, gyroscope, g_sensitivity) in
            [(zero, one, zero), (one, one * 9.81, zero), (one * f64::NAN, one, zero), (one, one, one)]
        {
            assert!(ImuIntrinsics::new(accelerometer, gyroscope, one, g_sensitivity).is_none());
        }
    }
}
