//! Which poses of two trajectories belong together: the nearest in time.

use crate::trajectory::StampedPose;

/// Poses of two trajectories at (nearly) the same time, by index.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pair {
    /// Index in the reference.
    pub reference: usize,
    /// Index in the estimate.
    pub estimate: usize,
}

/// Pairs each pose of the shorter trajectory with the nearest in time of the longer one.
///
/// # Arguments
/// * `reference`, `estimate`: in order of time.
/// * `max_difference_ns`: what is further apart has no partner; 10 ms is customary.
pub fn associate(reference: &[StampedPose], estimate: &[StampedPose], max_difference_ns: i64) -> Vec<Pair> {
    if estimate.len() > reference.len() {
        let pairs = nearest(reference, estimate, max_difference_ns);
        return pairs.map(|(reference, estimate)| Pair { reference, estimate }).collect();
    }
    let pairs = nearest(estimate, reference, max_difference_ns);
    pairs.map(|(estimate, reference)| Pair { reference, estimate }).collect()
}

/// For each pose of `few` the nearest of `many`; of two equally near the earlier one.
fn nearest<'a>(
    few: &'a [StampedPose],
    many: &'a [StampedPose],
    max_difference_ns: i64,
) -> impl Iterator<Item = (usize, usize)> + 'a {
    few.iter().enumerate().filter_map(move |(index, pose)| {
        let after = many.partition_point(|other| other.stamp_ns < pose.stamp_ns);
        let candidates = [after.checked_sub(1), Some(after)].into_iter().flatten();
        let difference = |other: &usize| (many[*other].stamp_ns - pose.stamp_ns).abs();
        let best = candidates.filter(|other| *other < many.len()).min_by_key(difference)?;
        (difference(&best) <= max_difference_ns).then_some((index, best))
    })
}
