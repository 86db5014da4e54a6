//! Pixels as a camera would have seen them that did not turn while the image was read out, at the time of its frame.
//!
//! For what knows no pose of a row: the start in motion, and the recognition of a place. The turn during the readout moves the outer
//! rows by some pixels and is known from the gyroscope; the translation moves them by as much as the landmarks are near, which is not
//! known there, and much less.

use super::motion_around::{MotionAround, poses_from};
use crate::calibration::CalibratedCamera;
use crate::imu::ImuBuffer;
use crate::propagation::ImuState;
use nalgebra::{Vector2, Vector3};

/// The turn about the time of an image by the readings of the gyroscope alone.
///
/// # Arguments
/// * `stamp_ns`: of the image, by the IMU's clock.
/// * `reach_ns`: how far rows are from it, nanoseconds.
/// * `gyroscope_bias`: rad/s; one that is not known moves a pixel by less than a tenth.
pub fn turn_around(
    imu: &ImuBuffer,
    stamp_ns: i64,
    reach_ns: i64,
    gyroscope_bias: &Vector3<f64>,
) -> MotionAround {
    let state = ImuState::at_rest(*gyroscope_bias, Vector3::zeros());
    let (before, after) = (
        imu.interval(stamp_ns - reach_ns, stamp_ns, 2 * reach_ns),
        imu.interval(stamp_ns, stamp_ns + reach_ns, 2 * reach_ns),
    );
    let before = before.map(|readings| poses_from(&state, readings.iter().rev(), &Vector3::zeros()));
    let after = after.map(|readings| poses_from(&state, readings.iter(), &Vector3::zeros()));
    MotionAround::new(&before.unwrap_or_default(), &after.unwrap_or_default(), None)
}

/// The pixel at which the camera would have seen the same direction at the time of the image; the pixel itself where it is none of
/// the camera's model.
pub fn still_pixel(
    calibrated: &CalibratedCamera,
    motion: &MotionAround,
    pixel: &Vector2<f64>,
) -> Vector2<f64> {
    let seconds = calibrated.pixel_time_s(pixel);
    let imu_from_camera = calibrated.imu_from_camera.rotation;
    let image_from_row =
        imu_from_camera.inverse() * motion.at(seconds).clone_from_imu.rotation * imu_from_camera;
    let Ok(seen) = calibrated.camera.bearing(pixel) else { return *pixel };
    calibrated.camera.project(&(image_from_row * seen.into_inner())).unwrap_or(*pixel)
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::{Camera, Distortion, Pose, rotation};
    use types::ImuSample;

    #[test]
    fn a_far_point_is_seen_where_a_global_shutter_sees_it() {
        let camera = Camera {
            width: 640,
            height: 480,
            focal: [400.0; 2],
            centre: [320.0, 240.0],
            distortion: Distortion::RadialTangential([-0.1, 0.02, 1e-3, -1e-3]),
        };
        let mounted = Pose::new(rotation::exp(&Vector3::new(0.3, -0.2, 0.9)), Vector3::zeros());
        let mut calibrated = CalibratedCamera::new(camera, mounted);
        calibrated.readout_s = 0.03;
        let rate = Vector3::new(0.8, -1.2, 0.5);
        let mut imu = ImuBuffer::default();
        for k in 0..20 {
            let stamp_ns = k * 5_000_000;
            imu.push(ImuSample { stamp_ns, gyroscope: rate, accelerometer: Vector3::z() }).unwrap();
        }
        let motion = turn_around(&imu, 50_000_000, 15_000_000, &Vector3::zeros());
        let in_image = Vector3::new(0.4, -0.45, 1.0);
        let global = calibrated.camera.project(&in_image).unwrap();
        let mut rolling = global;
        for _ in 0..5 {
            let turned = rotation::exp(&(rate * calibrated.row_fraction(&rolling) * 0.03));
            let row = mounted.rotation.inverse() * turned.inverse() * mounted.rotation * in_image;
            rolling = calibrated.camera.project(&row).unwrap();
        }
        assert!((rolling - global).norm() > 2.0);
        assert!((still_pixel(&calibrated, &motion, &rolling) - global).norm() < 1e-3);
    }
}
