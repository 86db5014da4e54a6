//! Place recognition without any prior: which keyframes does an image look like?
//!
//! The looks of every landmark of the map (the means of what its keyframes saw) are in one inverted file. A query
//! feature that is near the looks of `n` different landmarks gives each keyframe that observes one of them a vote of
//! `1/n` once, however many of them the keyframe sees: what is seen everywhere says nothing about where one is, and a
//! wall of equal windows cannot outvote a door.

use std::collections::HashMap;

use protocol::DescriptorKind;
use sensors::metric_of;
use vision::{DescriptorError, DescriptorView, InvertedFile, MatchOptions, Metric, prototype_descriptors};

use super::loaded_map::LoadedLandmark;

/// Descriptors of one landmark nearer to each other than this part of the largest distance of a match are one look.
const LOOK_SHARE: f32 = 0.75;

/// The weight of a feature that is near one landmark only.
const WHOLE_VOTE: u64 = 1 << 20;

/// The landmarks of a map by what they look like.
pub(crate) struct Index {
    /// With the index of the landmark.
    looks: InvertedFile,
    /// Largest distance at which a query feature votes.
    max_distance: f32,
}

/// The votes for one keyframe.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Votes {
    /// Sum of the weights, in parts of [`WHOLE_VOTE`]: whole numbers, so that the order of features is of no account.
    pub(crate) weight: u64,
    /// Number of query features that voted.
    pub(crate) features: usize,
}

/// Collects the looks of landmarks for an [`Index`].
pub(crate) struct IndexBuilder {
    metric: Metric,
    width: usize,
    descriptors: Vec<u8>,
    landmarks: Vec<u32>,
}

impl IndexBuilder {
    /// For descriptors of `width` bytes.
    pub(crate) fn new(kind: DescriptorKind, width: usize) -> IndexBuilder {
        IndexBuilder { metric: metric_of(kind), width, descriptors: Vec::new(), landmarks: Vec::new() }
    }

    fn max_distance(&self) -> f32 {
        MatchOptions::for_metric(self.metric).max_distance
    }

    /// Adds all descriptors of a landmark (its index), one after the other.
    pub(crate) fn add(&mut self, landmark: usize, seen: &[u8]) -> Result<(), DescriptorError> {
        let seen = DescriptorView::new(self.metric, self.width, seen)?;
        let looks = prototype_descriptors(seen, LOOK_SHARE * self.max_distance());
        self.landmarks.extend(std::iter::repeat_n(landmark as u32, looks.len() / self.width));
        self.descriptors.extend(looks);
        Ok(())
    }

    /// Files what was added.
    pub(crate) fn build(self) -> Result<Index, DescriptorError> {
        let view = DescriptorView::new(self.metric, self.width, &self.descriptors)?;
        Ok(Index { looks: InvertedFile::build(view, &self.landmarks)?, max_distance: self.max_distance() })
    }
}

impl Index {
    /// Votes for each of `keyframe_count` keyframes.
    pub(crate) fn vote(
        &self,
        query: DescriptorView<'_>,
        landmarks: &[LoadedLandmark],
        keyframe_count: usize,
    ) -> Result<Vec<Votes>, DescriptorError> {
        let mut votes = vec![Votes::default(); keyframe_count];
        let (mut near, mut keyframes) = (Vec::new(), Vec::new());
        self.looks.search(query, self.max_distance, |_, hits| {
            near.clear();
            near.extend(hits.iter().map(|hit| hit.payload));
            let weight = WHOLE_VOTE / count_distinct(&mut near).max(1) as u64;
            keyframes.clear();
            let observers = near.iter().flat_map(|&landmark| &landmarks[landmark as usize].observations);
            keyframes.extend(observers.map(|&(keyframe, _)| keyframe as u32));
            count_distinct(&mut keyframes);
            for &keyframe in &keyframes {
                let votes = &mut votes[keyframe as usize];
                votes.weight += weight;
                votes.features += 1;
            }
        })?;
        Ok(votes)
    }
}

/// Sorts, removes duplicates and counts.
fn count_distinct(numbers: &mut Vec<u32>) -> usize {
    numbers.sort_unstable();
    numbers.dedup();
    numbers.len()
}

/// The keyframes with the most votes among those that `eligible` lets pass, best first.
pub(crate) fn best_voted(
    votes: &[Votes],
    count: usize,
    min_features: usize,
    eligible: impl Fn(usize) -> bool,
) -> Vec<usize> {
    let mut ranked: Vec<usize> =
        (0..votes.len()).filter(|&at| votes[at].features >= min_features && eligible(at)).collect();
    ranked.sort_by(|&a, &b| votes[b].weight.cmp(&votes[a].weight).then(a.cmp(&b)));
    ranked.truncate(count);
    ranked
}

/// How often each of several things was counted, most often first, of equal counts the smaller thing.
pub(crate) fn tally(things: impl IntoIterator<Item = usize>) -> Vec<(usize, usize)> {
    let mut counts: HashMap<usize, usize> = HashMap::new();
    for thing in things {
        *counts.entry(thing).or_default() += 1;
    }
    let mut counts: Vec<(usize, usize)> = counts.into_iter().collect();
    counts.sort_by_key(|&(thing, count)| (std::cmp::Reverse(count), thing));
    counts
}
