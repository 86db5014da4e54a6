//! Cameras on a body, and poses of the body, with rotations as matrices.

use geometry::camera::Camera;
use geometry::pose::Pose;
use nalgebra::{Matrix3, Vector3};

/// Largest depth of a landmark of a map (m): beyond it, no keyframe of a map has measurable parallax.
pub const MAX_DEPTH: f64 = 500.0;
/// Smallest depth (m): nearer than a robot's camera ever is to a surface.
pub const MIN_DEPTH: f64 = 0.1;

/// The pose of a view, with its rotation as a matrix.
#[derive(Clone, Copy, Debug)]
pub struct ViewPose {
    /// Rotation of `global_from_body`.
    pub rotation: Matrix3<f64>,
    /// Origin of the body in G (m).
    pub position: Vector3<f64>,
}

impl From<&Pose> for ViewPose {
    fn from(pose: &Pose) -> Self {
        Self { rotation: pose.rotation.to_rotation_matrix().into_inner(), position: pose.translation }
    }
}

/// A camera on a body: `p_camera = rotation p_body + offset` (m).
#[derive(Clone, Debug)]
pub struct MountedCamera {
    /// The camera.
    pub camera: Camera,
    /// Rotation from the frame of the body to that of the camera.
    pub rotation: Matrix3<f64>,
    /// Offset (m).
    pub offset: Vector3<f64>,
    /// Landmarks nearer than this are not visible (m).
    pub least_depth: f64,
}

impl MountedCamera {
    /// A camera at a pose on the body, which sees from [`MIN_DEPTH`] on.
    pub fn new(camera: Camera, camera_from_body: &Pose) -> MountedCamera {
        let ViewPose { rotation, position } = ViewPose::from(camera_from_body);
        MountedCamera { camera, rotation, offset: position, least_depth: MIN_DEPTH }
    }

    /// The same camera where the scale is not known yet, and with it no least depth.
    #[must_use]
    pub fn at_any_scale(self) -> MountedCamera {
        MountedCamera { least_depth: 0.0, ..self }
    }
}
