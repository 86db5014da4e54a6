//! The cameras of a recording or a robot, as the estimator takes them.

use estimator::CalibratedCamera;
use sensors::CameraSensor;

/// The calibration of cameras: projection, mounting, shutter and delay.
pub fn calibrated_cameras(sensors: &[CameraSensor]) -> Vec<CalibratedCamera> {
    let calibrated = |sensor: &CameraSensor| CalibratedCamera {
        camera: sensor.camera.clone(),
        imu_from_camera: sensor.imu_from_camera,
        readout_s: sensor.readout_s,
        delay_s: sensor.delay_s(),
    };
    sensors.iter().map(calibrated).collect()
}
