//! Matching by brute force: nearest neighbours under a distance threshold, a ratio test and a mutual check.
//!
//! # Where the defaults come from
//! Measured on the recorded sequences of `target/data` (fraction of bits that differ):
//!
//! | | correct matches | nearest wrong ones |
//! |---|---|---|
//! | `yq`, `MH_01_easy`/`MH_03_medium`: 256 bits, simulated flips | mean 0.095, 99 % below 0.14, largest 0.18 | 0.33 at least, 0.40 typically |
//! | `walk`, end against the first 10 s: 384 bits, a real extractor | median 0.09, 75 % below 0.14, 95 % below 0.21 | from 0.09 on, 0.22 to 0.30 typically |
//!
//! On `yq` any threshold between 0.18 and 0.32 separates perfectly, ratio test or not (the ratio of correct matches is
//! at most 0.44, that of wrong ones at least 0.86). The defaults come from `walk`. Matches per frame that pass the mutual
//! check, at the same place (correct) and at another place (all wrong):
//!
//! | max_distance | ratio | same place | other place |
//! |---|---|---|---|
//! | 0.25 | none | 179 | 40 |
//! | 0.25 | 0.9 | 169 | 19 |
//! | **0.25** | **0.8** | **157** | **5.2** |
//! | 0.20 | 0.8 | 152 | 3.1 |
//! | 0.25 | 0.7 | 143 | 1.0 |

use super::descriptors::{DescriptorError, DescriptorView, Metric};
use super::kernels::{two_least, update_least};
use super::prepared::PreparedDescriptors;
#[cfg(target_arch = "x86_64")]
use super::{avx2_rows::Interleaved, descriptors::inverse_norm_int8, kernels::int8_distances};
use std::collections::HashMap;

/// Conditions on a match.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MatchOptions {
    /// Largest distance, in the unit of the [`Metric`].
    pub max_distance: f32,
    /// Ratio test: the distance must be less than this times the distance to the nearest descriptor of another group;
    /// `None` disables it.
    pub ratio: Option<f32>,
    /// Mutual check: the query must also be the nearest one to the group of the train descriptor.
    pub mutual: bool,
}

impl MatchOptions {
    /// Defaults for a metric; the module documentation says on which data they were measured.
    ///
    /// Hamming: 0.25, ratio 0.8. Cosine: 0.3 and ratio 0.64, Euclidean (unit vectors): 0.77 and ratio 0.8, which is
    /// the same: `cosine distance = euclidean^2 / 2` (Lowe's ratio is one of Euclidean distances). The float values
    /// are not measured: no recorded data holds float descriptors.
    pub fn for_metric(metric: Metric) -> Self {
        let (max_distance, ratio) = match metric {
            Metric::Hamming => (0.25, 0.8),
            Metric::Cosine | Metric::CosineInt8 => (0.3, 0.64),
            Metric::Euclidean => (0.77, 0.8),
        };
        Self { max_distance, ratio: Some(ratio), mutual: true }
    }
}

/// A query descriptor and its nearest train descriptor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Match {
    /// Index of the query descriptor.
    pub query: usize,
    /// Index of the train descriptor.
    pub train: usize,
    /// Their distance, in the unit of the [`Metric`].
    pub distance: f32,
}

/// Matches every query descriptor with its nearest train descriptor, by brute force.
///
/// Ties are resolved in favour of the smaller index: the result is deterministic.
///
/// ```
/// use vision::{DescriptorView, MatchOptions, Metric, match_descriptors};
/// let train = DescriptorView::new(Metric::Hamming, 2, &[0x00, 0x00, 0xff, 0xff])?;
/// let query = DescriptorView::new(Metric::Hamming, 2, &[0xff, 0xfe])?;
/// let matches = match_descriptors(query, train, &MatchOptions::for_metric(Metric::Hamming))?;
/// assert_eq!((matches[0].query, matches[0].train), (0, 1));
/// # Ok::<(), vision::DescriptorError>(())
/// ```
///
/// # Returns
/// At most one match per query, ordered by query.
///
/// # Errors
/// [`DescriptorError::Mismatch`] if metric or width differ.
pub fn match_descriptors(
    query: DescriptorView<'_>,
    train: DescriptorView<'_>,
    options: &MatchOptions,
) -> Result<Vec<Match>, DescriptorError> {
    Matcher::new(query).matches(train, options)
}

/// Like [`match_descriptors`], where several train descriptors may belong to the same landmark.
///
/// Train descriptors of one group (a landmark observed by several keyframes) do not compete in the ratio test, and with
/// `mutual` a group is matched by at most one query: the nearest to any of its descriptors.
///
/// # Arguments
/// * `train_groups`: one group number per train descriptor.
///
/// # Errors
/// [`DescriptorError::Mismatch`] if metric or width differ, [`DescriptorError::Groups`] if the number of group numbers
/// differs from the number of train descriptors.
pub fn match_grouped(
    query: DescriptorView<'_>,
    train: DescriptorView<'_>,
    train_groups: &[u64],
    options: &MatchOptions,
) -> Result<Vec<Match>, DescriptorError> {
    if train_groups.len() != train.len() {
        return Err(DescriptorError::Groups { groups: train_groups.len(), descriptors: train.len() });
    }
    Matcher::new(query).grouped_matches(train, &dense_groups(train_groups), options)
}

/// Query descriptors that are matched with several sets of train descriptors, one after the other: they are converted, and
/// memory is allocated, once.
///
/// ```
/// use vision::{DescriptorView, MatchOptions, Matcher, Metric};
/// let view = |bytes| DescriptorView::new(Metric::CosineInt8, 2, bytes);
/// let mut matcher = Matcher::new(view(&[100, 0, 0, 100])?);
/// let options = MatchOptions::for_metric(Metric::CosineInt8);
/// assert_eq!(matcher.matches(view(&[0, 99])?, &options)?[0].query, 1);
/// assert_eq!(matcher.matches(view(&[99, 0])?, &options)?[0].query, 0);
/// # Ok::<(), vision::DescriptorError>(())
/// ```
pub struct Matcher {
    metric: Metric,
    width: usize,
    queries: PreparedDescriptors,
    /// The nearest query of each train descriptor: indexed by that, so that the inner loop writes to no other memory.
    nearest_distance: Vec<f32>,
    nearest_index: Vec<u32>,
    /// Train descriptors of signed bytes, where the processor can compare them interleaved.
    #[cfg(target_arch = "x86_64")]
    interleaved: Option<Interleaved>,
    /// 1 over the norm of each of these.
    #[cfg(target_arch = "x86_64")]
    inverse_norms: Vec<f32>,
}

impl Matcher {
    /// Converts the query descriptors.
    pub fn new(query: DescriptorView<'_>) -> Matcher {
        let (metric, width) = (query.metric(), query.width());
        Matcher {
            metric,
            width,
            queries: PreparedDescriptors::new(&query),
            nearest_distance: Vec::new(),
            nearest_index: Vec::new(),
            #[cfg(target_arch = "x86_64")]
            interleaved: Interleaved::new(width).filter(|_| metric == Metric::CosineInt8),
            #[cfg(target_arch = "x86_64")]
            inverse_norms: Vec::new(),
        }
    }

    /// Matches every query descriptor with its nearest train descriptor, see [`match_descriptors`].
    ///
    /// # Errors
    /// [`DescriptorError::Mismatch`] if metric or width differ.
    pub fn matches(
        &mut self,
        train: DescriptorView<'_>,
        options: &MatchOptions,
    ) -> Result<Vec<Match>, DescriptorError> {
        self.grouped_matches(train, &Groups::Single, options)
    }

    fn grouped_matches(
        &mut self,
        train: DescriptorView<'_>,
        groups: &Groups,
        options: &MatchOptions,
    ) -> Result<Vec<Match>, DescriptorError> {
        if self.metric != train.metric() || self.width != train.width() {
            return Err(DescriptorError::Mismatch { left: self.width, right: train.width() });
        }
        let (mut distances, mut indices) =
            (std::mem::take(&mut self.nearest_distance), std::mem::take(&mut self.nearest_index));
        distances.clear();
        distances.resize(train.len(), f32::INFINITY);
        indices.clear();
        indices.resize(train.len(), u32::MAX);
        let mut matches = Vec::new();
        self.for_each_row(train, |index, row| {
            if options.mutual {
                update_least(row, index as u32, &mut distances, &mut indices);
            }
            matches.extend(nearest(index, row, groups, options));
        });
        if options.mutual {
            let nearest_query = nearest_query_of_groups(groups, &distances, &indices);
            matches.retain(|found| nearest_query[groups.of(found.train)].1 as usize == found.query);
        }
        (self.nearest_distance, self.nearest_index) = (distances, indices);
        Ok(matches)
    }

    /// Calls `visit` with the index of each query descriptor in order and its distances to all train descriptors.
    fn for_each_row(&mut self, train: DescriptorView<'_>, mut visit: impl FnMut(usize, &[f32])) {
        #[cfg(target_arch = "x86_64")]
        if let (Some(interleaved), PreparedDescriptors::Int8 { data, inverse_norms, .. }) =
            (&mut self.interleaved, &self.queries)
        {
            self.inverse_norms.clear();
            self.inverse_norms.extend(train.iter().map(inverse_norm_int8));
            interleaved.fill(train.bytes());
            interleaved.for_each_row(data, |index, row| {
                int8_distances(row, inverse_norms[index], &self.inverse_norms);
                visit(index, row);
            });
            return;
        }
        self.queries.for_each_row(&PreparedDescriptors::new(&train), visit);
    }
}

/// The nearest train descriptor, if it passes the distance threshold and the ratio test.
fn nearest(query: usize, row: &[f32], groups: &Groups, options: &MatchOptions) -> Option<Match> {
    let (distance, second) = two_least(row);
    if !distance.is_finite() || distance > options.max_distance {
        return None;
    }
    let train = row.iter().position(|&other| other <= distance)?;
    let second = match groups {
        Groups::Single => second,
        Groups::Dense(groups) => second_nearest(row, train, groups),
    };
    let passes_ratio = options.ratio.is_none_or(|ratio| distance < ratio * second);
    passes_ratio.then_some(Match { query, train, distance })
}

/// The smallest distance to a train descriptor of another group than that of `train`, infinite for none.
fn second_nearest(row: &[f32], train: usize, groups: &[usize]) -> f32 {
    let others = row.iter().zip(groups).filter(|&(_, &group)| group != groups[train]);
    others.fold(f32::INFINITY, |least, (&distance, _)| least.min(distance))
}

/// Distance and index of the query nearest to any descriptor of each group; ties go to the first query.
fn nearest_query_of_groups(groups: &Groups, distances: &[f32], queries: &[u32]) -> Vec<(f32, u32)> {
    let mut nearest = vec![(f32::INFINITY, u32::MAX); distances.len()];
    for (train, (&distance, &query)) in distances.iter().zip(queries).enumerate() {
        let best = &mut nearest[groups.of(train)];
        if (distance, query) < *best {
            *best = (distance, query);
        }
    }
    nearest
}

/// Which train descriptors belong to the same landmark.
enum Groups {
    /// Each is a group of its own.
    Single,
    /// The group index of each.
    Dense(Vec<usize>),
}

impl Groups {
    fn of(&self, train: usize) -> usize {
        match self {
            Self::Single => train,
            Self::Dense(groups) => groups[train],
        }
    }
}

/// Renumbers groups from 0 in order of appearance.
fn dense_groups(groups: &[u64]) -> Groups {
    let mut numbers = HashMap::with_capacity(groups.len());
    let dense: Vec<usize> = groups
        .iter()
        .map(|group| {
            let next = numbers.len();
            *numbers.entry(*group).or_insert(next)
        })
        .collect();
    if numbers.len() == groups.len() { Groups::Single } else { Groups::Dense(dense) }
}
