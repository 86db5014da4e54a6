//! Keyframes that were deactivated at about the same time, and the transition from there to the next level.

use super::keyframe::HeldKeyframe;
use crate::KeyframeId;
use crate::linear_algebra::dense::Dense;
use std::collections::BTreeSet;

/// A held keyframe that no recent measurement used.
#[derive(Clone, Debug)]
pub struct InactiveKeyframe {
    pub keyframe: HeldKeyframe,
    /// Rows of its level x 6.
    pub sensitivity: Dense,
    /// Serial number of its level.
    pub level: u64,
}

/// One time in the past, to which the sensitivities of its members refer.
#[derive(Clone, Debug)]
pub struct Level {
    /// Grows from older to newer levels.
    pub serial: u64,
    pub members: BTreeSet<KeyframeId>,
    /// Rows of the next level x rows of this one. Empty in the newest level, whose transition still grows.
    pub transition_to_next: Dense,
    /// Whether `transition_to_next` has full column rank.
    pub is_reduced: bool,
}

impl Level {
    /// The newest level.
    pub fn new(serial: u64) -> Self {
        Self { serial, members: BTreeSet::new(), transition_to_next: Dense::default(), is_reduced: false }
    }
}
