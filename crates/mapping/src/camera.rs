//! The cameras of a recording.

use adjustment::MountedCamera;
use sensors::{CameraSensor, camera_groups};

/// Camera 0, whose poses are mapped, and camera 1 where both are a stereo pair; mounted on camera 0.
pub(super) fn mounted_cameras(sensors: &[CameraSensor]) -> Vec<MountedCamera> {
    let mounted = |sensor: &CameraSensor| {
        let camera_from_first = sensor.imu_from_camera.inverse() * sensors[0].imu_from_camera;
        MountedCamera::new(sensor.camera.clone(), &camera_from_first)
    };
    let used = if is_stereo(sensors) { 2 } else { 1 };
    sensors.iter().take(used).map(mounted).collect()
}

/// Whether cameras 0 and 1 are a stereo pair.
pub(super) fn is_stereo(sensors: &[CameraSensor]) -> bool {
    camera_groups(sensors).first().is_some_and(|group| (group.first, group.second) == (0, Some(1)))
}
