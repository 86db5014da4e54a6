//! Association of the poses of two trajectories by time.

use crate::trajectory::StampedPose;
use sensors::{TruthRow, TruthTrack};

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

/// The reference at the times of an estimate, interpolated between poses that are at most `max_gap_ns` apart.
///
/// # Returns
/// The interpolated reference, and the pairs of its poses with those of the estimate.
///
/// ```
/// use evaluation::trajectory::StampedPose;
/// use evaluation::{Pair, interpolate_reference};
/// use geometry::Pose;
/// use nalgebra::{UnitQuaternion, Vector3};
///
/// let at = |stamp_ns, x| {
///     StampedPose { stamp_ns, pose: Pose::new(UnitQuaternion::identity(), Vector3::x() * x) }
/// };
/// let (reference, pairs) = interpolate_reference(&[at(0, 1.0), at(100, 3.0)], &[at(-10, 0.0), at(25, 0.0)], 200);
/// assert_eq!(reference, [at(25, 1.5)]);
/// assert_eq!(pairs, [Pair { reference: 0, estimate: 1 }]);
/// ```
pub fn interpolate_reference(
    reference: &[StampedPose],
    estimate: &[StampedPose],
    max_gap_ns: i64,
) -> (Vec<StampedPose>, Vec<Pair>) {
    let rows: Vec<TruthRow> = reference.iter().map(|row| TruthRow::of_pose(row.stamp_ns, row.pose)).collect();
    let track = TruthTrack::new(&rows);
    let (mut interpolated, mut pairs) = (Vec::new(), Vec::new());
    for (index, row) in estimate.iter().enumerate() {
        let Some(pose) = track.pose(row.stamp_ns, max_gap_ns) else { continue };
        pairs.push(Pair { reference: interpolated.len(), estimate: index });
        interpolated.push(StampedPose { stamp_ns: row.stamp_ns, pose });
    }
    (interpolated, pairs)
}
