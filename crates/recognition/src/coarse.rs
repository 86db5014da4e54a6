//! Which parts of a large map an image could be of, before any of them is searched.
//!
//! The index has some landmarks of every keyframe of the whole map. The features of an image vote for keyframes as in a search, and a
//! part is ranked by its keyframes with the most votes: those around the place of an image share landmarks, so that several of them
//! have many, where chance gives many to one.

use map::model::{MapMetadata, Observation};
use protocol::FeatureSet;
use vision::{DescriptorError, DescriptorView};

use super::elements::Observers;
use super::index::{FULL_VOTE, LandmarkIndex, LandmarkIndexBuilder, Votes};
use super::query::{QueryError, view_of};

/// So many keyframes of a part, those with the most votes, make its rank.
const RANKING_KEYFRAMES: usize = 6;
/// Features of an image that vote, at most: they only rank.
const VOTERS: usize = 250;

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
    /// The number of each part, and where its keyframes begin.
    parts: Vec<(u32, usize)>,
    keyframes: usize,
}

/// Collects the landmarks of parts for a [`CoarseIndex`].
pub struct CoarseIndexBuilder {
    info: MapMetadata,
    index: LandmarkIndexBuilder,
    observers: Observers,
    landmarks: usize,
    parts: Vec<(u32, usize)>,
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
        self.parts.push((part, self.keyframes));
        for (descriptor, observers) in landmarks {
            let seen = Observation { keyframe: 0, pixel: [0.0; 2], descriptor: descriptor.to_vec() };
            self.index.add(self.landmarks, &[seen])?;
            let first = self.keyframes as u32;
            self.observers.push(observers.iter().map(|number| first + number));
            self.landmarks += 1;
        }
        self.keyframes += keyframes;
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
        let descriptors = view_of(&self.info, features)?;
        let step = descriptors.len().div_ceil(VOTERS).max(1);
        let voters: Vec<u8> = descriptors.iter().step_by(step).flatten().copied().collect();
        let voters = DescriptorView::new(descriptors.metric(), descriptors.width(), &voters)?;
        let votes = self.index.vote(voters, &self.observers, self.keyframes)?;
        let ends = self.parts.iter().skip(1).map(|(_, start)| *start).chain([self.keyframes]);
        let mut ranked: Vec<(u64, u32, u32)> = Vec::new();
        for ((part, start), end) in self.parts.iter().zip(ends) {
            let of_part = &votes[*start..end];
            let strongest =
                (0..).zip(of_part).max_by_key(|(at, votes)| (votes.weight, std::cmp::Reverse(*at)));
            if let Some((keyframe, _)) = strongest.filter(|(_, votes)| votes.weight > 0) {
                ranked.push((weight(of_part), *part, keyframe));
            }
        }
        ranked.sort_by_key(|(weight, part, _)| (std::cmp::Reverse(*weight), *part));
        let part = |(weight, part, keyframe)| {
            let weight = weight as f64 / FULL_VOTE as f64;
            RankedPart { part, weight, keyframe }
        };
        Ok(ranked.into_iter().map(part).collect())
    }
}

/// The votes for the keyframes that have the most.
fn weight(votes: &[Votes]) -> u64 {
    let mut weights: Vec<u64> = votes.iter().map(|votes| votes.weight).collect();
    if weights.len() > RANKING_KEYFRAMES {
        weights.select_nth_unstable_by_key(RANKING_KEYFRAMES, |weight| std::cmp::Reverse(*weight));
        weights.truncate(RANKING_KEYFRAMES);
    }
    weights.iter().sum()
}
