//! One keyframe of the map as a consider (nuisance) state.

use crate::KeyframeId;
use geometry::PoseWithCovariance;
use nalgebra::Matrix6;

/// Size of a keyframe's error: rotation, then position.
pub const KEYFRAME_DIM: usize = 6;

/// A keyframe of the map in the nuisance state.
#[derive(Clone, Debug)]
pub struct HeldKeyframe {
    /// Identity in the map.
    pub id: KeyframeId,
    /// Pose and covariance as the map states them. Never changed by the filter.
    pub global_from_keyframe: PoseWithCovariance,
    /// Factor on the stated covariance: 1 unless the keyframe was evicted before.
    pub(super) inflation: f64,
    /// Serial number of its last use; unique.
    pub(super) last_used: u64,
}

impl HeldKeyframe {
    /// Covariance that the filter uses, without the inflation of the whole map.
    pub(super) fn covariance(&self) -> Matrix6<f64> {
        self.global_from_keyframe.covariance * self.inflation
    }
}
