//! Which parts of a large map an image could be of, before any of them is searched.
//!
//! The index has some landmarks of every keyframe of the whole map. The features of an image vote for keyframes as in a search, and a
//! part is ranked by its keyframes with the most votes: those around the place of an image share landmarks, so that several of them
//! have many, where chance gives many to one.

use std::collections::BTreeMap;
use std::ops::Range;

use map::model::{MapMetadata, Observation};
use protocol::FeatureSet;
use vision::{DescriptorError, DescriptorView};

use super::elements::Observers;
use super::index::{FULL_VOTE, LandmarkIndex, LandmarkIndexBuilder, Votes};
use super::kinds::view_of;
use super::query::QueryError;

/// So many keyframes of a part, those with the most votes, make its rank.
const RANKING_KEYFRAMES: usize = 6;
/// Features of an image that vote, at most: they only rank.
const VOTERS: usize = 250;
/// The same where only some keyframes of few parts are in question.
const VOTERS_NEAR: usize = 64;

/// A part of a map that an image could be of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RankedPart {
    /// Its number.
    pub part: u32,
    /// The votes for it: a feature that is near one landmark only counts 1 for each of six keyframes.
    pub weight: f64,
    /// Its keyframe with the most votes, by its number in the part.
    pub keyframe: u32,
}

/// The landmarks of the parts of a map that tell them from each other.
pub struct CoarseIndex {
    info: MapMetadata,
    index: LandmarkIndex,
    observers: Observers,
    parts: Vec<Part>,
    keyframes: usize,
}

/// What of the index is one part's.
struct Part {
    number: u32,
    keyframes: Range<usize>,
    landmarks: Range<usize>,
}

/// Collects the landmarks of parts for a [`CoarseIndex`].
pub struct CoarseIndexBuilder {
    info: MapMetadata,
    index: LandmarkIndexBuilder,
    observers: Observers,
    landmarks: usize,
    parts: Vec<Part>,
    keyframes: usize,
}

impl CoarseIndexBuilder {
    /// For a map of these descriptors.
    pub fn new(info: MapMetadata) -> Self {
        let (kind, width) = (info.descriptor_kind, usize::from(info.descriptor_width));
        Self {
            info,
            index: LandmarkIndexBuilder::new(kind, width, 0),
            observers: Observers::default(),
            landmarks: 0,
            parts: Vec::new(),
            keyframes: 0,
        }
    }

    /// Adds a part of the map.
    ///
    /// # Arguments
    /// * `keyframes`: how many it has.
    /// * `landmarks`: descriptor of each, and which keyframes of the part observe it, by their numbers in it, ascending.
    ///
    /// # Errors
    /// [`DescriptorError`] for a descriptor of another width.
    pub fn add<'a>(
        &mut self,
        part: u32,
        keyframes: usize,
        landmarks: impl IntoIterator<Item = (&'a [u8], &'a [u32])>,
    ) -> Result<(), DescriptorError> {
        let first_landmark = self.landmarks;
        for (descriptor, observers) in landmarks {
            let seen = Observation { keyframe: 0, pixel: [0.0; 2], descriptor: descriptor.to_vec() };
            self.index.add(self.landmarks, &[seen])?;
            let first = self.keyframes as u32;
            self.observers.push(observers.iter().map(|number| first + number));
            self.landmarks += 1;
        }
        let of_part = self.keyframes..self.keyframes + keyframes;
        self.keyframes = of_part.end;
        self.parts.push(Part { number: part, keyframes: of_part, landmarks: first_landmark..self.landmarks });
        Ok(())
    }

    /// Builds the index.
    ///
    /// # Errors
    /// [`DescriptorError`].
    pub fn build(self) -> Result<CoarseIndex, DescriptorError> {
        let Self { info, index, observers, parts, keyframes, .. } = self;
        Ok(CoarseIndex { info, index: index.build()?, observers, parts, keyframes })
    }
}

impl CoarseIndex {
    /// The parts that share features with an image, the most likely first.
    ///
    /// # Errors
    /// [`QueryError`] where the features cannot be compared with the map.
    pub fn rank(&self, features: &FeatureSet) -> Result<Vec<RankedPart>, QueryError> {
        let descriptors = view_of(&self.info, features, || vec![self.info.feature_kind()])?;
        let voters = some_of(descriptors, VOTERS);
        let votes = self.index.vote(view_like(descriptors, &voters)?, &self.observers, self.keyframes)?;
        let ranked = self.parts.iter().filter_map(|part| {
            ranked(
                part.number,
                (0..).zip(&votes[part.keyframes.clone()]).map(|(at, votes)| (at, votes.weight)),
            )
        });
        Ok(sorted(ranked.collect()))
    }

    /// The same for some keyframes of few parts, as if there were no others: takes a fraction of the time.
    ///
    /// # Arguments
    /// * `near`: of each part that is in question its keyframes, by their numbers in it.
    ///
    /// # Errors
    /// [`QueryError`] where the features cannot be compared with the map.
    pub fn rank_near(
        &self,
        features: &FeatureSet,
        near: &BTreeMap<u32, Vec<u32>>,
    ) -> Result<Vec<RankedPart>, QueryError> {
        let descriptors = view_of(&self.info, features, || vec![self.info.feature_kind()])?;
        let voters = some_of(descriptors, VOTERS_NEAR);
        let (parts, keyframes): (Vec<&Part>, Vec<&Vec<u32>>) =
            self.parts.iter().filter_map(|part| Some((part, near.get(&part.number)?))).unzip();
        let mut votes: Vec<Vec<Votes>> =
            parts.iter().map(|part| vec![Votes::default(); part.keyframes.len()]).collect();
        let asked_for =
            |landmark: u32| parts.iter().any(|part| part.landmarks.contains(&(landmark as usize)));
        let vote = |keyframe: u32, feature: u32, weight: u64| {
            let keyframe = keyframe as usize;
            if let Some(at) = parts.iter().position(|part| part.keyframes.contains(&keyframe)) {
                votes[at][keyframe - parts[at].keyframes.start].add(feature, weight);
            }
        };
        self.index.each_vote(view_like(descriptors, &voters)?, &self.observers, asked_for, vote)?;
        let ranked = parts.iter().zip(&votes).zip(keyframes).filter_map(|((part, votes), keyframes)| {
            let weight = |at: &u32| Some((*at, votes.get(*at as usize)?.weight));
            ranked(part.number, keyframes.iter().filter_map(weight))
        });
        Ok(sorted(ranked.collect()))
    }
}

/// So many descriptors of an image, at equal steps.
fn some_of(descriptors: DescriptorView<'_>, count: usize) -> Vec<u8> {
    let step = descriptors.len().div_ceil(count).max(1);
    descriptors.iter().step_by(step).flatten().copied().collect()
}

fn view_like<'a>(
    descriptors: DescriptorView<'_>,
    bytes: &'a [u8],
) -> Result<DescriptorView<'a>, DescriptorError> {
    DescriptorView::new(descriptors.metric(), descriptors.width(), bytes)
}

/// A part by its keyframes with most votes; `None` where it has none.
///
/// # Arguments
/// * `weights`: of keyframes, by their numbers in the part.
fn ranked(part: u32, weights: impl Iterator<Item = (u32, u64)>) -> Option<RankedPart> {
    let mut voted: Vec<(u32, u64)> = weights.filter(|(_, weight)| *weight > 0).collect();
    // Of equal ones the first.
    let order = |(at, weight): &(u32, u64)| (std::cmp::Reverse(*weight), *at);
    let (keyframe, _) = voted.iter().copied().min_by_key(order)?;
    if voted.len() > RANKING_KEYFRAMES {
        voted.select_nth_unstable_by_key(RANKING_KEYFRAMES, order);
        voted.truncate(RANKING_KEYFRAMES);
    }
    let weight = voted.iter().map(|(_, weight)| weight).sum::<u64>() as f64 / FULL_VOTE as f64;
    Some(RankedPart { part, weight, keyframe })
}

/// Those with most votes first.
fn sorted(mut ranked: Vec<RankedPart>) -> Vec<RankedPart> {
    ranked.sort_by(|a, b| b.weight.total_cmp(&a.weight).then(a.part.cmp(&b.part)));
    ranked
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::{DescriptorKind, Descriptors};
    use rand::rngs::StdRng;
    use rand::{RngExt as _, SeedableRng as _};

    const WIDTH: usize = 32;
    const KEYFRAMES: u32 = 20;

    /// Parts 3, 5 and 9, each of whose keyframes observes ten landmarks that its neighbours observe too.
    fn parts() -> (CoarseIndex, BTreeMap<u32, Vec<Vec<u8>>>) {
        let mut random = StdRng::seed_from_u64(4);
        let mut builder =
            CoarseIndexBuilder::new(MapMetadata::new("parts", "test", DescriptorKind::Binary, WIDTH as u16));
        let mut all = BTreeMap::new();
        for part in [3, 5, 9] {
            let looks: Vec<Vec<u8>> =
                (0..10 * KEYFRAMES).map(|_| (0..WIDTH).map(|_| random.random()).collect()).collect();
            let observers: Vec<Vec<u32>> = (0..10 * KEYFRAMES)
                .map(|landmark| (landmark / 10..(landmark / 10 + 3).min(KEYFRAMES)).collect())
                .collect();
            let landmarks = looks.iter().zip(&observers);
            let landmarks = landmarks.map(|(look, observers)| (look.as_slice(), observers.as_slice()));
            builder.add(part, KEYFRAMES as usize, landmarks).unwrap();
            all.insert(part, looks);
        }
        (builder.build().unwrap(), all)
    }

    /// An image with these looks.
    fn image<'a>(looks: impl Iterator<Item = &'a Vec<u8>>) -> FeatureSet {
        let bytes: Vec<u8> = looks.flatten().copied().collect();
        let pixels = vec![[0.0; 2]; bytes.len() / WIDTH];
        let descriptors = Descriptors { kind: DescriptorKind::Binary, width: WIDTH as u16, bytes };
        FeatureSet { pixels, descriptors, extractor: String::new() }
    }

    #[test]
    fn near_all_keyframes_is_as_without_a_place() {
        let (index, looks) = parts();
        let all = looks.keys().map(|part| (*part, (0..KEYFRAMES).collect())).collect();
        for part in [3, 5, 9] {
            // Some of another part, too.
            let seen = image(looks[&part].iter().skip(70).take(40).chain(looks[&5].iter().take(8)));
            let ranked = index.rank(&seen).unwrap();
            assert_eq!(index.rank_near(&seen, &all).unwrap(), ranked);
            assert_eq!(ranked[0].part, part);
            assert!((7..=11).contains(&ranked[0].keyframe), "{ranked:?}");
        }
    }

    #[test]
    fn what_is_not_near_has_no_vote() {
        let (index, looks) = parts();
        let seen = image(looks[&3].iter().skip(70).take(40).chain(looks[&9].iter().take(8)));
        let near = BTreeMap::from([(5, vec![4, 8]), (9, vec![1, 2, 17])]);
        let ranked = index.rank_near(&seen, &near).unwrap();
        // Of part 9 the second keyframe observes the eight, the third too, the last none; of part 5 none is seen.
        let [RankedPart { part: 9, weight: 16.0, keyframe: 1 }] = ranked[..] else { panic!("{ranked:?}") };
        assert_eq!(index.rank_near(&seen, &BTreeMap::from([(9, vec![17])])).unwrap(), []);
        assert_eq!(index.rank_near(&seen, &BTreeMap::new()).unwrap(), []);
    }
}
