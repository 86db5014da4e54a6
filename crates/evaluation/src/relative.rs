//! Relative pose error (RPE): the difference between the estimated and the true motion over segments of a given length.

use super::{Pair, PoseErrors};
use crate::trajectory::StampedPose;

/// Length of a segment. Segments follow each other without overlap; the last, incomplete one is left out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Delta {
    /// Number of pairs of poses, at least 1.
    Frames(usize),
    /// Distance along the estimated path, metres, reached or exceeded by every segment.
    Metres(f64),
    /// Time, seconds, reached or exceeded by every segment.
    Seconds(f64),
}

/// The error of the motion over each segment. It does not depend on the alignment.
///
/// # Arguments
/// * `pairs`: indices into `reference` and `estimate`, from [`associate`](crate::associate).
///
/// # Panics
/// Where an index of a pair is out of range.
pub fn relative_errors(
    reference: &[StampedPose],
    estimate: &[StampedPose],
    pairs: &[Pair],
    delta: Delta,
) -> PoseErrors {
    let mut errors = PoseErrors::default();
    let ends = segment_ends(estimate, pairs, delta);
    for (from, to) in ends.iter().zip(ends.iter().skip(1)) {
        let (from, to) = (pairs[*from], pairs[*to]);
        let motion = |poses: &[StampedPose], from: usize, to: usize| {
            poses[from].pose.inverse().compose(&poses[to].pose)
        };
        let truth = motion(reference, from.reference, to.reference);
        errors.push(&truth, &motion(estimate, from.estimate, to.estimate));
    }
    errors
}

/// Ends of the segments, as indices of pairs; the first is the first pair.
fn segment_ends(estimate: &[StampedPose], pairs: &[Pair], delta: Delta) -> Vec<usize> {
    if let Delta::Frames(step) = delta {
        return (0..pairs.len()).step_by(step.max(1)).collect();
    }
    let mut ends = Vec::new();
    let mut covered = 0.0;
    for (index, pair) in pairs.iter().enumerate() {
        let pose = &estimate[pair.estimate];
        if let Some(before) = index.checked_sub(1).map(|before| &estimate[pairs[before].estimate]) {
            covered += match delta {
                Delta::Seconds(_) => (pose.stamp_ns - before.stamp_ns) as f64 * 1e-9,
                _ => (pose.pose.translation - before.pose.translation).norm(),
            };
        }
        let (Delta::Metres(wanted) | Delta::Seconds(wanted)) = delta else { continue };
        if index == 0 || covered >= wanted {
            ends.push(index);
            covered = 0.0;
        }
    }
    ends
}
