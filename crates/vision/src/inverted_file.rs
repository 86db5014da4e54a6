//! Near descriptors among very many: an inverted file.
//!
//! Every stored descriptor is in the list of its word (see the vocabulary in `words`). A query looks through the
//! lists of its few nearest words and measures every distance there exactly, so nothing farther than asked for is
//! returned, and what is missed lies beyond a border that the query is not near to.
//!
//! # Where the defaults come from
//! `map_server/benches/match_query`: 10,000 keyframes, 509,000 landmarks, 64 signed bytes. With 256 entries a word and 4
//! probes a query of 500 descriptors took 33 ms there on a busy machine, with 128 and 3 16 ms, with 128 and 2 12 ms (at
//! most 2048 words in all cases); a keyframe of the place came first for every one of 40 images each time.
//!
//! Source: Jegou, Douze, Schmid, "Product quantization for nearest neighbor search", PAMI 2011 (IVF with several probes).

use crate::descriptors::{DescriptorError, DescriptorView, Metric};
use crate::prepared::Prepared;
use crate::words::Words;

/// Stored descriptors a word on average: lists that are short beside the cost of finding a query's words.
const ENTRIES_A_WORD: usize = 128;
/// Most words: a query is compared with each.
const MAX_WORDS: usize = 2048;
/// Words whose lists a query looks through.
const PROBES: usize = 2;
/// Descriptors a word that the words are trained on.
const SAMPLE_A_WORD: usize = 32;

/// A stored descriptor near a query.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance, in the unit of the [`Metric`].
    pub distance: f32,
    /// What was stored with the descriptor.
    pub payload: u32,
}

/// Descriptors of one metric and width with a number each, to be searched by distance.
///
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
pub struct InvertedFile {
    metric: Metric,
    width: usize,
    /// `None` for an empty index.
    words: Option<Words>,
    /// `starts[word]..starts[word + 1]` are the entries of a word.
    starts: Vec<u32>,
    payloads: Vec<u32>,
    /// Of the entries, in the order of `payloads`.
    entries: Prepared,
}

impl InvertedFile {
    /// Trains words and files every descriptor under its word.
    ///
    /// # Arguments
    /// * `payloads`: one number a descriptor, which its finders get back; not necessarily unique.
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
            let entries = Prepared::new(&descriptors);
            return Ok(Self {
                metric,
                width,
                words: None,
                starts: Vec::new(),
                payloads: Vec::new(),
                entries,
            });
        }
        let word_count = (count / ENTRIES_A_WORD).clamp(1, MAX_WORDS);
        let step = (count / (word_count * SAMPLE_A_WORD)).max(1);
        let sample: Vec<u8> = descriptors.iter().step_by(step).flatten().copied().collect();
        let words = Words::train(DescriptorView::new(metric, width, &sample)?, word_count);

        let word_of = words.nearest(descriptors, 1);
        let mut starts = vec![0_u32; words.len() + 1];
        for &word in &word_of {
            starts[word as usize + 1] += 1;
        }
        for word in 0..words.len() {
            starts[word + 1] += starts[word];
        }
        let mut next = starts.clone();
        let mut filed = vec![0_u32; count];
        let mut sorted = vec![0_u8; descriptors.bytes().len()];
        for ((descriptor, &payload), &word) in descriptors.iter().zip(payloads).zip(&word_of) {
            let at = next[word as usize] as usize;
            next[word as usize] += 1;
            filed[at] = payload;
            sorted[at * width..(at + 1) * width].copy_from_slice(descriptor);
        }
        let entries = Prepared::new(&DescriptorView::new(metric, width, &sorted)?);
        Ok(Self { metric, width, words: Some(words), starts, payloads: filed, entries })
    }

    /// Number of descriptors.
    pub fn len(&self) -> usize {
        self.payloads.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.payloads.is_empty()
    }

    /// Finds the stored descriptors near each query.
    ///
    /// # Arguments
    /// * `max_distance`: in the unit of the [`Metric`].
    /// * `visit`: called for each query in order with its index and what was found, in no particular but always the
    ///   same order.
    ///
    /// # Errors
    /// [`DescriptorError::Mismatch`] for another metric or width.
    pub fn search(
        &self,
        queries: DescriptorView<'_>,
        max_distance: f32,
        mut visit: impl FnMut(usize, &[Hit]),
    ) -> Result<(), DescriptorError> {
        if queries.metric() != self.metric || queries.width() != self.width {
            return Err(DescriptorError::Mismatch { left: queries.width(), right: self.width });
        }
        let Some(words) = &self.words else { return Ok(()) };
        let probes = PROBES.min(words.len());
        let near_words = words.nearest(queries, probes);
        let prepared = Prepared::new(&queries);
        let (mut row, mut hits) = (Vec::new(), Vec::new());
        for (query, near_words) in near_words.chunks_exact(probes).enumerate() {
            hits.clear();
            for &word in near_words {
                let range = self.starts[word as usize] as usize..self.starts[word as usize + 1] as usize;
                prepared.distances_to(query, &self.entries, range.clone(), &mut row);
                for (&distance, &payload) in row.iter().zip(&self.payloads[range]) {
                    if distance <= max_distance {
                        hits.push(Hit { distance, payload });
                    }
                }
            }
            visit(query, &hits);
        }
        Ok(())
    }
}
