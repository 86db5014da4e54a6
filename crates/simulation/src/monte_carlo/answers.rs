//! What the map says to the images of a run, as `map_server` would: keyframes by rank, landmarks in their anchors.
//!
//! The pixels of the image are drawn anew for each; those of the map are always the same. Wrong matches have a pixel from
//! anywhere in the image. A wrong place is the right answer turned about gravity and moved elsewhere: the geometry of the
//! place fits, only it is not the place, as with two floors of a building.

use super::noisy_map::NoisyMap;
use super::{AnswerOptions, global_from_world};
use crate::SimulatedWorld;
use crate::SimulationOptions;
use crate::random::{Purpose, normal, stream};
use crate::tracks::visible;
use estimator::{MapAnswer, MapKeyframe, MatchedLandmark};
use geometry::{Pose, PoseWithCovariance, rotation};
use nalgebra::{Vector2, Vector3};
use rand::RngExt;
use rand::rngs::StdRng;
use rand::seq::SliceRandom;
use sensors::Frame;
use std::collections::{BTreeMap, HashSet};
use std::f64::consts::TAU;

/// A keyframe of an answer has at least so many matches, as in `map_server`.
const MIN_MATCHES: usize = 8;
/// A wrong place is so far away, metres.
const ELSEWHERE_M: std::ops::Range<f64> = 10.0..60.0;
/// Keyframes of a wrong place have names of their own.
const ELSEWHERE_ID: u64 = 1 << 32;

/// An answer, and whether it is of another place.
pub(crate) struct Answer {
    pub(crate) answer: MapAnswer,
    pub(crate) is_wrong_place: bool,
}

/// The answers to all images of a run; `None` where the map was not asked or knows nothing.
pub(crate) fn to_frames(
    options: &AnswerOptions,
    simulation: &SimulationOptions,
    seed: u64,
    world: &SimulatedWorld,
    map: &NoisyMap,
    frames: &[Frame],
) -> Vec<Option<Answer>> {
    let mut rng = stream(seed, 1, Purpose::Answers);
    let every = (options.every_s * simulation.frame_rate_hz).round().max(1.0) as usize;
    let mut is_first = true;
    let answer_to = |(index, frame): (usize, &Frame)| {
        let seconds = index as f64 / simulation.frame_rate_hz;
        let is_asked = index > 0 && index.is_multiple_of(every);
        if !is_asked || options.gaps_s.iter().any(|gap| gap.contains(&seconds)) {
            return None;
        }
        let world_from_imu = world.live_way.at(frame.stamp_ns).pose;
        let mut answer = matched(options, simulation, &mut rng, world, map, &world_from_imu)?;
        spoil(&mut answer, options.wrong_matches, &mut rng, map);
        let is_wrong_place = rng.random_bool(options.wrong_place) && !is_first;
        is_first = false;
        if is_wrong_place {
            move_elsewhere(&mut answer, &mut rng);
        }
        Some(Answer { answer, is_wrong_place })
    };
    frames.iter().enumerate().map(answer_to).collect()
}

/// The right answer.
fn matched(
    options: &AnswerOptions,
    simulation: &SimulationOptions,
    rng: &mut StdRng,
    world: &SimulatedWorld,
    map: &NoisyMap,
    world_from_imu: &Pose,
) -> Option<MapAnswer> {
    let mut seen = visible(simulation, world_from_imu, &world.cameras[0], &world.landmarks);
    seen.retain(|(landmark, _)| {
        rng.random_bool(simulation.repeatability) && map.landmarks.contains_key(landmark)
    });
    seen.shuffle(rng);
    seen.truncate(options.max_matches);
    let noisy: Vec<(usize, Vector2<f64>)> = seen
        .into_iter()
        .map(|(landmark, exact)| {
            let noise = Vector2::new(normal(rng), normal(rng)) * simulation.sigma_feature_px;
            (landmark, exact + noise)
        })
        .filter(|(_, pixel)| map.camera.contains(pixel))
        .collect();
    let ranked = best_keyframes(map, &noisy, options.max_keyframes);
    if ranked.is_empty() {
        return None;
    }
    let mut used = HashSet::new();
    let mut landmarks = Vec::new();
    for &anchor in &ranked {
        let keyframe = &map.keyframes[anchor];
        for (landmark, pixel) in &noisy {
            if !keyframe.seen.contains_key(landmark) || !used.insert(*landmark) {
                continue;
            }
            let observations = ranked.iter().filter_map(|&observer| {
                Some((observer as u64, *map.keyframes[observer].seen.get(landmark)?))
            });
            landmarks.push(MatchedLandmark {
                pixel: *pixel,
                anchor: anchor as u64,
                position_in_anchor: map.position_in(anchor, *landmark),
                observations: observations.collect(),
            });
        }
    }
    let keyframes = ranked.iter().map(|&keyframe| MapKeyframe {
        id: keyframe as u64,
        global_from_keyframe: map.keyframes[keyframe].stated,
        camera: map.camera.clone(),
        cross_covariances: Vec::new(),
    });
    Some(MapAnswer {
        map_version: 1,
        keyframes: keyframes.collect(),
        held_at_query: Vec::new(),
        landmarks,
        gravity_in_global: Some(global_from_world().rotation * -Vector3::z()),
        sigma_map_px: map.sigma_px,
    })
}

/// Keyframes that saw most of what the image sees, best first.
fn best_keyframes(map: &NoisyMap, seen: &[(usize, Vector2<f64>)], count: usize) -> Vec<usize> {
    let mut votes: BTreeMap<usize, usize> = BTreeMap::new();
    for (landmark, _) in seen {
        for &keyframe in &map.observers[landmark] {
            *votes.entry(keyframe).or_default() += 1;
        }
    }
    let mut ranked: Vec<(usize, usize)> =
        votes.into_iter().filter(|(_, votes)| *votes >= MIN_MATCHES).collect();
    ranked.sort_by_key(|(keyframe, votes)| (std::cmp::Reverse(*votes), *keyframe));
    ranked.into_iter().take(count.max(1)).map(|(keyframe, _)| keyframe).collect()
}

/// Matches some features with the wrong landmark.
fn spoil(answer: &mut MapAnswer, fraction: f64, rng: &mut StdRng, map: &NoisyMap) {
    let (width, height) = (f64::from(map.camera.width), f64::from(map.camera.height));
    for landmark in &mut answer.landmarks {
        if rng.random_bool(fraction) {
            landmark.pixel =
                Vector2::new(rng.random_range(0.0..width - 1.0), rng.random_range(0.0..height - 1.0));
        }
    }
}

/// Turns an answer about gravity and moves it: another place that looks the same.
fn move_elsewhere(answer: &mut MapAnswer, rng: &mut StdRng) {
    let (turn, bearing) = (rng.random_range(0.0..TAU), rng.random_range(0.0..TAU));
    let far = rng.random_range(ELSEWHERE_M);
    let here = answer.keyframes[0].global_from_keyframe.pose.translation;
    let upright = global_from_world();
    let aside = upright.rotation * Vector3::new(bearing.cos(), bearing.sin(), 0.0) * far;
    let turned = upright.rotation * rotation::exp(&(Vector3::z() * turn)) * upright.rotation.inverse();
    let moved =
        |pose: &Pose| Pose::new(turned * pose.rotation, here + aside + turned * (pose.translation - here));
    for keyframe in &mut answer.keyframes {
        keyframe.id += ELSEWHERE_ID;
        let stated = keyframe.global_from_keyframe;
        // Its covariance is the same in every direction, so that turning leaves it as it is.
        keyframe.global_from_keyframe = PoseWithCovariance::new(moved(&stated.pose), stated.covariance);
    }
    for landmark in &mut answer.landmarks {
        landmark.anchor += ELSEWHERE_ID;
        landmark.observations.iter_mut().for_each(|(keyframe, _)| *keyframe += ELSEWHERE_ID);
    }
}
