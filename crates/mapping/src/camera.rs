//! The cameras of a recording and their poses.

use geometry::camera::Camera;
use geometry::pose::Pose;
use nalgebra::{Matrix3, Vector3};
use sensors::CameraSensor;

/// Largest depth of a landmark (m): beyond it, no keyframe of a map has measurable parallax.
pub(super) const MAX_DEPTH: f64 = 500.0;
/// Smallest depth (m): nearer than a robot's camera ever is to a surface.
pub(super) const MIN_DEPTH: f64 = 0.1;

/// A pose with its rotation as a matrix.
#[derive(Clone, Copy, Debug)]
pub(super) struct CameraPose {
    /// `global_from_camera`.
    pub(super) rotation: Matrix3<f64>,
    /// Centre of the camera in G (m).
    pub(super) position: Vector3<f64>,
}

impl From<&Pose> for CameraPose {
    fn from(pose: &Pose) -> Self {
        Self { rotation: pose.rotation.to_rotation_matrix().into_inner(), position: pose.translation }
    }
}

/// A camera with its extrinsics relative to camera 0: `p_camera = rotation p_first + offset` (m).
#[derive(Clone, Debug)]
pub(super) struct MappingCamera {
    /// The camera.
    pub(super) camera: Camera,
    /// Rotation from the frame of camera 0 to this one's.
    pub(super) rotation: Matrix3<f64>,
    /// Offset (m).
    pub(super) offset: Vector3<f64>,
}

impl MappingCamera {
    /// The cameras of a recording: camera 0, whose poses are mapped, and the second camera of a stereo pair, if there is
    /// one.
    pub(super) fn of_sensors(sensors: &[CameraSensor]) -> Vec<MappingCamera> {
        let mapping_camera = |sensor: &CameraSensor| {
            let camera_from_first = sensor.imu_from_camera.inverse() * sensors[0].imu_from_camera;
            let CameraPose { rotation, position } = CameraPose::from(&camera_from_first);
            MappingCamera { camera: sensor.camera.clone(), rotation, offset: position }
        };
        sensors.iter().map(mapping_camera).collect()
    }
}
