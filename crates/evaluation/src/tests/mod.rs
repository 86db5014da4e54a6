//! Laws of the evaluation, and figures of `evo` on the same files.

mod agreement;
mod consistency;
mod run;

use super::*;
use crate::trajectory::StampedPose;
use geometry::pose::Pose;
use nalgebra::{UnitQuaternion, Vector3};

const START_NS: i64 = 1_403_636_625_938_517_094;
const STEP_NS: i64 = 50_000_000;

fn rotation(x: f64, y: f64, z: f64) -> UnitQuaternion<f64> {
    UnitQuaternion::from_scaled_axis(Vector3::new(x, y, z))
}

/// A winding path, 20 poses a second.
fn reference() -> Vec<StampedPose> {
    (0..200)
        .map(|index| {
            let i = f64::from(index);
            let position =
                Vector3::new(5.0 * (0.05 * i).cos(), 4.0 * (0.07 * i).sin(), 0.01 * i + (0.11 * i).sin());
            let pose =
                Pose::new(rotation(0.3 * (0.05 * i).sin(), 0.2 * (0.03 * i).cos(), 0.04 * i), position);
            StampedPose { stamp_ns: START_NS + i64::from(index) * STEP_NS, pose }
        })
        .collect()
}

/// The same seen from another frame, with errors, gaps, and a clock 3 ms off.
fn estimate() -> Vec<StampedPose> {
    let frame = Pose::new(rotation(0.02, -0.01, 0.7), Vector3::new(10.0, -3.0, 1.0));
    let poses = reference().into_iter().enumerate().filter(|(index, _)| index % 7 != 3);
    poses
        .map(|(index, stamped)| {
            let i = index as f64;
            let error = Vector3::new(0.05 * (1.7 * i).sin(), 0.04 * (2.3 * i).cos(), 0.03 * (0.9 * i).sin());
            let turn = rotation(0.02 * i.sin(), 0.02 * (1.3 * i).cos(), 0.02 * (0.7 * i).sin());
            let wrong = Pose::new(stamped.pose.rotation * turn, stamped.pose.translation + error);
            StampedPose { stamp_ns: stamped.stamp_ns + 3_000_000, pose: frame.compose(&wrong) }
        })
        .collect()
}
