//! Ranking keyframes by appearance, without any prior.
//!
//! The prototype descriptors of every landmark of the map (means of its observations' descriptors) are in one inverted
//! file. A query feature that is near prototypes of `n` different landmarks gives each keyframe that observes one of them
//! a vote of weight `1/n`, once per keyframe (of many landmarks, only the nearest count): features that occur everywhere
//! carry no information about the place, and a wall of equal windows cannot outvote a door.

use protocol::DescriptorKind;
use serde::{Deserialize, Serialize};
use vision::{
    DescriptorError, DescriptorView, Hit, InvertedFile, MatchOptions, Metric, metric_of,
    prototype_descriptors,
};

use map::model::Observation;

use super::elements::Observers;

/// Descriptors of one landmark nearer to each other than this part of the largest distance of a match share a
/// prototype.
const PROTOTYPE_DISTANCE: f32 = 0.75;

/// Of the prototypes near a feature so many vote, the nearest: one that is near hundreds says little by each, and to count
/// its votes takes longer than to find them.
const MAX_VOTED: usize = 32;

/// The weight of a feature that is near one landmark only.
pub(crate) const FULL_VOTE: u64 = 1 << 20;

/// The landmarks of a map by their descriptors.
#[derive(Serialize, Deserialize)]
pub(crate) struct LandmarkIndex {
    /// Prototype descriptors with the index of their landmark.
    prototypes: InvertedFile,
    /// Largest distance at which a query feature votes.
    max_distance: f32,
}

/// Some of the landmarks of a map, a bit each: a search asks for every descriptor in the lists that it probes.
pub(crate) struct LandmarkSet {
    words: Vec<u64>,
}

impl LandmarkSet {
    /// No landmark of so many.
    pub(crate) fn empty(landmarks: usize) -> LandmarkSet {
        LandmarkSet { words: vec![0; landmarks.div_ceil(64)] }
    }

    pub(crate) fn insert(&mut self, landmark: u32) {
        self.words[landmark as usize / 64] |= 1 << (landmark % 64);
    }

    fn contains(&self, landmark: u32) -> bool {
        self.words[landmark as usize / 64] >> (landmark % 64) & 1 == 1
    }
}

/// The votes for one keyframe.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Votes {
    /// Sum of the weights, in parts of [`FULL_VOTE`]: integers, so that the sum does not depend on the order of features.
    pub(crate) weight: u64,
    /// Number of query features that voted.
    pub(crate) features: u32,
    /// One more than the last of these features.
    last: u32,
}

impl Votes {
    /// Adds the vote of a feature, unless it has voted for the keyframe already. Features vote one after the other.
    pub(crate) fn add(&mut self, feature: u32, weight: u64) {
        if self.last != feature + 1 {
            self.last = feature + 1;
            self.weight += weight;
            self.features += 1;
        }
    }

    /// Counts each feature for so many, of which only it has voted.
    pub(crate) fn stand_for(&mut self, features: u32) {
        self.weight *= u64::from(features);
        self.features *= features;
    }
}

/// Collects the prototype descriptors of landmarks for an [`LandmarkIndex`].
pub(crate) struct LandmarkIndexBuilder {
    metric: Metric,
    width: usize,
    descriptors: Vec<u8>,
    landmarks: Vec<u32>,
    /// Descriptors of the landmark that is added.
    of_landmark: Vec<u8>,
}

impl LandmarkIndexBuilder {
    /// For descriptors of `width` bytes of so many landmarks.
    pub(crate) fn new(kind: DescriptorKind, width: usize, landmarks: usize) -> LandmarkIndexBuilder {
        LandmarkIndexBuilder {
            metric: metric_of(kind),
            width,
            // Most landmarks have one prototype.
            descriptors: Vec::with_capacity(width * landmarks),
            landmarks: Vec::with_capacity(landmarks),
            of_landmark: Vec::new(),
        }
    }

    fn max_distance(&self) -> f32 {
        MatchOptions::for_metric(self.metric).max_distance
    }

    /// Adds all descriptors of a landmark (its index).
    pub(crate) fn add(
        &mut self,
        landmark: usize,
        observations: &[Observation],
    ) -> Result<(), DescriptorError> {
        self.of_landmark.clear();
        for observation in observations {
            self.of_landmark.extend_from_slice(&observation.descriptor);
        }
        let view = DescriptorView::new(self.metric, self.width, &self.of_landmark)?;
        let prototypes = prototype_descriptors(view, PROTOTYPE_DISTANCE * self.max_distance());
        self.landmarks.extend(std::iter::repeat_n(landmark as u32, prototypes.len() / self.width));
        self.descriptors.extend(prototypes);
        Ok(())
    }

    /// Builds the index.
    pub(crate) fn build(self) -> Result<LandmarkIndex, DescriptorError> {
        let view = DescriptorView::new(self.metric, self.width, &self.descriptors)?;
        Ok(LandmarkIndex {
            prototypes: InvertedFile::build(view, &self.landmarks)?,
            max_distance: self.max_distance(),
        })
    }
}

impl LandmarkIndex {
    /// An index without landmarks.
    pub(crate) fn empty(kind: DescriptorKind, width: usize) -> Result<LandmarkIndex, DescriptorError> {
        LandmarkIndexBuilder::new(kind, width, 0).build()
    }

    /// Votes for each of `keyframe_count` keyframes.
    pub(crate) fn vote(
        &self,
        query: DescriptorView<'_>,
        observers: &Observers,
        keyframe_count: usize,
    ) -> Result<Vec<Votes>, DescriptorError> {
        let mut votes = vec![Votes::default(); keyframe_count];
        self.prototypes.search(query, self.max_distance, |feature, hits| {
            cast_votes(feature, hits, observers, add_to(&mut votes));
        })?;
        Ok(votes)
    }

    /// Votes for each keyframe with some of the landmarks only, which must be few: a query feature that is near prototypes
    /// of `n` of these gives a vote of weight `1/n`.
    ///
    /// # Arguments
    /// * `among`: those that count.
    pub(crate) fn vote_among(
        &self,
        query: DescriptorView<'_>,
        observers: &Observers,
        keyframe_count: usize,
        among: &LandmarkSet,
    ) -> Result<Vec<Votes>, DescriptorError> {
        let mut votes = vec![Votes::default(); keyframe_count];
        self.each_vote(query, observers, |landmark| among.contains(landmark), add_to(&mut votes))?;
        Ok(votes)
    }

    /// The votes of [`Self::vote_among`] one by one, for whoever counts them for some keyframes only.
    ///
    /// # Arguments
    /// * `asked_for`: which landmarks count.
    /// * `vote`: called with a keyframe, the feature that votes for it, and the weight. A feature votes once for each landmark;
    ///   [`Votes::add`] counts the first.
    pub(crate) fn each_vote(
        &self,
        query: DescriptorView<'_>,
        observers: &Observers,
        asked_for: impl Fn(u32) -> bool,
        mut vote: impl FnMut(u32, u32, u64),
    ) -> Result<(), DescriptorError> {
        self.prototypes.search_among(query, self.max_distance, asked_for, |feature, hits| {
            cast_votes(feature, hits, observers, &mut vote);
        })
    }
}

/// Adds votes to those of all keyframes.
fn add_to(votes: &mut [Votes]) -> impl FnMut(u32, u32, u64) {
    |keyframe, feature, weight| votes[keyframe as usize].add(feature, weight)
}

/// The votes of one feature, for what observes the nearest landmarks.
fn cast_votes(feature: usize, hits: &[Hit], observers: &Observers, mut vote: impl FnMut(u32, u32, u64)) {
    let mut nearest: Vec<Hit> = hits.to_vec();
    if hits.len() > MAX_VOTED {
        let order = |a: &Hit, b: &Hit| a.distance.total_cmp(&b.distance).then(a.payload.cmp(&b.payload));
        nearest.select_nth_unstable_by(MAX_VOTED, order);
        nearest.truncate(MAX_VOTED);
    }
    let left_out = hits.len() - nearest.len();
    let mut near: Vec<u32> = nearest.iter().map(|hit| hit.payload).collect();
    let weight = FULL_VOTE / (left_out + count_distinct(&mut near)).max(1) as u64;
    for &keyframe in near.iter().flat_map(|&landmark| observers.of(landmark as usize)) {
        vote(keyframe, feature as u32, weight);
    }
}

/// Sorts, removes duplicates and counts.
fn count_distinct(numbers: &mut Vec<u32>) -> usize {
    numbers.sort_unstable();
    numbers.dedup();
    numbers.len()
}

/// The keyframes with the most votes among those for which `eligible` is true, best first.
pub(crate) fn best_voted(
    votes: &[Votes],
    count: usize,
    min_features: usize,
    eligible: impl Fn(usize) -> bool,
) -> Vec<usize> {
    let mut ranked: Vec<usize> = (0..votes.len())
        .filter(|&index| votes[index].features as usize >= min_features && eligible(index))
        .collect();
    let rank = |&a: &usize, &b: &usize| votes[b].weight.cmp(&votes[a].weight).then(a.cmp(&b));
    if ranked.len() > count && count > 0 {
        ranked.select_nth_unstable_by(count - 1, rank);
    }
    ranked.truncate(count);
    ranked.sort_unstable_by(rank);
    ranked
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use rand::{RngExt, SeedableRng, rngs::StdRng};

    use super::*;

    const KEYFRAMES: usize = 40;

    /// Landmarks of few different descriptors, each observed by some keyframes.
    fn random_index(random: &mut StdRng) -> (LandmarkIndex, Observers, Vec<u8>) {
        let looks: Vec<u8> = (0..50 * 32).map(|_| random.random()).collect();
        let mut builder = LandmarkIndexBuilder::new(DescriptorKind::Binary, 32, 200);
        let mut all_observers = Observers::with_capacity(200, 1000);
        for number in 0..200 {
            let observers: BTreeSet<u32> = (0..5).map(|_| random.random_range(0..KEYFRAMES as u32)).collect();
            let look = random.random_range(0..50) * 32;
            let observations = observers.iter().map(|&keyframe| Observation {
                keyframe: u64::from(keyframe),
                pixel: [0.0; 2],
                descriptor: looks[look..look + 32].to_vec(),
            });
            let observations: Vec<Observation> = observations.collect();
            builder.add(number, &observations).unwrap();
            all_observers.push(observers.into_iter());
        }
        (builder.build().unwrap(), all_observers, looks)
    }

    #[test]
    fn each_feature_votes_once_for_each_keyframe_that_observes_what_it_is_near() {
        let mut random = StdRng::seed_from_u64(1);
        let (index, observers, looks) = random_index(&mut random);
        let query = DescriptorView::new(Metric::Hamming, 32, &looks).unwrap();
        let mut slow = vec![(0, 0); KEYFRAMES];
        let search = index.prototypes.search(query, index.max_distance, |_, hits| {
            let near: BTreeSet<u32> = hits.iter().map(|hit| hit.payload).collect();
            let observing = near.iter().flat_map(|&landmark| observers.of(landmark as usize));
            for &keyframe in observing.collect::<BTreeSet<_>>() {
                slow[keyframe as usize].0 += FULL_VOTE / near.len() as u64;
                slow[keyframe as usize].1 += 1;
            }
        });
        search.unwrap();
        let votes = index.vote(query, &observers, KEYFRAMES).unwrap();
        let fast: Vec<(u64, u32)> = votes.iter().map(|votes| (votes.weight, votes.features)).collect();
        assert_eq!(fast, slow);
        assert!(fast.iter().any(|votes| votes.1 > 5));
    }

    #[test]
    fn votes_among_some_landmarks_are_those_without_all_others() {
        let mut random = StdRng::seed_from_u64(3);
        let (index, observers, looks) = random_index(&mut random);
        let query = DescriptorView::new(Metric::Hamming, 32, &looks).unwrap();
        let mut among = LandmarkSet::empty(200);
        (0..200).filter(|_| random.random_bool(0.2)).for_each(|landmark| among.insert(landmark));
        let mut slow = vec![Votes::default(); KEYFRAMES];
        let search = index.prototypes.search(query, index.max_distance, |feature, hits| {
            let hits: Vec<Hit> = hits.iter().copied().filter(|hit| among.contains(hit.payload)).collect();
            cast_votes(feature, &hits, &observers, add_to(&mut slow));
        });
        search.unwrap();
        assert_eq!(index.vote_among(query, &observers, KEYFRAMES, &among).unwrap(), slow);
        assert!(slow.iter().any(|votes| votes.features > 0));
        let mut all = LandmarkSet::empty(200);
        (0..200).for_each(|landmark| all.insert(landmark));
        let votes = index.vote(query, &observers, KEYFRAMES).unwrap();
        assert_eq!(index.vote_among(query, &observers, KEYFRAMES, &all).unwrap(), votes);
    }

    #[test]
    fn of_many_near_landmarks_the_nearest_vote_with_the_weight_of_all() {
        let mut observers = Observers::with_capacity(KEYFRAMES, KEYFRAMES);
        for number in 0..KEYFRAMES as u32 {
            observers.push(std::iter::once(number));
        }
        // The larger the number, the nearer.
        let distance = |payload: u32| 0.3 - 0.001 * payload as f32;
        let hits = (0..KEYFRAMES as u32).map(|payload| Hit { distance: distance(payload), payload });
        let hits: Vec<Hit> = hits.collect();
        let mut votes = vec![Votes::default(); KEYFRAMES];
        cast_votes(0, &hits, &observers, add_to(&mut votes));
        let first = KEYFRAMES - MAX_VOTED;
        assert!(votes[..first].iter().all(|votes| votes.features == 0));
        let weight = FULL_VOTE / KEYFRAMES as u64;
        assert!(votes[first..].iter().all(|votes| (votes.features, votes.weight) == (1, weight)));
    }

    #[test]
    fn the_best_voted_are_the_first_of_all_in_order() {
        let mut random = StdRng::seed_from_u64(2);
        for count in [0, 1, 10, 300] {
            let vote = |_| Votes {
                weight: random.random_range(0..30),
                features: random.random_range(0..6),
                last: 0,
            };
            let votes: Vec<Votes> = (0..200).map(vote).collect();
            let mut all: Vec<usize> = (0..200).filter(|&at| votes[at].features >= 2 && at % 3 != 0).collect();
            all.sort_by_key(|&at| (std::cmp::Reverse(votes[at].weight), at));
            all.truncate(count);
            assert_eq!(best_voted(&votes, count, 2, |at| at % 3 != 0), all);
        }
    }
}
