//! Where a camera is and where it looks.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::pose::Pose;

/// Where a camera is and where it looks: what tells whether two cameras may see the same.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Viewpoint {
    /// In G (m).
    pub position: Vector3<f64>,
    /// The optical axis in G, a unit vector.
    pub axis: Vector3<f64>,
}

impl Viewpoint {
    /// Of a camera at a pose.
    pub fn of(global_from_camera: &Pose) -> Self {
        let axis = global_from_camera.rotation * Vector3::z();
        Self { position: global_from_camera.translation, axis }
    }
}
