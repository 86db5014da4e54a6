//! Ranking keyframes by appearance, without any prior.
//!
//! The prototype descriptors of every landmark of the map (means of its observations' descriptors) are in one inverted
//! file. A query feature that is near prototypes of `n` different landmarks gives each keyframe that observes one of them
//! a vote of weight `1/n`, once per keyframe: features that occur everywhere carry no information about the place, and a
//! wall of equal windows cannot outvote a door.

use protocol::DescriptorKind;
use sensors::metric_of;
use vision::{DescriptorError, DescriptorView, InvertedFile, MatchOptions, Metric, prototype_descriptors};

use super::elements::LoadedLandmark;

/// Descriptors of one landmark nearer to each other than this part of the largest distance of a match share a
/// prototype.
const PROTOTYPE_DISTANCE: f32 = 0.75;

/// The weight of a feature that is near one landmark only.
const FULL_VOTE: u64 = 1 << 20;

/// The landmarks of a map by their descriptors.
pub(crate) struct LandmarkIndex {
    /// Prototype descriptors with the index of their landmark.
    prototypes: InvertedFile,
    /// Largest distance at which a query feature votes.
    max_distance: f32,
}

/// The votes for one keyframe.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Votes {
    /// Sum of the weights, in parts of [`FULL_VOTE`]: integers, so that the sum does not depend on the order of features.
    pub(crate) weight: u64,
    /// Number of query features that voted.
    pub(crate) features: usize,
}

/// Collects the prototype descriptors of landmarks for an [`LandmarkIndex`].
pub(crate) struct LandmarkIndexBuilder {
    metric: Metric,
    width: usize,
    descriptors: Vec<u8>,
    landmarks: Vec<u32>,
}

impl LandmarkIndexBuilder {
    /// For descriptors of `width` bytes.
    pub(crate) fn new(kind: DescriptorKind, width: usize) -> LandmarkIndexBuilder {
        LandmarkIndexBuilder {
            metric: metric_of(kind),
            width,
            descriptors: Vec::new(),
            landmarks: Vec::new(),
        }
    }

    fn max_distance(&self) -> f32 {
        MatchOptions::for_metric(self.metric).max_distance
    }

    /// Adds all descriptors of a landmark (its index), concatenated.
    pub(crate) fn add(&mut self, landmark: usize, descriptors: &[u8]) -> Result<(), DescriptorError> {
        let view = DescriptorView::new(self.metric, self.width, descriptors)?;
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
    /// Votes for each of `keyframe_count` keyframes.
    pub(crate) fn vote(
        &self,
        query: DescriptorView<'_>,
        landmarks: &[LoadedLandmark],
        keyframe_count: usize,
    ) -> Result<Vec<Votes>, DescriptorError> {
        let mut votes = vec![Votes::default(); keyframe_count];
        let (mut near, mut keyframes) = (Vec::new(), Vec::new());
        self.prototypes.search(query, self.max_distance, |_, hits| {
            near.clear();
            near.extend(hits.iter().map(|hit| hit.payload));
            let weight = FULL_VOTE / count_distinct(&mut near).max(1) as u64;
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

/// The keyframes with the most votes among those for which `eligible` is true, best first.
pub(crate) fn best_voted(
    votes: &[Votes],
    count: usize,
    min_features: usize,
    eligible: impl Fn(usize) -> bool,
) -> Vec<usize> {
    let mut ranked: Vec<usize> =
        (0..votes.len()).filter(|&index| votes[index].features >= min_features && eligible(index)).collect();
    ranked.sort_by(|&a, &b| votes[b].weight.cmp(&votes[a].weight).then(a.cmp(&b)));
    ranked.truncate(count);
    ranked
}
