//! From a recognized place to the replies of a match query.
//!
//! # Rules of an answer
//! 1. Keyframes are sent by rank: the verified ones by inliers, then covisible ones (keyframes that observe the
//!    matched landmarks, with no matches of their own), never more than the query asks for.
//! 2. A query feature appears at most once in the whole answer, and so does a landmark: in the best-ranked keyframe
//!    that matched it.
//! 3. **The anchor of every landmark is a keyframe of the answer that observed it.** Where the map's own anchor is
//!    in the answer, it is kept. Otherwise the landmark is re-anchored in the keyframe that matched it: at the
//!    depth that the map poses give, on the ray of that keyframe's own pixel. So no keyframe is ever sent only
//!    as an anchor, and a robot needs nothing but the answer.
//! 4. Observations are listed for keyframes of the answer and for those that the robot holds.
//! 5. Cross-covariances are sent towards held keyframes and towards those of smaller rank, and the common error of each.
//!    What the robot knows already, the common errors of held keyframes and the correlations among them, is left out.

use std::collections::{HashMap, HashSet};

use protocol::{
    CrossCovarianceBlock, KeyframeId, KeyframePixel, KeyframeRecord, LandmarkMatch, MatchedKeyframe,
};

use map::model::{CommonError, Keyframe};

use super::loaded_map::LoadedMap;
use super::options::RecognitionOptions;
use super::verification::VerifiedKeyframe;

/// The keyframes of an answer, best first.
///
/// # Arguments
/// * `place`: verified keyframes of one place, most inliers first; not empty.
/// * `max_keyframes`: how many keyframes are asked for, at least 1.
/// * `held`: keyframes that the robot holds already.
/// * `knows_held`: whether it holds them as they are in this version of the map.
pub(crate) fn matched_keyframes(
    map: &LoadedMap,
    place: &[VerifiedKeyframe],
    max_keyframes: usize,
    held: &[KeyframeId],
    knows_held: bool,
    options: &RecognitionOptions,
) -> Vec<MatchedKeyframe> {
    let count = max_keyframes.clamp(1, options.max_keyframes);
    let verified = &place[..place.len().min(count)];
    let mut sent: Vec<usize> = verified.iter().map(|verified| verified.keyframe).collect();
    sent.extend(covisible(map, verified, options.min_covisible).take(count - sent.len()));

    // Those that the map does not have may still be correlated with some of it, where it is a part of a map.
    let held: HashSet<KeyframeId> = held.iter().copied().collect();
    let mut taken = TakenMatches::default();
    let replies = sent.iter().enumerate().map(|(rank, &keyframe)| {
        let matches =
            verified.get(rank).map(|verified| landmark_matches(map, verified, &sent, &held, &mut taken));
        let id = map.poses.keyframes[keyframe].id;
        let is_known = knows_held && held.contains(&id);
        let common = if is_known { None } else { map.common_error(id) };
        MatchedKeyframe {
            map_version: map.info.version,
            map_identity: map.identity,
            rank: rank as u16,
            keyframe: record(&map.poses.keyframes[keyframe]),
            common_error: common.map(CommonError::columns).unwrap_or_default(),
            cross_covariances: cross_covariances(map, id, &sent[..rank], &held, is_known),
            matches: matches.unwrap_or_default(),
        }
    });
    replies.collect()
}

/// Keyframes beyond the verified ones that observe the matched landmarks, those that observe most first.
fn covisible(
    map: &LoadedMap,
    verified: &[VerifiedKeyframe],
    min_covisible: usize,
) -> impl Iterator<Item = usize> {
    let landmarks: HashSet<usize> = verified
        .iter()
        .flat_map(|verified| {
            let observed = map.observations.of(verified.keyframe);
            verified.inliers.iter().map(move |inlier| observed.landmark(inlier.train))
        })
        .collect();
    let observers = landmarks.iter().flat_map(|&landmark| map.landmarks.observers.of(landmark));
    let own: HashSet<usize> = verified.iter().map(|verified| verified.keyframe).collect();
    let counts = count_occurrences(
        observers.map(|&keyframe| keyframe as usize).filter(|keyframe| !own.contains(keyframe)),
    );
    counts.into_iter().filter(move |&(_, count)| count >= min_covisible).map(|(keyframe, _)| keyframe)
}

/// Features and landmarks that keyframes of smaller rank have in their matches.
#[derive(Default)]
struct TakenMatches {
    features: HashSet<usize>,
    landmarks: HashSet<usize>,
}

fn landmark_matches(
    map: &LoadedMap,
    verified: &VerifiedKeyframe,
    sent: &[usize],
    held: &HashSet<KeyframeId>,
    taken: &mut TakenMatches,
) -> Vec<LandmarkMatch> {
    let id_of = |keyframe: usize| map.poses.keyframes[keyframe].id;
    let observed = map.observations.of(verified.keyframe);
    let mut matches = Vec::with_capacity(verified.inliers.len());
    for inlier in &verified.inliers {
        let landmark = observed.landmark(inlier.train);
        if taken.features.contains(&inlier.query) || taken.landmarks.contains(&landmark) {
            continue;
        }
        taken.features.insert(inlier.query);
        taken.landmarks.insert(landmark);
        let own_anchor = map.landmarks.anchors[landmark] as usize;
        let (anchor, position) = if sent.contains(&own_anchor) {
            (own_anchor, map.landmarks.positions_in_anchor[landmark])
        } else {
            (verified.keyframe, map.observed_point(verified.keyframe, inlier.train))
        };
        let observers = map.landmarks.observers.of(landmark).iter().map(|&keyframe| keyframe as usize);
        let listed = observers.filter(|keyframe| sent.contains(keyframe) || held.contains(&id_of(*keyframe)));
        let observations = listed.filter_map(|keyframe| {
            let pixel = map.observations.of(keyframe).pixel_of(landmark)?;
            Some(KeyframePixel { keyframe: id_of(keyframe), pixel })
        });
        matches.push(LandmarkMatch {
            feature: inlier.query as u32,
            landmark: map.landmarks.ids[landmark],
            anchor: id_of(anchor),
            position_in_anchor: position.into(),
            distance: inlier.distance.max(0.0),
            observations: observations.collect(),
        });
    }
    matches
}

/// # Arguments
/// * `is_known`: the robot knows how it is correlated with the held keyframes.
fn cross_covariances(
    map: &LoadedMap,
    id: KeyframeId,
    smaller_ranks: &[usize],
    held: &HashSet<KeyframeId>,
    is_known: bool,
) -> Vec<CrossCovarianceBlock> {
    let smaller: Vec<KeyframeId> = smaller_ranks.iter().map(|&at| map.poses.keyframes[at].id).collect();
    let wanted = |other: KeyframeId| if held.contains(&other) { !is_known } else { smaller.contains(&other) };
    // What the map lists for this keyframe is looked through, not what is held: that may be as long as the sender likes.
    let listed = map.poses.cross_covariances.of(id).filter(|&(other, _)| wanted(other));
    listed.map(|(other, block)| CrossCovarianceBlock { other, block }).collect()
}

/// A keyframe as it is sent.
pub(crate) fn record(keyframe: &Keyframe) -> KeyframeRecord {
    KeyframeRecord {
        id: keyframe.id,
        stamp_ns: keyframe.stamp_ns,
        global_from_keyframe: keyframe.global_from_keyframe,
        camera: keyframe.camera.clone(),
    }
}

/// Distinct indices with their number of occurrences, most frequent first, of equally frequent ones the smaller first.
fn count_occurrences(indices: impl IntoIterator<Item = usize>) -> Vec<(usize, usize)> {
    let mut counts: HashMap<usize, usize> = HashMap::new();
    for index in indices {
        *counts.entry(index).or_default() += 1;
    }
    let mut counts: Vec<(usize, usize)> = counts.into_iter().collect();
    counts.sort_by_key(|&(index, count)| (std::cmp::Reverse(count), index));
    counts
}
