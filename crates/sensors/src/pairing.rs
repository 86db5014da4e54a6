//! Which images of two cameras make a pair: one rule for folders, bags and live sensors.
//!
//! An image is paired with the one of the other camera whose stamp is nearest, if their stamps differ by no more than a
//! tolerance, and with no second one. A pair has the stamp of camera 0. An image of camera 0 without a partner is used
//! as that of one camera, one of camera 1 is left out.

/// Largest difference between the stamps of the images of a pair, nanoseconds, unless another is asked for. Cameras that
/// are triggered together are stamped by their drivers a few milliseconds apart; at 100 Hz it is half a period.
pub const PAIR_TOLERANCE_NS: i64 = 5_000_000;

/// Pairs and lone images of a stereo recording.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct PairCounts {
    /// Frames with an image of both cameras.
    pub pairs: usize,
    /// Images of camera 0 without a partner: used as those of one camera.
    pub lone_first: usize,
    /// Images of camera 1 without a partner: left out.
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

/// The frames of two cameras: for each image of camera 0 the number of its partner, where it has one.
///
/// # Arguments
/// * `first`, `second`: stamps of both cameras, strictly increasing, nanoseconds.
pub(crate) fn pair(first: &[i64], second: &[i64], tolerance_ns: i64) -> (Vec<Option<usize>>, PairCounts) {
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
                 cam0 have no partner within {tolerance_ms} ms and are used alone, {lone_second} of cam1 are left out \
                 (--pair-tolerance-ms)"
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

    #[test]
    fn extreme_stamps_pair_with_nothing() {
        let (partners, counts) = pair(&[i64::MIN, i64::MAX], &[0], PAIR_TOLERANCE_NS);
        assert_eq!((partners, counts.lone_second), (vec![None, None], 1));
    }
}
