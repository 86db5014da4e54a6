//! Association of the poses of two trajectories by time.

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
/// * `max_difference_ns`: largest time difference of a pair, nanoseconds; 10 ms is usual.
///
/// # Returns
/// The pairs in order of time. Poses without a partner are left out.
///
/// ```
/// use evaluation::trajectory::StampedPose;
/// use evaluation::{Pair, associate};
/// use geometry::Pose;
///
/// let at = |stamp_ns| StampedPose { stamp_ns, pose: Pose::identity() };
/// let pairs = associate(&[at(0), at(100), at(200)], &[at(98), at(250)], 10);
/// assert_eq!(pairs, [Pair { reference: 1, estimate: 0 }]);
/// ```
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
