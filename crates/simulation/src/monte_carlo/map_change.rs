//! A new version of the map in the middle of a run: its frame moves, and its keyframes may get other errors.
//!
//! G is the frame of the new version, so the truth does not change; only the filter's outputs after the change are scored.

use super::answers::{self, Answer};
use super::noisy_map::NoisyMap;
use super::{MonteCarloOptions, global_from_world};
use crate::random::{Purpose, normal3, stream};
use crate::{SimulatedWorld, SimulationOptions};
use estimator::{ChangeSize, KeyframeMotion, MapRevision};
use geometry::{Pose, PoseWithCovariance, rotation};
use nalgebra::Vector6;
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
    /// Which keyframes move.
    pub part: MovedPart,
    /// Whether the keyframes get new errors, or keep theirs.
    pub new_errors: bool,
    /// What the server states.
    pub statement: ChangeStatement,
}

/// The part of a map that moves, by distances in metres from the robot at the time of the change.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MovedPart {
    /// All of it.
    All,
    /// The keyframes that are nearer.
    Within(f64),
    /// The keyframes that are farther away.
    Beyond(f64),
}

impl MovedPart {
    fn contains(self, distance_m: f64) -> bool {
        match self {
            Self::All => true,
            Self::Within(most) => distance_m < most,
            Self::Beyond(least) => distance_m >= least,
        }
    }
}

/// What a server states of a change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ChangeStatement {
    /// That nothing moved.
    Nothing,
    /// One size for the whole map: the standard deviations that the motion is drawn from, which are those at the robot's place.
    Drawn,
    /// One size for the whole map: the root mean square of the motions of its keyframes.
    Size,
    /// That size, and the motion of each keyframe.
    Keyframes,
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
    let now = if change.new_errors { NoisyMap::new(&options.map, simulation, 1, world) } else { map.clone() };
    let second = by(&now);
    let is_moved: Vec<bool> = map
        .keyframes
        .iter()
        .map(|keyframe| change.part.contains((keyframe.stated.pose.translation - robot).norm()))
        .collect();
    let motions: Vec<Vector6<f64>> = std::iter::zip(&map.keyframes, &now.keyframes)
        .zip(&is_moved)
        .map(|((before, now), is_moved)| {
            let before = before.stated.pose;
            let before = if *is_moved { old_from_new * before } else { before };
            before.local(&now.stated.pose)
        })
        .collect();
    let before = first
        .into_iter()
        .take(begin)
        .map(|answer| answer.map(|answer| moved(answer, &old_from_new, &is_moved)));
    let after = second.into_iter().skip(begin).map(|answer| {
        answer.map(|mut answer| {
            answer.answer.map_version = 2;
            answer
        })
    });
    let answers = before.chain(after).collect();
    (answers, Some(MapChange { stamp_ns, revision: revision(&change, &motions) }))
}

/// The notification of the server.
fn revision(change: &MapChangeOptions, motions: &[Vector6<f64>]) -> MapRevision {
    let per_axis = |first: usize| {
        let squares = motions.iter().map(|motion| motion.fixed_rows::<3>(first).norm_squared());
        (squares.sum::<f64>() / (3 * motions.len()) as f64).sqrt()
    };
    let [sigma_rotation_rad, sigma_position_m] = match change.statement {
        ChangeStatement::Nothing => [0.0; 2],
        ChangeStatement::Drawn => [change.sigma_theta_rad, change.sigma_p_m],
        ChangeStatement::Size | ChangeStatement::Keyframes => [per_axis(0), per_axis(3)],
    };
    let size = ChangeSize { sigma_rotation_rad, sigma_position_m };
    let changed = || (0_u64..).zip(motions).filter(|(_, motion)| motion.amax() > 0.0);
    let told = |(id, motion): (u64, &Vector6<f64>)| KeyframeMotion { id, motion: *motion };
    MapRevision {
        from_version: 1,
        version: 2,
        changed_keyframes: changed().map(|(id, _)| id).collect(),
        size: Some(size),
        keyframe_motions: if change.statement == ChangeStatement::Keyframes {
            changed().map(told).collect()
        } else {
            Vec::new()
        },
    }
}

/// A reply in the frame of the old version.
fn moved(mut answer: Answer, old_from_new: &Pose, is_moved: &[bool]) -> Answer {
    for keyframe in answer.answer.keyframes.iter_mut().filter(|keyframe| is_moved[keyframe.id as usize]) {
        let stated = &mut keyframe.global_from_keyframe;
        // Its covariance is isotropic, so a rotation does not change it.
        *stated = PoseWithCovariance::new(*old_from_new * stated.pose, stated.covariance);
    }
    if is_moved.contains(&false) {
        return answer;
    }
    let gravity = &mut answer.answer.gravity_in_global;
    *gravity = gravity.map(|direction| old_from_new.rotation * direction);
    answer
}
