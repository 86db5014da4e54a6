//! A new version of the map in the middle of a run: its frame moves, and its keyframes may get other errors.
//!
//! G is the frame of the new version, so the truth does not change; only the filter's outputs after the change are scored.

use super::answers::{self, Answer};
use super::noisy_map::NoisyMap;
use super::{MonteCarloOptions, global_from_world};
use crate::random::{Purpose, normal3, stream};
use crate::{SimulatedWorld, SimulationOptions};
use estimator::{ChangeSize, MapRevision};
use geometry::{Pose, PoseWithCovariance, rotation};
use sensors::Frame;

/// How the map changes, and what the server states about it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapChangeOptions {
    /// Time of the change, seconds from the first image.
    pub at_s: f64,
    /// Standard deviation of the rotation of the map's frame about the robot's position, rad an axis.
    pub sigma_theta_rad: f64,
    /// Standard deviation of its translation, metres an axis.
    pub sigma_p_m: f64,
    /// Whether the keyframes get new errors, or keep theirs.
    pub new_errors: bool,
    /// Whether the server states these standard deviations, or zero.
    pub is_stated: bool,
}

/// The change of one seed.
pub(crate) struct MapChange {
    /// The first image after it.
    pub(crate) stamp_ns: i64,
    /// The notification of the server.
    pub(crate) revision: MapRevision,
}

/// The replies to all images of a run by the version of the map at that time, and the change.
pub(crate) fn answers_and_change(
    options: &MonteCarloOptions,
    simulation: &SimulationOptions,
    world: &SimulatedWorld,
    frames: &[Frame],
) -> (Vec<Option<Answer>>, Option<MapChange>) {
    let seed = simulation.seed;
    let by = |map: &NoisyMap| answers::to_frames(&options.answers, simulation, seed, world, map, frames);
    let map = NoisyMap::new(&options.map, simulation, 0, world);
    let first = by(&map);
    let at = |change: &MapChangeOptions| {
        frames.iter().position(|frame| (frame.stamp_ns - frames[0].stamp_ns) as f64 * 1e-9 >= change.at_s)
    };
    let Some((change, begin)) = options.map_change.and_then(|change| Some((change, at(&change)?))) else {
        return (first, None);
    };
    let mut rng = stream(seed, 0, Purpose::MapChange);
    let (turn, shift) = (normal3(&mut rng) * change.sigma_theta_rad, normal3(&mut rng) * change.sigma_p_m);
    let stamp_ns = frames[begin].stamp_ns;
    let robot = (global_from_world() * world.live_trajectory.at(stamp_ns).pose).translation;
    let turn = rotation::exp(&turn);
    let old_from_new = Pose::new(turn, robot + shift - turn * robot).inverse();
    let second =
        if change.new_errors { by(&NoisyMap::new(&options.map, simulation, 1, world)) } else { by(&map) };
    let before =
        first.into_iter().take(begin).map(|answer| answer.map(|answer| moved(answer, &old_from_new)));
    let after = second.into_iter().skip(begin).map(|answer| {
        answer.map(|mut answer| {
            answer.answer.map_version = 2;
            answer
        })
    });
    let scale = f64::from(u8::from(change.is_stated));
    let size = ChangeSize {
        sigma_rotation_rad: scale * change.sigma_theta_rad,
        sigma_position_m: scale * change.sigma_p_m,
    };
    let changed_keyframes = (0..map.keyframes.len() as u64).collect();
    let revision = MapRevision { from_version: 1, version: 2, changed_keyframes, size: Some(size) };
    (before.chain(after).collect(), Some(MapChange { stamp_ns, revision }))
}

/// A reply in the frame of the old version.
fn moved(mut answer: Answer, old_from_new: &Pose) -> Answer {
    for keyframe in &mut answer.answer.keyframes {
        let stated = &mut keyframe.global_from_keyframe;
        // Its covariance is isotropic, so a rotation does not change it.
        *stated = PoseWithCovariance::new(*old_from_new * stated.pose, stated.covariance);
    }
    let gravity = &mut answer.answer.gravity_in_global;
    *gravity = gravity.map(|direction| old_from_new.rotation * direction);
    answer
}
