//! Place recognition without any prior: which keyframes does an image look like?
//!
//! Every observation of the map is in one multi-index. A query feature that is near the descriptors of `n` different
//! landmarks gives each keyframe that observes one of them a vote of `1/n` once, however many of them the keyframe
//! sees: what is seen everywhere says nothing about where one is, and a wall of equal windows cannot outvote a door.

use std::collections::HashMap;

use protocol::DescriptorKind;
use vision::{DescriptorError, DescriptorView, MatchOptions, Metric, MultiIndex, SKETCH_BYTES, Sketcher};

/// Seed of the hyperplanes for float descriptors; any number, but always the same.
const SKETCH_SEED: u64 = 17;

/// The observations of a map by what they look like.
pub(crate) struct Index {
    kind: DescriptorKind,
    binary: MultiIndex,
    /// For float descriptors: what makes bits of them.
    sketcher: Option<Sketcher>,
    /// Largest distance in bits at which a query feature votes.
    max_bits: u32,
    /// Keyframe and landmark of each entry.
    entries: Vec<(u32, u32)>,
}

/// The votes for one keyframe.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Votes {
    /// Sum of the weights.
    pub(crate) weight: f64,
    /// Number of query features that voted.
    pub(crate) features: usize,
}

/// How descriptors of a kind are compared.
pub fn metric_of(kind: DescriptorKind) -> Metric {
    match kind {
        DescriptorKind::Binary => Metric::Hamming,
        DescriptorKind::Int8 => Metric::CosineInt8,
        DescriptorKind::Float => Metric::Cosine,
    }
}

impl Index {
    /// An empty index for descriptors of `width` bytes.
    pub(crate) fn new(kind: DescriptorKind, width: usize) -> Result<Index, DescriptorError> {
        let max_distance = MatchOptions::for_metric(metric_of(kind)).max_distance;
        let (binary, sketcher, max_bits) = match kind {
            DescriptorKind::Binary => {
                let bits = 8.0 * width as f32 * max_distance;
                (MultiIndex::new(width.next_multiple_of(2))?, None, bits as u32)
            }
            DescriptorKind::Float | DescriptorKind::Int8 => {
                let bits = Sketcher::search_bits(f64::from(max_distance));
                let dimension = if kind == DescriptorKind::Float { width / 4 } else { width };
                (MultiIndex::new(SKETCH_BYTES)?, Some(Sketcher::new(dimension, SKETCH_SEED)), bits)
            }
        };
        Ok(Index { kind, binary, sketcher, max_bits, entries: Vec::new() })
    }

    /// Adds an observation of a landmark by a keyframe (their indices).
    pub(crate) fn insert(
        &mut self,
        descriptor: &[u8],
        keyframe: usize,
        landmark: usize,
    ) -> Result<(), DescriptorError> {
        let bits = self.to_bits(descriptor)?;
        self.binary.insert(&bits, self.entries.len() as u32)?;
        self.entries.push((keyframe as u32, landmark as u32));
        Ok(())
    }

    /// Votes for each of `keyframe_count` keyframes.
    pub(crate) fn vote(
        &self,
        query: DescriptorView<'_>,
        keyframe_count: usize,
    ) -> Result<Vec<Votes>, DescriptorError> {
        let mut votes = vec![Votes::default(); keyframe_count];
        let (mut landmarks, mut keyframes) = (Vec::new(), Vec::new());
        for descriptor in &query {
            let found = self.binary.query(&self.to_bits(descriptor)?, self.max_bits)?;
            landmarks.clear();
            keyframes.clear();
            for candidate in &found {
                let (keyframe, landmark) = self.entries[candidate.payload as usize];
                keyframes.push(keyframe);
                landmarks.push(landmark);
            }
            let weight = 1.0 / count_distinct(&mut landmarks).max(1) as f64;
            count_distinct(&mut keyframes);
            for &keyframe in &keyframes {
                let votes = &mut votes[keyframe as usize];
                votes.weight += weight;
                votes.features += 1;
            }
        }
        Ok(votes)
    }

    /// The descriptor as the multi-index knows it: a whole number of 16-bit chunks, or a sketch.
    fn to_bits<'a>(&self, descriptor: &'a [u8]) -> Result<std::borrow::Cow<'a, [u8]>, DescriptorError> {
        match &self.sketcher {
            Some(sketcher) if self.kind == DescriptorKind::Int8 => {
                Ok(sketcher.sketch_int8(descriptor)?.to_vec().into())
            }
            Some(sketcher) => Ok(sketcher.sketch(descriptor)?.to_vec().into()),
            None if descriptor.len() + 1 == self.binary.width() => {
                let mut padded = descriptor.to_vec();
                padded.push(0);
                Ok(padded.into())
            }
            None => Ok(descriptor.into()),
        }
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
    ranked.sort_by(|&a, &b| votes[b].weight.total_cmp(&votes[a].weight).then(a.cmp(&b)));
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
