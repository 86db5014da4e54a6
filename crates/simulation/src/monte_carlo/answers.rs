//! The map's replies to the images of a run, as `map_server` would give them: ranked keyframes, landmarks in their anchors.
//!
//! The noise of the image's pixels is sampled for each image, that of the map's once. A wrong match has a random pixel. A
//! wrong place is the right reply rotated about gravity and moved: its geometry is consistent, but it is another place, as
//! with two floors of a building.

use super::noisy_map::NoisyMap;
use super::{AnswerOptions, global_from_world};
use crate::SimulatedWorld;
use crate::SimulationOptions;
use crate::exposure::Exposure;
use crate::random::{Purpose, normal, stream};
use crate::tracks::visible;
use estimator::{MapAnswer, MapKeyframe, MatchedLandmark};
use geometry::{Pose, PoseWithCovariance, rotation};
use nalgebra::{Matrix6xX, Vector2, Vector3};
use rand::RngExt;
use rand::rngs::StdRng;
use rand::seq::SliceRandom;
use sensors::Frame;
use std::collections::{BTreeMap, HashSet};
use std::f64::consts::TAU;

/// Least matches of a keyframe in a reply, as in `map_server`.
const MIN_MATCHES: usize = 8;
/// Distance of a wrong place, metres.
const WRONG_PLACE_M: std::ops::Range<f64> = 10.0..60.0;
/// Of a place that does not repeat, all of whose landmarks in view are matched: half of the image confirmed.
const DISTINCTIVE_LOG_ODDS: f64 = 5.0;
/// Added to the ids of keyframes of a wrong place.
const WRONG_PLACE_ID: u64 = 1 << 32;

/// A reply, and whether it is of another place.
pub(crate) struct Answer {
    pub(crate) answer: MapAnswer,
    pub(crate) is_wrong_place: bool,
}

/// The replies to all images of a run; `None` where the map was not queried or has no match.
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
    let mut lies: Option<(usize, Vector3<f64>)> = None;
    let answer_to = |(index, frame): (usize, &Frame)| {
        let seconds = index as f64 / simulation.frame_rate_hz;
        let is_queried = index > 0 && index.is_multiple_of(every);
        if !is_queried || options.gaps_s.iter().any(|gap| gap.contains(&seconds)) {
            return None;
        }
        let exposure = Exposure::of(&world.live_trajectory, frame.stamp_ns);
        let mut answer = matched(options, simulation, &mut rng, world, map, &exposure)?;
        add_wrong_matches(&mut answer, options.wrong_matches, &mut rng, map);
        let is_wrong_place = rng.random_bool(options.wrong_place) && !is_first;
        is_first = false;
        if is_wrong_place {
            move_to_wrong_place(&mut answer, &mut rng);
        }
        if let Some(lie) = options.lie.filter(|lie| seconds >= lie.from_s) {
            let (count, pivot) =
                lies.unwrap_or((0, answer.keyframes[0].global_from_keyframe.pose.translation));
            lie.tell(&mut answer, count, &pivot);
            lies = Some((count + 1, pivot));
        }
        Some(Answer { answer, is_wrong_place })
    };
    frames.iter().enumerate().map(answer_to).collect()
}

/// The right reply.
fn matched(
    options: &AnswerOptions,
    simulation: &SimulationOptions,
    rng: &mut StdRng,
    world: &SimulatedWorld,
    map: &NoisyMap,
    exposure: &Exposure<'_>,
) -> Option<MapAnswer> {
    let mut seen = visible(simulation, exposure, &world.cameras[0], &world.landmarks);
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
        common_error: Matrix6xX::zeros(0),
        cross_covariances: Vec::new(),
    });
    Some(MapAnswer {
        map_version: 1,
        map_identity: 1,
        camera: 0,
        keyframes: keyframes.collect(),
        held_at_query: Vec::new(),
        landmarks,
        gravity_in_global: Some(global_from_world().rotation * -Vector3::z()),
        sigma_map_px: options.stated_sigma_px,
        log_odds: DISTINCTIVE_LOG_ODDS,
        log_prior_odds: 0.0,
    })
}

/// Keyframes by the number of landmarks that they share with the image, best first.
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

/// Replaces the pixels of some matches by random ones.
fn add_wrong_matches(answer: &mut MapAnswer, fraction: f64, rng: &mut StdRng, map: &NoisyMap) {
    let (width, height) = (f64::from(map.camera.width), f64::from(map.camera.height));
    for landmark in &mut answer.landmarks {
        if rng.random_bool(fraction) {
            landmark.pixel =
                Vector2::new(rng.random_range(0.0..width - 1.0), rng.random_range(0.0..height - 1.0));
        }
    }
}

/// Rotates a reply about gravity and moves it: another place that looks the same.
fn move_to_wrong_place(answer: &mut MapAnswer, rng: &mut StdRng) {
    let (turn, bearing) = (rng.random_range(0.0..TAU), rng.random_range(0.0..TAU));
    let far = rng.random_range(WRONG_PLACE_M);
    let here = answer.keyframes[0].global_from_keyframe.pose.translation;
    let upright = global_from_world();
    let aside = upright.rotation * Vector3::new(bearing.cos(), bearing.sin(), 0.0) * far;
    let turned = upright.rotation * rotation::exp(&(Vector3::z() * turn)) * upright.rotation.inverse();
    let moved =
        |pose: &Pose| Pose::new(turned * pose.rotation, here + aside + turned * (pose.translation - here));
    move_keyframes(answer, moved, WRONG_PLACE_ID);
}

/// Moves the keyframes of a reply, which become others.
pub(super) fn move_keyframes(answer: &mut MapAnswer, moved: impl Fn(&Pose) -> Pose, new_id: u64) {
    for keyframe in &mut answer.keyframes {
        keyframe.id += new_id;
        let stated = keyframe.global_from_keyframe;
        // Its covariance is isotropic, so a rotation does not change it.
        keyframe.global_from_keyframe = PoseWithCovariance::new(moved(&stated.pose), stated.covariance);
    }
    for landmark in &mut answer.landmarks {
        landmark.anchor += new_id;
        landmark.observations.iter_mut().for_each(|(keyframe, _)| *keyframe += new_id);
    }
}
