//! One keyframe of the map as a consider (nuisance) state.

use crate::KeyframeId;
use crate::linear_algebra::dense::Dense;
use geometry::PoseWithCovariance;
use nalgebra::Matrix6;
use std::sync::Arc;

/// Size of a keyframe's error: rotation, then position.
pub const KEYFRAME_DIM: usize = 6;

/// A keyframe of the map in the nuisance state.
#[derive(Clone, Debug)]
pub struct HeldKeyframe {
    /// Identity in the map.
    pub id: KeyframeId,
    /// Pose and covariance as the map states them. Never changed by the filter.
    pub global_from_keyframe: PoseWithCovariance,
    /// `U` of its error `U x + rest`, 6 rows; no columns where the map states none.
    pub(super) common: Arc<Dense>,
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

    /// The same of `rest`: what it does not have in common with other keyframes by `x`.
    pub(super) fn covariance_of_rest(&self) -> Matrix6<f64> {
        self.covariance() - self.common_with(self)
    }

    /// `U_a U_bᵀ`.
    pub(super) fn common_with(&self, other: &Self) -> Matrix6<f64> {
        if self.common.ncols() == 0 || other.common.ncols() == 0 {
            return Matrix6::zeros();
        }
        let product = self.common.view() * other.common.view().transpose();
        Matrix6::from_column_slice(product.as_slice())
    }
}
