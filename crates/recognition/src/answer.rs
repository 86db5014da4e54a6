//! From a recognized place to the replies of a match query.
//!
//! # Rules of an answer
//! 1. Keyframes are sent by rank: the verified ones by inliers, then covisible ones (keyframes that observe the
//!    matched landmarks, with no matches of their own), never more than the query asks for.
//! 2. A query feature appears at most once in the whole answer, and so does a landmark: in the best-ranked keyframe
//!    that matched it.
//! 3. **The anchor of every landmark is a keyframe of the answer that observed it.** Where the map's own anchor is
//!    in the answer, it is kept. Otherwise the landmark is anchored anew in the keyframe that matched it: at the
//!    depth that the map poses give, on the ray of that keyframe's own pixel. So no keyframe is ever sent only
//!    because something is anchored in it, and a robot needs nothing but the answer.
//! 4. Observations are listed for keyframes of the answer and for those that the robot holds.
//! 5. Cross-covariances are sent towards held keyframes and towards those of smaller rank.

use std::collections::HashSet;

use protocol::{
    CrossCovarianceBlock, KeyframeId, KeyframePixel, KeyframeRecord, LandmarkMatch, MatchedKeyframe,
};

use super::index::tally;
use super::loaded_map::{LoadedKeyframe, LoadedMap};
use super::options::RecognitionOptions;
use super::verify::Verified;

/// The keyframes of an answer, best first.
///
/// # Arguments
/// * `place`: verified keyframes of one place, most inliers first; not empty.
/// * `max_keyframes`: how many keyframes are asked for, at least 1.
/// * `held`: keyframes that the robot holds already.
pub(crate) fn matched_keyframes(
    map: &LoadedMap,
    place: &[Verified],
    max_keyframes: usize,
    held: &[KeyframeId],
    options: &RecognitionOptions,
) -> Vec<MatchedKeyframe> {
    let count = max_keyframes.clamp(1, options.max_keyframes);
    let verified = &place[..place.len().min(count)];
    let mut sent: Vec<usize> = verified.iter().map(|verified| verified.keyframe).collect();
    sent.extend(covisible(map, verified, options.min_covisible).take(count - sent.len()));

    let held: HashSet<KeyframeId> =
        held.iter().copied().filter(|&id| map.position_of(id).is_some()).collect();
    let mut used = Used::default();
    let replies = sent.iter().enumerate().map(|(rank, &keyframe)| {
        let matches =
            verified.get(rank).map(|verified| landmark_matches(map, verified, &sent, &held, &mut used));
        MatchedKeyframe {
            map_version: map.info.version,
            rank: rank as u16,
            keyframe: record(&map.keyframes[keyframe]),
            cross_covariances: cross_covariances(map, keyframe, &sent[..rank], &held),
            matches: matches.unwrap_or_default(),
        }
    });
    replies.collect()
}

/// Keyframes beyond the verified ones that observe the matched landmarks, those that observe most first.
fn covisible(map: &LoadedMap, verified: &[Verified], min_covisible: usize) -> impl Iterator<Item = usize> {
    let landmarks: HashSet<usize> = verified
        .iter()
        .flat_map(|verified| {
            let seen = &map.keyframes[verified.keyframe].seen;
            verified.inliers.iter().map(|inlier| seen[inlier.train].landmark)
        })
        .collect();
    let observers = landmarks.iter().flat_map(|&landmark| &map.landmarks[landmark].observations);
    let own: HashSet<usize> = verified.iter().map(|verified| verified.keyframe).collect();
    let counts = tally(observers.map(|&(keyframe, _)| keyframe).filter(|keyframe| !own.contains(keyframe)));
    counts.into_iter().filter(move |&(_, count)| count >= min_covisible).map(|(keyframe, _)| keyframe)
}

/// What earlier ranks of an answer have taken.
#[derive(Default)]
struct Used {
    features: HashSet<usize>,
    landmarks: HashSet<usize>,
}

fn landmark_matches(
    map: &LoadedMap,
    verified: &Verified,
    sent: &[usize],
    held: &HashSet<KeyframeId>,
    used: &mut Used,
) -> Vec<LandmarkMatch> {
    let id_of = |keyframe: usize| map.keyframes[keyframe].keyframe.id;
    let seen = &map.keyframes[verified.keyframe].seen;
    let mut matches = Vec::with_capacity(verified.inliers.len());
    for inlier in &verified.inliers {
        let seen = &seen[inlier.train];
        if used.features.contains(&inlier.query) || used.landmarks.contains(&seen.landmark) {
            continue;
        }
        used.features.insert(inlier.query);
        used.landmarks.insert(seen.landmark);
        let landmark = &map.landmarks[seen.landmark];
        let (anchor, position) = if sent.contains(&landmark.anchor) {
            (landmark.anchor, landmark.position_in_anchor)
        } else {
            (verified.keyframe, seen.point)
        };
        let listed = |keyframe: usize| sent.contains(&keyframe) || held.contains(&id_of(keyframe));
        let observations = landmark.observations.iter().filter(|&&(keyframe, _)| listed(keyframe));
        matches.push(LandmarkMatch {
            feature: inlier.query as u32,
            landmark: landmark.id,
            anchor: id_of(anchor),
            position_in_anchor: position.into(),
            distance: inlier.distance.max(0.0),
            observations: observations
                .map(|&(keyframe, pixel)| KeyframePixel { keyframe: id_of(keyframe), pixel })
                .collect(),
        });
    }
    matches
}

fn cross_covariances(
    map: &LoadedMap,
    keyframe: usize,
    smaller_ranks: &[usize],
    held: &HashSet<KeyframeId>,
) -> Vec<CrossCovarianceBlock> {
    let id = map.keyframes[keyframe].keyframe.id;
    let mut others: Vec<KeyframeId> = smaller_ranks.iter().map(|&at| map.keyframes[at].keyframe.id).collect();
    others.extend(held);
    others.sort_unstable();
    others.dedup();
    let blocks = others.into_iter().filter(|&other| other != id).filter_map(|other| {
        let block = map.cross_covariance(id, other)?;
        Some(CrossCovarianceBlock { other, block })
    });
    blocks.collect()
}

/// A keyframe as it is sent.
pub(crate) fn record(loaded: &LoadedKeyframe) -> KeyframeRecord {
    let keyframe = &loaded.keyframe;
    KeyframeRecord {
        id: keyframe.id,
        stamp_ns: keyframe.stamp_ns,
        global_from_keyframe: keyframe.global_from_keyframe,
        camera: keyframe.camera.clone(),
    }
}
