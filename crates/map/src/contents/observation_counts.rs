//! How many observations each keyframe has.

use protocol::KeyframeId;

use crate::model::{Keyframe, Landmark};

/// Counts the observations by each keyframe, landmark by landmark.
#[derive(Clone, Debug)]
pub struct ObservationCounts {
    /// Ascending.
    keyframes: Vec<KeyframeId>,
    counts: Vec<u32>,
}

impl ObservationCounts {
    /// Counts for these keyframes, whose ids ascend.
    pub fn of(keyframes: &[Keyframe]) -> ObservationCounts {
        let keyframes: Vec<KeyframeId> = keyframes.iter().map(|keyframe| keyframe.id).collect();
        ObservationCounts { counts: vec![0; keyframes.len()], keyframes }
    }

    /// Adds those of a landmark. Observations by other keyframes are left out: such a map is not valid.
    pub fn add(&mut self, landmark: &Landmark) {
        self.add_observers(landmark.observations.iter().map(|observation| observation.keyframe));
    }

    /// Adds those of a landmark that these keyframes observe.
    pub(crate) fn add_observers(&mut self, keyframes: impl Iterator<Item = KeyframeId>) {
        for keyframe in keyframes {
            if let Ok(at) = self.keyframes.binary_search(&keyframe) {
                self.counts[at] = self.counts[at].saturating_add(1);
            }
        }
    }

    /// The counts in the order of the keyframes.
    pub fn finish(self) -> Vec<u32> {
        self.counts
    }
}
