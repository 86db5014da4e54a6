//! Which images make a frame: one rule for folders, bags and live sensors.
//!
//! An image is paired with the one of another camera whose stamp is nearest, if their stamps differ by no more than a
//! tolerance, and with no second one. A frame has the stamp of its first camera. Of a stereo pair, an image of the first camera
//! without a partner is used as that of one camera, one of the second is left out. Cameras that are no pair need no partner: their
//! images are joined to the frame of the others where there is one, and are a frame of their own where there is none.

use crate::{CameraSensor, camera_groups};
use geometry::CameraGroup;

/// Largest difference between the stamps of the images of a pair, nanoseconds, unless another is asked for. Cameras that
/// are triggered together are stamped by their drivers a few milliseconds apart; at 100 Hz it is half a period.
pub const PAIR_TOLERANCE_NS: i64 = 5_000_000;

/// Stereo pairs and lone images of a recording, of all stereo pairs of its cameras.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct PairCounts {
    /// Frames with an image of both cameras.
    pub pairs: usize,
    /// Images of the first camera of a pair without a partner: used as those of one camera.
    pub lone_first: usize,
    /// Images of the second camera of a pair without a partner: left out.
    pub lone_second: usize,
    /// Largest difference between the stamps of a pair, nanoseconds.
    pub largest_difference_ns: i64,
}

/// The stamp that is nearest, within the tolerance; of two that are equally near the first that is given.
pub(crate) fn nearest(
    stamp_ns: i64,
    candidates: impl Iterator<Item = i64>,
    tolerance_ns: i64,
) -> Option<i64> {
    candidates
        .filter(|candidate_ns| candidate_ns.abs_diff(stamp_ns) <= tolerance_ns.unsigned_abs())
        .min_by_key(|candidate_ns| candidate_ns.abs_diff(stamp_ns))
}

/// The images that make a frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct JoinedImages {
    /// Stamp of the frame, nanoseconds.
    pub(crate) stamp_ns: i64,
    /// For each camera the number of its image, where it has one.
    pub(crate) images: Vec<Option<usize>>,
}

/// [`join`] for cameras whose stamps are corrected first by what their time shifts say of them.
///
/// # Arguments
/// * `stamps`: of each camera's images as they were recorded, strictly increasing, nanoseconds.
pub(crate) fn join_recorded<I: Iterator<Item = i64>>(
    cameras: &[CameraSensor],
    stamps: impl Iterator<Item = I>,
    tolerance_ns: i64,
) -> (Vec<JoinedImages>, Option<PairCounts>) {
    let shifted = |(stamps, camera): (I, &CameraSensor)| -> Vec<i64> {
        stamps.map(|stamp_ns| stamp_ns.saturating_add(camera.stamp_shift_ns())).collect()
    };
    let stamps: Vec<Vec<i64>> = stamps.zip(cameras).map(shifted).collect();
    let stamps: Vec<&[i64]> = stamps.iter().map(Vec::as_slice).collect();
    join(&camera_groups(cameras), &stamps, tolerance_ns)
}

/// The frames of the cameras of a rig, in order of time.
///
/// # Arguments
/// * `stamps`: of each camera's images, strictly increasing, nanoseconds.
///
/// # Returns
/// The frames, and how many stereo pairs they have; `None` without such a group.
fn join(
    groups: &[CameraGroup],
    stamps: &[&[i64]],
    tolerance_ns: i64,
) -> (Vec<JoinedImages>, Option<PairCounts>) {
    let mut frames = Vec::new();
    let mut pairs: Option<PairCounts> = None;
    for group in groups {
        let first = stamps[group.first];
        let partners = group.second.map(|second| {
            let (partners, counts) = pair(first, stamps[second], tolerance_ns);
            pairs.get_or_insert_default().add(&counts);
            (second, partners)
        });
        let frame = |(number, stamp_ns): (usize, &i64)| {
            let mut images = vec![None; stamps.len()];
            images[group.first] = Some(number);
            if let Some((second, partners)) = &partners {
                images[*second] = partners[number];
            }
            JoinedImages { stamp_ns: *stamp_ns, images }
        };
        let of_group: Vec<JoinedImages> = first.iter().enumerate().map(frame).collect();
        frames = merged(frames, of_group, tolerance_ns);
    }
    (frames, pairs)
}

/// The frames of two groups of cameras: those that belong together are joined.
fn merged(mut frames: Vec<JoinedImages>, others: Vec<JoinedImages>, tolerance_ns: i64) -> Vec<JoinedImages> {
    let stamps =
        |frames: &[JoinedImages]| -> Vec<i64> { frames.iter().map(|frame| frame.stamp_ns).collect() };
    let (partners, _) = pair(&stamps(&frames), &stamps(&others), tolerance_ns);
    let mut others: Vec<Option<JoinedImages>> = others.into_iter().map(Some).collect();
    for (frame, partner) in frames.iter_mut().zip(partners) {
        let Some(other) = partner.and_then(|number| others[number].take()) else { continue };
        for (image, of_other) in frame.images.iter_mut().zip(other.images) {
            *image = image.or(of_other);
        }
    }
    frames.extend(others.into_iter().flatten());
    frames.sort_by_key(|frame| frame.stamp_ns);
    frames
}

/// The frames of two cameras: for each image of camera 0 the number of its partner, where it has one.
///
/// # Arguments
/// * `first`, `second`: stamps of both cameras, strictly increasing, nanoseconds.
fn pair(first: &[i64], second: &[i64], tolerance_ns: i64) -> (Vec<Option<usize>>, PairCounts) {
    let mut counts = PairCounts::default();
    let mut partners = Vec::with_capacity(first.len());
    // Images of camera 1 before this one have a partner, or are too early for one.
    let mut next = 0;
    for (index, &stamp_ns) in first.iter().enumerate() {
        let begin = next + second[next..].partition_point(|ns| *ns < stamp_ns.saturating_sub(tolerance_ns));
        let end = begin + second[begin..].partition_point(|ns| *ns <= stamp_ns.saturating_add(tolerance_ns));
        // One that is nearer to the next image of camera 0 is left to that.
        let following = first.get(index + 1);
        let is_ours =
            |ns: &i64| following.is_none_or(|following| ns.abs_diff(stamp_ns) <= ns.abs_diff(*following));
        let ours = second[begin..end].iter().copied().filter(is_ours);
        let partner = nearest(stamp_ns, ours, tolerance_ns)
            .map(|partner_ns| begin + second[begin..end].partition_point(|ns| *ns < partner_ns));
        match partner {
            Some(number) => {
                next = number + 1;
                counts.pairs += 1;
                let difference_ns = second[number].saturating_sub(stamp_ns).saturating_abs();
                counts.largest_difference_ns = counts.largest_difference_ns.max(difference_ns);
            }
            None => counts.lone_first += 1,
        }
        partners.push(partner);
    }
    counts.lone_second = second.len() - counts.pairs;
    (partners, counts)
}

impl PairCounts {
    /// Adds those of another stereo pair.
    fn add(&mut self, of_pair: &Self) {
        self.pairs += of_pair.pairs;
        self.lone_first += of_pair.lone_first;
        self.lone_second += of_pair.lone_second;
        self.largest_difference_ns = self.largest_difference_ns.max(of_pair.largest_difference_ns);
    }

    /// Says how many pairs a recording has: a warning where images are left alone.
    pub(crate) fn tell(&self, recording: &str, tolerance_ns: i64) {
        let Self { pairs, lone_first, lone_second, .. } = self;
        let difference_ms = self.largest_difference_ns as f64 * 1e-6;
        let tolerance_ms = tolerance_ns as f64 * 1e-6;
        if lone_first + lone_second == 0 {
            tracing::info!(
                "{recording}: {pairs} stereo pairs, whose stamps differ by at most {difference_ms:.3} ms"
            );
        } else {
            tracing::warn!(
                "{recording}: {pairs} stereo pairs, whose stamps differ by at most {difference_ms:.3} ms; {lone_first} images of \
                 the first camera have no partner within {tolerance_ms} ms and are used alone, {lone_second} of the second are left \
                 out (--pair-tolerance-ms)"
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    /// Pairs of the stamps in milliseconds, and the number of lone images of either camera.
    fn paired(first: &[i64], second: &[i64]) -> (Vec<(i64, i64)>, usize, usize) {
        let scaled = |stamps: &[i64]| stamps.iter().map(|ms| ms * MS).collect::<Vec<_>>();
        let (partners, counts) = pair(&scaled(first), &scaled(second), PAIR_TOLERANCE_NS);
        let of =
            |(index, partner): (usize, &Option<usize>)| partner.map(|number| (first[index], second[number]));
        let pairs: Vec<_> = partners.iter().enumerate().filter_map(of).collect();
        assert_eq!(pairs.len(), counts.pairs);
        let largest_ms = pairs.iter().map(|(a, b)| (a - b).abs()).max().unwrap_or(0);
        assert_eq!(counts.largest_difference_ns, largest_ms * MS);
        (pairs, counts.lone_first, counts.lone_second)
    }

    #[test]
    fn the_nearest_image_is_the_partner_and_has_no_other() {
        for (name, first, second, pairs, lone_first, lone_second) in [
            ("same stamps", &[0, 50, 100][..], &[0, 50, 100][..], vec![(0, 0), (50, 50), (100, 100)], 0, 0),
            ("always late", &[0, 50, 100], &[3, 53, 103], vec![(0, 3), (50, 53), (100, 103)], 0, 0),
            ("early and late", &[10, 60], &[8, 62], vec![(10, 8), (60, 62)], 0, 0),
            ("at the tolerance", &[0, 50], &[5, 44], vec![(0, 5)], 1, 1),
            ("half the rate", &[0, 50, 100], &[2, 102], vec![(0, 2), (100, 102)], 1, 0),
            ("the second is faster", &[0, 50], &[0, 25, 50, 75], vec![(0, 0), (50, 50)], 0, 2),
            ("two could be meant", &[10], &[7, 11], vec![(10, 11)], 0, 1),
            ("the next one is nearer", &[10, 16], &[15], vec![(16, 15)], 1, 0),
            ("one camera is silent", &[0, 50], &[], vec![], 2, 0),
            ("the first is silent", &[], &[0, 50], vec![], 0, 2),
        ] {
            assert_eq!(paired(first, second), (pairs, lone_first, lone_second), "{name}");
        }
    }

    /// The stamps of each frame and of its images, milliseconds.
    fn joined(groups: &[(usize, Option<usize>)], stamps: &[&[i64]]) -> Vec<(i64, Vec<Option<i64>>)> {
        let groups: Vec<CameraGroup> =
            groups.iter().map(|&(first, second)| CameraGroup { first, second }).collect();
        let scaled: Vec<Vec<i64>> =
            stamps.iter().map(|stamps| stamps.iter().map(|ms| ms * MS).collect()).collect();
        let scaled: Vec<&[i64]> = scaled.iter().map(Vec::as_slice).collect();
        let (frames, pairs) = join(&groups, &scaled, PAIR_TOLERANCE_NS);
        assert_eq!(pairs.is_some(), groups.iter().any(|group| group.second.is_some()));
        assert!(frames.is_sorted_by(|a, b| a.stamp_ns < b.stamp_ns));
        let images = |frame: JoinedImages| {
            let stamp =
                |(camera, number): (usize, Option<usize>)| number.map(|number| stamps[camera][number]);
            (frame.stamp_ns / MS, frame.images.into_iter().enumerate().map(stamp).collect())
        };
        frames.into_iter().map(images).collect()
    }

    #[test]
    fn cameras_that_are_no_pair_are_joined_where_they_can_be_and_never_left_out() {
        let alone = [(0, None), (1, None)];
        // Together, one of them missing once each.
        assert_eq!(
            joined(&alone, &[&[0, 100], &[2, 50, 102]]),
            [(0, vec![Some(0), Some(2)]), (50, vec![None, Some(50)]), (100, vec![Some(100), Some(102)])]
        );
        // In turn, and with a camera that is dead.
        assert_eq!(
            joined(&alone, &[&[0, 100], &[50]]),
            [(0, vec![Some(0), None]), (50, vec![None, Some(50)]), (100, vec![Some(100), None])]
        );
        assert_eq!(joined(&alone, &[&[], &[50]]), [(50, vec![None, Some(50)])]);
        // A lone image of the second camera of a pair is left out, one of a third camera is not.
        assert_eq!(
            joined(&[(0, Some(2)), (1, None)], &[&[0], &[3, 50], &[1, 51]]),
            [(0, vec![Some(0), Some(3), Some(1)]), (50, vec![None, Some(50), None])]
        );
    }

    #[test]
    fn extreme_stamps_pair_with_nothing() {
        let (partners, counts) = pair(&[i64::MIN, i64::MAX], &[0], PAIR_TOLERANCE_NS);
        assert_eq!((partners, counts.lone_second), (vec![None, None], 1));
    }
}
