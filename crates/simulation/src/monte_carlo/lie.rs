//! A server that lies: from some time on its answers are of a map that was moved.

use super::answers::move_keyframes;
use super::global_from_world;
use estimator::MapAnswer;
use geometry::{Pose, rotation};
use nalgebra::Vector3;

/// Added to the ids of the keyframes of a lie, times the number of the lie: a robot keeps the pose of a keyframe that it
/// holds.
const LIE_ID: u64 = 1 << 33;

/// By how much the map is moved, horizontally, and from when on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lie {
    /// Begin, seconds.
    pub from_s: f64,
    /// Distance at once, metres.
    pub at_once_m: f64,
    /// Distance more with each answer, metres.
    pub each_m: f64,
    /// Angle about gravity and the place of the first lie, rad.
    pub yaw_rad: f64,
    /// As a new version of the map, which was not announced.
    pub new_version: bool,
}

impl Lie {
    /// A lie of nothing.
    pub const fn from(from_s: f64) -> Self {
        Self { from_s, at_once_m: 0.0, each_m: 0.0, yaw_rad: 0.0, new_version: false }
    }

    /// Moves the keyframes of an answer.
    ///
    /// # Arguments
    /// * `count`: lies before.
    /// * `pivot`: the place of the first lie.
    pub(super) fn tell(&self, answer: &mut MapAnswer, count: usize, pivot: &Vector3<f64>) {
        let upright = global_from_world();
        let aside = upright.rotation * Vector3::x() * (self.at_once_m + self.each_m * (count + 1) as f64);
        let turn =
            upright.rotation * rotation::exp(&(Vector3::z() * self.yaw_rad)) * upright.rotation.inverse();
        let moved =
            |pose: &Pose| Pose::new(turn * pose.rotation, pivot + aside + turn * (pose.translation - pivot));
        let lies = if self.each_m == 0.0 { 1 } else { count as u64 + 1 };
        move_keyframes(answer, moved, LIE_ID * lies);
        answer.map_version += u64::from(self.new_version);
    }
}
