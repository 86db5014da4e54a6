//! The cameras of the simulated robot: a forward-looking stereo pair, and one that looks back.

use geometry::camera::{Camera, Distortion};
use geometry::pose::Pose;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use sensors::CameraSensor;
use std::f64::consts::PI;

/// Distance between the two cameras, metres: EuRoC's.
const BASELINE: f64 = 0.11;

/// The stereo pair, left camera first; both have the intrinsics of EuRoC's first camera.
///
/// # Arguments
/// * `readout_s`: of their rolling shutters, seconds; 0 for global ones.
/// * `second_delay_s`: time of the second camera's images after those of the first, seconds.
pub(crate) fn stereo(rate_hz: f64, readout_s: f64, second_delay_s: f64) -> Vec<CameraSensor> {
    let camera = Camera {
        width: 752,
        height: 480,
        focal: [458.654, 457.296],
        centre: [367.215, 248.375],
        distortion: Distortion::RadialTangential([
            -0.283_408_11,
            0.073_959_07,
            0.000_193_59,
            1.761_871_14e-5,
        ]),
    };
    // Body: x forward, y left, z up. Camera: x right, y down, z forward.
    let axes = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    [(BASELINE / 2.0, 0.0), (-BASELINE / 2.0, second_delay_s)]
        .into_iter()
        .map(|(left, time_shift_s)| {
            let mounted = Pose::new(rotation, Vector3::new(0.08, left, 0.03));
            CameraSensor { readout_s, time_shift_s, ..CameraSensor::new(camera.clone(), mounted, rate_hz) }
        })
        .collect()
}

/// A camera as the left one of the pair, which looks back from behind the body.
pub(crate) fn rear(left: &CameraSensor) -> CameraSensor {
    let turned = Pose::new(UnitQuaternion::from_axis_angle(&Vector3::z_axis(), PI), Vector3::zeros());
    CameraSensor { imu_from_camera: turned * left.imu_from_camera, time_shift_s: 0.0, ..left.clone() }
}
