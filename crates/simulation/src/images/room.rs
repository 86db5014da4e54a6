//! The room in which images are taken, its furniture, and what moves in it.
//!
//! Frame: the middle of the floor, z up. The flight ([`Scenario::Flight`](crate::Scenario::Flight)) stays within an ellipse of
//! 2.6 m x 2.1 m round the middle and above 1 m.

use geometry::{Pose, rotation};
use nalgebra::Vector3;
use rendering::{Body, PlacedBody};

/// The room: length, width, height, metres.
const ROOM_M: [f64; 3] = [9.0, 7.0, 3.2];
/// Furniture: position on the floor (m), yaw (rad), size (m). Along the walls, and a low table in the middle.
const FURNITURE: [([f64; 2], f64, [f64; 3]); 7] = [
    ([4.15, 1.4], 0.0, [0.6, 1.2, 1.9]),
    ([4.0, -2.2], 0.5, [0.6, 0.8, 1.1]),
    ([-4.1, -0.9], 0.1, [0.7, 1.0, 1.5]),
    ([-3.8, 2.7], 0.9, [0.7, 0.6, 2.3]),
    ([0.9, 3.1], -0.1, [1.4, 0.6, 1.0]),
    ([-1.6, -3.1], 0.05, [0.9, 0.5, 2.0]),
    ([0.1, 0.0], 0.3, [1.1, 0.7, 0.7]),
];
/// What moves: its size, the half axes of its path (m), and its angular rate (rad/s), against the flight's.
const OCCLUDER_M: [f64; 3] = [0.45, 0.35, 1.75];
const OCCLUDER_PATH_M: [f64; 2] = [3.25, 2.65];
const OCCLUDER_RATE: f64 = -0.4;

/// The room of one seed.
pub(super) struct FurnishedRoom {
    /// All that stands still.
    still: Vec<(Pose, Body)>,
    occluder: Body,
}

impl FurnishedRoom {
    pub(super) fn new(seed: u64) -> Self {
        let own_seed = |index: u64| seed.wrapping_mul(1_000).wrapping_add(index);
        let mut still = vec![(Pose::identity(), Body::room(ROOM_M, own_seed(0)))];
        for (index, ([x, y], yaw, size_m)) in (1..).zip(FURNITURE) {
            still.push((on_floor(x, y, yaw), Body::cuboid(size_m, own_seed(index))));
        }
        Self { still, occluder: Body::cuboid(OCCLUDER_M, own_seed(99)) }
    }

    /// The room some seconds after the start of a run.
    ///
    /// # Arguments
    /// * `occluder`: where its path begins, rad; `None` for a room in which nothing moves.
    pub(super) fn at(&self, seconds: f64, occluder: Option<f64>) -> Vec<PlacedBody<'_>> {
        let still = self.still.iter().map(|(pose, body)| PlacedBody { world_from_body: *pose, body });
        let moving = occluder.map(|phase| {
            let angle = OCCLUDER_RATE * seconds + phase;
            let [a, b] = OCCLUDER_PATH_M;
            let world_from_body = on_floor(a * angle.cos(), b * angle.sin(), 0.7 * angle);
            PlacedBody { world_from_body, body: &self.occluder }
        });
        still.chain(moving).collect()
    }
}

fn on_floor(x: f64, y: f64, yaw: f64) -> Pose {
    Pose::new(rotation::exp(&Vector3::new(0.0, 0.0, yaw)), Vector3::new(x, y, 0.0))
}
