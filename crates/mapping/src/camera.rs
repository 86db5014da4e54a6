//! The cameras of a recording.

use adjustment::MountedCamera;
use sensors::CameraSensor;

/// Camera 0, whose poses are mapped, and the second camera of a stereo pair, if there is one; mounted on camera 0.
pub(super) fn mounted_cameras(sensors: &[CameraSensor]) -> Vec<MountedCamera> {
    let mounted = |sensor: &CameraSensor| {
        let camera_from_first = sensor.imu_from_camera.inverse() * sensors[0].imu_from_camera;
        MountedCamera::new(sensor.camera.clone(), &camera_from_first)
    };
    sensors.iter().map(mounted).collect()
}
