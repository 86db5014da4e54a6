//! Which descriptor of one image is which of another (or of a map): nearest neighbours that stand three checks.
//!
//! # Where the defaults come from
//! Measured on the recorded sequences of `target/data` (fraction of bits that differ):
//!
//! | | right matches | wrong ones, nearest |
//! |---|---|---|
//! | `yq`, `MH_01_easy`/`MH_03_medium`: 256 bits, simulated flips | mean 0.095, 99 % below 0.14, largest 0.18 | 0.33 at least, 0.40 typically |
//! | `walk`, end against the first 10 s: 384 bits, a real extractor | median 0.09, 75 % below 0.14, 95 % below 0.21 | from 0.09 on, 0.22 to 0.30 typically |
//!
//! On `yq` any threshold between 0.18 and 0.32 separates perfectly, ratio test or not (the ratio of right matches is
//! at most 0.44, that of wrong ones at least 0.86). `walk` decides. Matches a frame that pass the mutual check, of the
//! same place (true) and of another place (all wrong):
//!
//! | max_distance | ratio | same place | other place |
//! |---|---|---|---|
//! | 0.25 | none | 179 | 40 |
//! | 0.25 | 0.9 | 169 | 19 |
//! | **0.25** | **0.8** | **157** | **5.2** |
//! | 0.20 | 0.8 | 152 | 3.1 |
//! | 0.25 | 0.7 | 143 | 1.0 |

use crate::descriptors::{DescriptorError, DescriptorView, Metric};
use crate::prepared::Prepared;
use std::collections::HashMap;

/// What a match must satisfy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MatchOptions {
    /// Largest distance, in the unit of the [`Metric`].
    pub max_distance: f32,
    /// The distance must be less than this times that of the nearest rival of another group; `None` for no such test.
    pub ratio: Option<f32>,
    /// The query must also be the nearest one of the train descriptor's group.
    pub mutual: bool,
}

impl MatchOptions {
    /// Defaults for a metric; the module says what they were measured on.
    ///
    /// Hamming: 0.25, ratio 0.8. Cosine: 0.3 and ratio 0.64, Euclidean (unit vectors): 0.77 and ratio 0.8, which is
    /// the same: `cosine distance = euclidean^2 / 2` (Lowe's ratio is one of Euclidean distances). The float values
    /// are not measured here: no recorded data holds float descriptors.
    pub fn for_metric(metric: Metric) -> Self {
        let (max_distance, ratio) = match metric {
            Metric::Hamming => (0.25, 0.8),
            Metric::Cosine | Metric::CosineInt8 => (0.3, 0.64),
            Metric::Euclidean => (0.77, 0.8),
        };
        Self { max_distance, ratio: Some(ratio), mutual: true }
    }
}

/// Two descriptors that belong together.
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
/// Of equal distances the smaller index wins, so the result does not depend on anything but the input.
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
/// At most one match a query, ordered by query.
///
/// # Errors
/// [`DescriptorError::Mismatch`] where metric or width differ.
pub fn match_descriptors(
    query: DescriptorView<'_>,
    train: DescriptorView<'_>,
    options: &MatchOptions,
) -> Result<Vec<Match>, DescriptorError> {
    let groups: Vec<u64> = (0..train.len() as u64).collect();
    match_grouped(query, train, &groups, options)
}

/// Like [`match_descriptors`], where several train descriptors may show the same thing.
///
/// Train descriptors of one group (the same landmark seen by several keyframes) are no rivals of each other in the
/// ratio test, and with `mutual` a group is matched by at most one query: the nearest to any of its descriptors.
///
/// # Arguments
/// * `train_groups`: one number a train descriptor; equal numbers are the same thing.
///
/// # Errors
/// [`DescriptorError::Mismatch`] where metric or width differ, [`DescriptorError::Groups`] where the number of groups
/// is not that of the train descriptors.
pub fn match_grouped(
    query: DescriptorView<'_>,
    train: DescriptorView<'_>,
    train_groups: &[u64],
    options: &MatchOptions,
) -> Result<Vec<Match>, DescriptorError> {
    if query.metric() != train.metric() || query.width() != train.width() {
        return Err(DescriptorError::Mismatch { left: query.width(), right: train.width() });
    }
    if train_groups.len() != train.len() {
        return Err(DescriptorError::Groups { groups: train_groups.len(), descriptors: train.len() });
    }
    let groups = dense_groups(train_groups);
    let (query_data, train_data) = (Prepared::new(&query), Prepared::new(&train));
    // Of each train descriptor, so that the loop over them has no other memory to write to.
    let mut nearest_distance = vec![f32::INFINITY; train.len()];
    let mut nearest_index = vec![u32::MAX; train.len()];
    let mut matches = Vec::new();
    query_data.for_each_row(&train_data, |index, row| {
        if options.mutual {
            let best = nearest_distance.iter_mut().zip(&mut nearest_index);
            for (&distance, (least, nearest)) in row.iter().zip(best) {
                let nearer = distance < *least;
                *least = if nearer { distance } else { *least };
                *nearest = if nearer { index as u32 } else { *nearest };
            }
        }
        matches.extend(nearest(index, row, &groups, options));
    });
    if options.mutual {
        let nearest_query = nearest_query_of_groups(&groups, &nearest_distance, &nearest_index);
        matches.retain(|found| nearest_query[groups.of(found.train)].1 as usize == found.query);
    }
    Ok(matches)
}

/// The nearest train descriptor, if it is near enough and no other group comes too close.
fn nearest(query: usize, row: &[f32], groups: &Groups, options: &MatchOptions) -> Option<Match> {
    let distance = least(row);
    if !distance.is_finite() || distance > options.max_distance {
        return None;
    }
    let train = row.iter().position(|&other| other <= distance)?;
    let clear = options.ratio.is_none_or(|ratio| distance < ratio * rival(row, train, groups));
    clear.then_some(Match { query, train, distance })
}

/// The smallest of many distances, infinite for none.
fn least(distances: &[f32]) -> f32 {
    // Sixteen lanes and comparisons, which the compiler turns into vector instructions.
    let (blocks, rest) = distances.as_chunks::<16>();
    let mut lanes = [f32::INFINITY; 16];
    for block in blocks {
        for (lane, &distance) in lanes.iter_mut().zip(block) {
            *lane = if distance < *lane { distance } else { *lane };
        }
    }
    lanes.iter().chain(rest).fold(f32::INFINITY, |least, &distance| least.min(distance))
}

/// The smallest distance to a train descriptor of another group than that of `train`, infinite for none.
fn rival(row: &[f32], train: usize, groups: &Groups) -> f32 {
    match groups {
        Groups::Single => least(&row[..train]).min(least(&row[train + 1..])),
        Groups::Dense(groups) => {
            let others = row.iter().zip(groups).filter(|&(_, &group)| group != groups[train]);
            others.fold(f32::INFINITY, |least, (&distance, _)| least.min(distance))
        }
    }
}

/// Distance and index of the query nearest to any descriptor of each group; of equal ones the first query.
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

/// Which train descriptors show the same thing.
enum Groups {
    /// Each is a group of its own.
    Single,
    /// The group of each, numbered from 0.
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
