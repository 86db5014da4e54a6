//! The truth in the frame of a map that was built without reference poses.

use super::alignment::{Alignment, PositionSums};
use geometry::pose::Pose;
use nalgebra::{UnitQuaternion, Vector3};
use sensors::TruthRow;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Where the truth's frame lies in a map whose frame is its own: aligned in yaw and position.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MapFromTruth {
    /// Position of the truth's origin in the map, metres.
    pub position_m: [f64; 3],
    /// Rotation, Hamilton, w first.
    pub rotation_wxyz: [f64; 4],
    /// Direction of gravity in the map, unit vector.
    pub gravity_in_map: [f64; 3],
}

impl MapFromTruth {
    /// The alignment of pairs of position in the map and position in the truth; `None` without any.
    pub(super) fn of(
        positions: &PositionSums,
        gravity_in_map: Vector3<f64>,
        gravity_in_truth: Vector3<f64>,
    ) -> Option<Self> {
        let yaw =
            Alignment::Yaw { gravity_in_reference: gravity_in_map, gravity_in_estimate: gravity_in_truth };
        let pose = positions.align(&yaw).ok()?;
        let q = pose.rotation.quaternion();
        Some(Self {
            position_m: pose.translation.into(),
            rotation_wxyz: [q.w, q.i, q.j, q.k],
            gravity_in_map: gravity_in_map.into(),
        })
    }

    /// The transformation from the truth's frame to the map's.
    pub fn pose(&self) -> Pose {
        let [w, x, y, z] = self.rotation_wxyz;
        let rotation = UnitQuaternion::new_normalize(nalgebra::Quaternion::new(w, x, y, z));
        Pose::new(rotation, self.position_m.into())
    }

    /// Direction of gravity in the map.
    pub fn gravity(&self) -> Vector3<f64> {
        self.gravity_in_map.into()
    }

    /// Truth in the map's frame.
    pub fn apply(&self, row: &TruthRow) -> TruthRow {
        let pose = self.pose();
        TruthRow {
            pose: pose.compose(&row.pose),
            velocity: row.velocity.map(|velocity| pose.rotation * velocity),
            ..*row
        }
    }
}

impl fmt::Display for MapFromTruth {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let pose = self.pose();
        let (degrees, metres) = (pose.rotation.angle().to_degrees(), pose.translation.norm());
        write!(
            formatter,
            "the map was built without poses, so its frame is not the truth's: the truth is aligned with it in yaw and position \
             ({degrees:.1} deg, {metres:.2} m). That removes the constant part of the errors in the map, which therefore have no NEES: \
             `driftless bench` gives it, in a map that lies in the frame of its recording's truth"
        )
    }
}
