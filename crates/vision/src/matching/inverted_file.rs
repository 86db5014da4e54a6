//! Inverted file: approximate nearest-neighbour search among very many descriptors.
//!
//! Every stored descriptor is in the inverted list of its visual word. A query probes the lists of its few nearest words
//! and computes every distance there exactly: nothing farther than the given distance is returned; neighbours in lists
//! that are not probed are missed.
//!
//! # Where the defaults come from
//! `benches/benches/match_query`, before its loops were vectorized: 10,000 keyframes, 509,000 landmarks, 64 signed bytes.
//! With 256 entries per word and 4 probes a query of 500 descriptors took 33 ms there on a busy machine, with 128 and 3
//! 16 ms, with 128 and 2 12 ms (at most 2048 words in all cases); a keyframe of the place came first for every one of 40
//! images each time.
//!
//! Source: Jegou, Douze, Schmid, "Product quantization for nearest neighbor search", PAMI 2011 (IVF with several probes).

use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::descriptors::{DescriptorError, DescriptorView, Metric};
use super::prepared::{PreparedDescriptor, PreparedDescriptors};
use super::vocabulary::Vocabulary;

/// Mean length of an inverted list: short compared with the cost of finding the words of a query.
const ENTRIES_PER_WORD: usize = 128;
/// Maximum size of the vocabulary: a query is compared with each word.
const MAX_WORDS: usize = 2048;
/// Inverted lists that a query probes.
const PROBES: usize = 2;
/// Training descriptors per word.
const SAMPLE_PER_WORD: usize = 32;

/// A stored descriptor near a query.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance, in the unit of the [`Metric`].
    pub distance: f32,
    /// The number stored with the descriptor.
    pub payload: u32,
}

/// Descriptors of one metric and width with a payload each, searchable by distance.
///
/// # Example
/// ```
/// use vision::{DescriptorView, Metric, InvertedFile};
/// let stored = DescriptorView::new(Metric::CosineInt8, 2, &[100, 0, 0, 100])?;
/// let index = InvertedFile::build(stored, &[7, 8])?;
/// let query = DescriptorView::new(Metric::CosineInt8, 2, &[90, 10])?;
/// let mut found = Vec::new();
/// index.search(query, 0.3, |_, hits| found.extend(hits.iter().map(|hit| hit.payload)))?;
/// assert_eq!(found, [7]);
/// # Ok::<(), vision::DescriptorError>(())
/// ```
#[derive(Serialize, Deserialize)]
pub struct InvertedFile {
    metric: Metric,
    width: usize,
    /// `None` for an empty index.
    vocabulary: Option<Vocabulary>,
    /// `starts[word]..starts[word + 1]` is the inverted list of a word.
    #[serde(with = "super::packed")]
    starts: Vec<u32>,
    #[serde(with = "super::packed")]
    payloads: Vec<u32>,
    /// Descriptors in the order of `payloads`.
    entries: PreparedDescriptors,
}

impl InvertedFile {
    /// Trains a vocabulary and adds every descriptor to the inverted list of its word.
    ///
    /// # Arguments
    /// * `payloads`: one number per descriptor, returned by [`Self::search`]; not necessarily unique.
    ///
    /// # Errors
    /// [`DescriptorError::Groups`] where the number of payloads is not that of the descriptors,
    /// [`DescriptorError::Full`] beyond 2^32 - 1 descriptors.
    pub fn build(descriptors: DescriptorView<'_>, payloads: &[u32]) -> Result<Self, DescriptorError> {
        let count = descriptors.len();
        if payloads.len() != count {
            return Err(DescriptorError::Groups { groups: payloads.len(), descriptors: count });
        }
        u32::try_from(count).map_err(|_| DescriptorError::Full)?;
        let (metric, width) = (descriptors.metric(), descriptors.width());
        if count == 0 {
            let entries = PreparedDescriptors::new(&descriptors);
            return Ok(Self {
                metric,
                width,
                vocabulary: None,
                starts: Vec::new(),
                payloads: Vec::new(),
                entries,
            });
        }
        let word_count = (count / ENTRIES_PER_WORD).clamp(1, MAX_WORDS);
        let step = (count / (word_count * SAMPLE_PER_WORD)).max(1);
        let sample: Vec<u8> = descriptors.iter().step_by(step).flatten().copied().collect();
        let vocabulary = Vocabulary::train(DescriptorView::new(metric, width, &sample)?, word_count);

        let mut word_of = Vec::with_capacity(count);
        vocabulary.for_each_nearest(descriptors, 1, |_, words| word_of.push(words[0]));
        let mut starts = vec![0_u32; vocabulary.len() + 1];
        for &word in &word_of {
            starts[word as usize + 1] += 1;
        }
        for word in 0..vocabulary.len() {
            starts[word + 1] += starts[word];
        }
        let mut next = starts.clone();
        let mut sorted_payloads = vec![0_u32; count];
        let mut sorted_bytes = vec![0_u8; descriptors.bytes().len()];
        for ((descriptor, &payload), &word) in descriptors.iter().zip(payloads).zip(&word_of) {
            let at = next[word as usize] as usize;
            next[word as usize] += 1;
            sorted_payloads[at] = payload;
            sorted_bytes[at * width..(at + 1) * width].copy_from_slice(descriptor);
        }
        let entries = PreparedDescriptors::from_bytes(metric, width, sorted_bytes)?;
        Ok(Self { metric, width, vocabulary: Some(vocabulary), starts, payloads: sorted_payloads, entries })
    }

    /// Number of descriptors.
    pub fn len(&self) -> usize {
        self.payloads.len()
    }

    /// Whether it holds no descriptors.
    pub fn is_empty(&self) -> bool {
        self.payloads.is_empty()
    }

    /// Finds stored descriptors within a distance of each query (approximate: lists that are not probed are missed).
    ///
    /// # Arguments
    /// * `max_distance`: in the unit of the [`Metric`].
    /// * `visit`: called for each query in order with its index and its hits. The hits are not sorted, but their order is
    ///   deterministic.
    ///
    /// # Errors
    /// [`DescriptorError::Mismatch`] for another metric or width.
    pub fn search(
        &self,
        queries: DescriptorView<'_>,
        max_distance: f32,
        visit: impl FnMut(usize, &[Hit]),
    ) -> Result<(), DescriptorError> {
        let mut row = Vec::new();
        self.search_lists(queries, visit, |query, range, hits| {
            query.distances_to(&self.entries, range.clone(), &mut row);
            for (&distance, &payload) in row.iter().zip(&self.payloads[range]) {
                if distance <= max_distance {
                    hits.push(Hit { distance, payload });
                }
            }
        })
    }

    /// Like [`Self::search`], among the few descriptors whose payload is asked for: what [`Self::search`] would find of them.
    ///
    /// # Errors
    /// As [`Self::search`].
    pub fn search_among(
        &self,
        queries: DescriptorView<'_>,
        max_distance: f32,
        asked_for: impl Fn(u32) -> bool,
        visit: impl FnMut(usize, &[Hit]),
    ) -> Result<(), DescriptorError> {
        let mut row = Vec::new();
        self.search_lists(queries, visit, |query, range, hits| {
            for at in range {
                let payload = self.payloads[at];
                if asked_for(payload) {
                    query.distances_to(&self.entries, at..at + 1, &mut row);
                    let near = row.iter().filter(|&&distance| distance <= max_distance);
                    hits.extend(near.map(|&distance| Hit { distance, payload }));
                }
            }
        })
    }

    /// Calls `search` for each query and each inverted list that it probes, and `visit` with what was found in all of them.
    fn search_lists(
        &self,
        queries: DescriptorView<'_>,
        mut visit: impl FnMut(usize, &[Hit]),
        mut search: impl FnMut(&PreparedDescriptor<'_>, Range<usize>, &mut Vec<Hit>),
    ) -> Result<(), DescriptorError> {
        if queries.metric() != self.metric || queries.width() != self.width {
            return Err(DescriptorError::Mismatch { left: queries.width(), right: self.width });
        }
        let Some(vocabulary) = &self.vocabulary else { return Ok(()) };
        let prepared = PreparedDescriptors::new(&queries);
        let mut hits = Vec::new();
        vocabulary.for_each_nearest(queries, PROBES, |query, words| {
            hits.clear();
            let descriptor = prepared.get(query);
            for &word in words {
                let [start, end] = [word, word + 1].map(|at| self.starts[at as usize] as usize);
                search(&descriptor, start..end, &mut hits);
            }
            visit(query, &hits);
        });
        Ok(())
    }
}
