//! The sensors of a robot: what they are, where they are mounted, and their noise.

use crate::ImuIntrinsics;
use geometry::camera::Camera;
use geometry::pose::Pose;
use geometry::{CameraGroup, Geodetic};
use nalgebra::Vector3;
use types::{BaseKind, Encoder, ImuNoise, WheelBase};

/// The inertial sensor. Its frame is the body frame.
#[derive(Clone, Debug, PartialEq)]
pub struct ImuSensor {
    /// Noise densities.
    pub noise: ImuNoise,
    /// Readings a second.
    pub rate_hz: f64,
    /// Magnitude of gravity at the place of the recording, m/s^2, where the calibration states it.
    pub gravity_magnitude: Option<f64>,
    /// Scale, misalignment and g-sensitivity of its readings as they are recorded or come, where they are calibrated. Who takes readings in corrects
    /// them, once: those that a recording or a live source yields are corrected.
    pub intrinsics: Option<ImuIntrinsics>,
}

/// A camera and its mounting.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraSensor {
    /// Projection: resolution, intrinsics, distortion.
    pub camera: Camera,
    /// Pose of the camera in the IMU frame: `imu_from_camera`.
    pub imu_from_camera: Pose,
    /// Images a second.
    pub rate_hz: f64,
    /// Time from the readout of the first row to that after the last one, seconds: 0 for a global shutter, negative where images
    /// are turned by 180 degrees after they were read out. The stamp of an image is the time of its middle row.
    pub readout_s: f64,
    /// Kalibr's `timeshift_cam_imu` less that of camera 0, seconds: how much later the IMU's clock is at an image of this camera than at one
    /// of camera 0 with the same stamp.
    pub time_shift_s: f64,
}

/// Shifts up to this are taken for delays within a frame: exposures of different length, a trigger that passes from camera to camera. Larger
/// ones, seconds, are those of the stamps.
const MAX_DELAY_S: f64 = 5e-3;

impl CameraSensor {
    /// A camera with a global shutter and the time shift of camera 0.
    pub fn new(camera: Camera, imu_from_camera: Pose, rate_hz: f64) -> Self {
        Self { camera, imu_from_camera, rate_hz, readout_s: 0.0, time_shift_s: 0.0 }
    }

    /// What is added to the stamps of its images before they are joined to frames, nanoseconds: the time shift where it is larger than the 5 ms
    /// by which stamps of one frame differ.
    pub fn stamp_shift_ns(&self) -> i64 {
        if self.time_shift_s.abs() > MAX_DELAY_S { (self.time_shift_s * 1e9).round() as i64 } else { 0 }
    }

    /// Time of its image after the stamp of the frame, seconds: the time shift where it is not larger than 5 ms.
    pub fn delay_s(&self) -> f64 {
        if self.time_shift_s.abs() > MAX_DELAY_S { 0.0 } else { self.time_shift_s }
    }
}

/// Makes the time shifts of cameras those against camera 0.
///
/// # Arguments
/// * `cameras`: with `time_shift_s` as Kalibr states it, against the clock of the IMU.
///
/// # Returns
/// What is added to the stamps of frames to obtain those of the IMU, nanoseconds.
pub fn relative_time_shifts(cameras: &mut [CameraSensor]) -> i64 {
    let of_first = cameras.first().map_or(0.0, |camera| camera.time_shift_s);
    for camera in cameras {
        camera.time_shift_s -= of_first;
    }
    (of_first * 1e9).round() as i64
}

/// Which cameras of a rig are stereo pairs: [`geometry::camera_groups`].
pub fn camera_groups(cameras: &[CameraSensor]) -> Vec<CameraGroup> {
    geometry::camera_groups(cameras.iter().map(|sensor| (&sensor.camera, &sensor.imu_from_camera)))
}

/// The wheels of a base.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WheelSensor {
    /// What the base is, and its geometry.
    pub base: WheelBase,
    /// Pose of the base in the IMU frame.
    pub imu_from_base: Pose,
    /// White noise of a reading, rad/s, where the calibration states it.
    pub sigma_speed_rad_s: Option<f64>,
    /// Error of an angle, rad, where the calibration states it: the steps of encoders.
    pub sigma_angle_rad: Option<f64>,
    /// The encoders, where counts are recorded in place of speeds.
    pub encoder: Option<Encoder>,
}

impl WheelSensor {
    /// Wheels whose speeds are recorded, with a noise that is not known.
    pub fn new(base: WheelBase, imu_from_base: Pose) -> Self {
        Self { base, imu_from_base, sigma_speed_rad_s: None, sigma_angle_rad: None, encoder: None }
    }

    /// White noise of a velocity of [`Self::of_base_velocity`], m/s.
    const SIGMA_VELOCITY_M_S: f64 = 0.005;

    /// Wheels that stand for a base whose velocity is measured, ahead, to the left (m/s) and about its z axis (rad/s), as
    /// [`WheelReading::of_base_velocity`](types::WheelReading::of_base_velocity) has them: of 1 m radius, and 1 m apart. An error of the radii is
    /// one of the measured scale, one of the track (or reach) is one of the measured turns.
    pub fn of_base_velocity(kind: BaseKind, imu_from_base: Pose) -> Self {
        let stands_for = if kind.moves_sideways() { BaseKind::Mecanum } else { BaseKind::Differential };
        let sigma_speed_rad_s = Some(Self::SIGMA_VELOCITY_M_S);
        Self { sigma_speed_rad_s, ..Self::new(WheelBase::new(stands_for, 1.0, 1.0), imu_from_base) }
    }
}

/// The antenna of GNSS, and the frame of its positions.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GnssSensor {
    /// The antenna in the IMU frame, metres.
    pub antenna_in_imu: Vector3<f64>,
    /// Origin of the east-north-up frame that positions in latitude, longitude and altitude are turned to; without it they are
    /// in that frame already.
    pub origin: Option<Geodetic>,
    /// Standard deviations along the axes of positions that state none, metres.
    pub sigma_m: Option<Vector3<f64>>,
    /// Time over which errors are alike, seconds, where it is stated.
    pub correlation_time_s: Option<f64>,
}

/// Calibration of all sensors of a robot or of a recording.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SensorCalibration {
    /// The IMU. A recording that only serves to build maps may have none; a robot cannot be localized without it.
    pub imu: Option<ImuSensor>,
    /// The cameras; frames refer to them by index.
    pub cameras: Vec<CameraSensor>,
    /// The wheels, where there are any and their geometry is known.
    pub wheels: Option<WheelSensor>,
    /// The antenna of GNSS, where there is one.
    pub gnss: Option<GnssSensor>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::Distortion;

    #[test]
    fn small_time_shifts_are_delays_and_large_ones_are_those_of_the_stamps() {
        let camera = Camera {
            width: 640,
            height: 480,
            focal: [400.0; 2],
            centre: [320.0, 240.0],
            distortion: Distortion::None,
        };
        let shifted = |time_shift_s| CameraSensor {
            time_shift_s,
            ..CameraSensor::new(camera.clone(), Pose::identity(), 20.0)
        };
        let mut cameras = [0.010, 0.013, 0.040, -0.030].map(shifted);
        assert_eq!(relative_time_shifts(&mut cameras), 10_000_000);
        let stamps_ns = cameras.iter().map(CameraSensor::stamp_shift_ns).collect::<Vec<_>>();
        assert_eq!(stamps_ns, [0, 0, 30_000_000, -40_000_000]);
        let delays_us = cameras.each_ref().map(|camera| (camera.delay_s() * 1e6).round() as i64);
        assert_eq!(delays_us, [0, 3000, 0, 0]);
    }
}
