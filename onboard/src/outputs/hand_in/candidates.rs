//! Which images become keyframe candidates: those that the map was asked about, as the robot moves and the budget allows.

use super::budget::Budget;
use geometry::Pose;
use hand_in::{Answer, AnsweredMatch};
use protocol::{Descriptors, FeatureSet};
use std::collections::BTreeSet;

/// A candidate is taken when the robot has moved so far since the last one (m) ...
const LEAST_DISTANCE_M: f64 = 0.15;
/// ... or has turned by so much (rad), ...
const LEAST_ROTATION_RAD: f64 = 0.07;
/// ... or after so long, also at rest, so that the map hears what is still there (ns).
const LONGEST_REST_NS: i64 = 20_000_000_000;
/// Where the robot does not know how far it has moved, one in so long (ns).
const WITHOUT_POSE_NS: i64 = 2_000_000_000;
/// Most features of a candidate: those that were matched, then the strongest.
const MOST_FEATURES: usize = 250;
/// Bytes of a pixel, about.
const PIXEL_BYTES: usize = 4;
/// Bytes of a match in an answer, about.
const MATCH_BYTES: usize = 5;

/// Selects candidates.
#[derive(Debug, Default)]
pub(super) struct Candidates {
    last: Option<(i64, Option<Pose>)>,
}

impl Candidates {
    /// Begins anew.
    pub(super) fn clear(&mut self) {
        self.last = None;
    }

    /// The odometry frame has changed: poses before and after cannot be compared.
    pub(super) fn forget_pose(&mut self) {
        if let Some((_, pose)) = &mut self.last {
            *pose = None;
        }
    }

    /// The features and the answer that are recorded of an image; `None` where it is no candidate.
    ///
    /// # Arguments
    /// * `local_from_imu`: where odometry says that the robot is: it selects and is not recorded.
    pub(super) fn consider(
        &mut self,
        stamp_ns: i64,
        local_from_imu: Option<Pose>,
        (features, answer): (FeatureSet, Option<Answer>),
        budget: &mut Budget,
    ) -> Option<(FeatureSet, Option<Answer>)> {
        if !self.is_new_view(stamp_ns, local_from_imu) {
            return None;
        }
        let (features, answer) = strongest(features, answer);
        let matches = answer.as_ref().map_or(0, |answer| answer.matches.len());
        let a_feature = PIXEL_BYTES + usize::from(features.descriptors.width);
        let bytes = features.len() * a_feature + matches * MATCH_BYTES;
        budget.try_take(bytes as f64).then(|| {
            self.last = Some((stamp_ns, local_from_imu));
            (features, answer)
        })
    }

    fn is_new_view(&self, stamp_ns: i64, local_from_imu: Option<Pose>) -> bool {
        let Some((last_ns, last)) = &self.last else { return true };
        let elapsed_ns = stamp_ns - last_ns;
        let has_moved =
            last.as_ref().zip(local_from_imu).map_or(elapsed_ns >= WITHOUT_POSE_NS, |(last, now)| {
                (last.translation - now.translation).norm() >= LEAST_DISTANCE_M
                    || last.rotation.angle_to(&now.rotation) >= LEAST_ROTATION_RAD
            });
        has_moved || elapsed_ns >= LONGEST_REST_NS
    }
}

/// The features that were matched and the strongest of the others, in their order.
fn strongest(features: FeatureSet, answer: Option<Answer>) -> (FeatureSet, Option<Answer>) {
    if features.len() <= MOST_FEATURES {
        return (features, answer);
    }
    let matches = answer.iter().flat_map(|answer| &answer.matches);
    let mut kept: BTreeSet<usize> = matches.map(|found| found.feature as usize).collect();
    let mut others = 0..features.len();
    while kept.len() < MOST_FEATURES
        && let Some(next) = others.next()
    {
        kept.insert(next);
    }
    let kept: Vec<usize> = kept.into_iter().filter(|at| *at < features.len()).collect();
    let bytes = kept.iter().filter_map(|&at| features.descriptors.get(at)).flatten().copied().collect();
    let chosen = FeatureSet {
        pixels: kept.iter().map(|&at| features.pixels[at]).collect(),
        descriptors: Descriptors { bytes, ..features.descriptors },
        extractor: features.extractor,
    };
    let renumbered = |found: &AnsweredMatch| {
        let feature = u32::try_from(kept.binary_search(&(found.feature as usize)).ok()?).ok()?;
        Some(AnsweredMatch { feature, ..*found })
    };
    let answer = answer
        .map(|answer| Answer { matches: answer.matches.iter().filter_map(renumbered).collect(), ..answer });
    (chosen, answer)
}
