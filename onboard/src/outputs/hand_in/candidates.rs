//! Which images become keyframe candidates: those that the map was asked about, of each camera as the robot moves and the budget allows.

use super::budget::Budget;
use geometry::Pose;
use hand_in::{Answer, AnsweredMatch};
use protocol::{Descriptors, FeatureSet};
use std::collections::{BTreeMap, BTreeSet};

/// A candidate of a camera is taken when the robot has moved so far since the last one (m) ...
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

/// Features of an image, and what the map answered about it.
pub(super) type Described = (FeatureSet, Option<Answer>);

/// Selects candidates, of each camera by itself.
#[derive(Debug, Default)]
pub(super) struct Candidates {
    cameras: BTreeMap<usize, OfCamera>,
}

/// What was selected of a camera.
#[derive(Clone, Copy, Debug, Default)]
struct OfCamera {
    /// Time of its last candidate (ns), and where odometry said that the robot was.
    last: Option<(i64, Option<Pose>)>,
    /// Time of an image since then that was a new view and larger than the budget (ns), and its bytes.
    refused: Option<(i64, f64)>,
}

impl Candidates {
    /// Begins anew.
    pub(super) fn clear(&mut self) {
        self.cameras.clear();
    }

    /// The odometry frame has changed: poses before and after cannot be compared.
    pub(super) fn forget_pose(&mut self) {
        for (_, pose) in self.cameras.values_mut().filter_map(|camera| camera.last.as_mut()) {
            *pose = None;
        }
    }

    /// The features and the answers that are recorded of the images of one instant, by camera; those that are no candidates are left out.
    ///
    /// Where the budget is too small for all, cameras take turns.
    ///
    /// # Arguments
    /// * `local_from_imu`: where odometry says that the robot is: it selects and is not recorded.
    /// * `images`: by camera.
    pub(super) fn consider(
        &mut self,
        stamp_ns: i64,
        local_from_imu: Option<Pose>,
        mut images: BTreeMap<usize, Described>,
        budget: &mut Budget,
    ) -> BTreeMap<usize, Described> {
        let mut waiting: Vec<usize> = images.keys().copied().collect();
        waiting.sort_by_key(|&camera| self.turn(camera));
        let mut taken = BTreeMap::new();
        for camera in waiting {
            let of_camera = self.cameras.get(&camera).copied().unwrap_or_default();
            let Some(image) = images.remove(&camera) else { continue };
            if !of_camera.is_new_view(stamp_ns, local_from_imu) {
                continue;
            }
            let (features, answer) = strongest(image);
            let bytes = bytes_of(&features, answer.as_ref());
            let is_taken = budget.try_take(bytes, self.left_for_others(camera, stamp_ns));
            let now = if is_taken {
                taken.insert(camera, (features, answer));
                OfCamera { last: Some((stamp_ns, local_from_imu)), refused: None }
            } else {
                OfCamera { refused: Some((stamp_ns, bytes)), ..of_camera }
            };
            self.cameras.insert(camera, now);
        }
        taken
    }

    /// Cameras whose last candidate is older come first.
    fn turn(&self, camera: usize) -> (Option<i64>, usize) {
        let last = self.cameras.get(&camera).and_then(|of_camera| of_camera.last);
        (last.map(|(last_ns, _)| last_ns), camera)
    }

    /// Bytes of the budget that are kept for cameras whose turn is before that of one: they had a new view a while ago, and nothing was
    /// left for it.
    fn left_for_others(&self, camera: usize, stamp_ns: i64) -> f64 {
        let own = self.turn(camera);
        let others = self.cameras.iter().filter(|(other, _)| self.turn(**other) < own);
        let refused = others.filter_map(|(_, of_camera)| of_camera.refused);
        refused
            .filter(|(refused_ns, _)| stamp_ns - refused_ns <= LONGEST_REST_NS)
            .map(|(_, bytes)| bytes)
            .sum()
    }
}

impl OfCamera {
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

/// About how many bytes a candidate takes.
fn bytes_of(features: &FeatureSet, answer: Option<&Answer>) -> f64 {
    let matches = answer.map_or(0, |answer| answer.matches.len());
    let a_feature = PIXEL_BYTES + usize::from(features.descriptors.width);
    (features.len() * a_feature + matches * MATCH_BYTES) as f64
}

/// The features that were matched and the strongest of the others, in their order.
fn strongest((features, answer): Described) -> Described {
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
