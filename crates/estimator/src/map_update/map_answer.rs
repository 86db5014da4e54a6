//! The answer of a map to the query of one image.

use crate::KeyframeId;
use geometry::{Camera, PoseWithCovariance};
use nalgebra::{Matrix6, Matrix6xX, SMatrix, Vector2, Vector3};
use std::collections::{HashMap, HashSet};

/// A keyframe of the map that shares landmarks with the image.
#[derive(Clone, Debug)]
pub struct MapKeyframe {
    /// Identity within the map.
    pub id: KeyframeId,
    /// Camera pose in G with the covariance of its error in G.
    pub global_from_keyframe: PoseWithCovariance,
    /// Intrinsics of its camera.
    pub camera: Camera,
    /// Its part of the error common to all keyframes: `U` of its error `U x + rest`, where `x` holds independent standard
    /// normal numbers, the same for the whole map. Without columns where the map states nothing of that, and of keyframes
    /// that the filter held at the time of the query.
    pub common_error: Matrix6xX<f64>,
    /// Cross-covariances of the rest with that of other keyframes, `E[own otherᵀ]`. A keyframe that is not listed is
    /// independent; two that the filter held at the time of the query are never listed.
    pub cross_covariances: Vec<(KeyframeId, Matrix6<f64>)>,
}

impl MapKeyframe {
    /// Whether the map states how its error is correlated with that of any other keyframe.
    pub(crate) fn is_correlated(&self) -> bool {
        self.common_error.ncols() > 0 || !self.cross_covariances.is_empty()
    }
}

/// A landmark of the map that is matched with a feature of the image.
#[derive(Clone, Debug)]
pub struct MatchedLandmark {
    /// Its pixel in the current image, as the camera sees it (distorted); of a rolling shutter the
    /// [`still_pixel`](crate::Estimator::still_pixel).
    pub pixel: Vector2<f64>,
    /// The keyframe in whose camera frame its position is given.
    pub anchor: KeyframeId,
    /// Position in the anchor's camera frame, metres; used as linearization point only, not as a measurement.
    pub position_in_anchor: Vector3<f64>,
    /// Its pixels in keyframes, the anchor included.
    pub observations: Vec<(KeyframeId, Vector2<f64>)>,
}

/// The answer of a map to the query of one image.
#[derive(Clone, Debug)]
pub struct MapAnswer {
    /// Version of the map.
    pub map_version: u64,
    /// Identity of the map: the same for all its versions, different for different maps.
    pub map_identity: u128,
    /// The camera whose image was matched, by [`TrackObservation::camera`](crate::TrackObservation::camera).
    pub camera: usize,
    /// Best first.
    pub keyframes: Vec<MapKeyframe>,
    /// Keyframes held by the filter at the time of the query. The answer states how all others are correlated with them, and
    /// assumes that the filter knows how they are correlated with each other.
    pub held_at_query: Vec<KeyframeId>,
    /// Matched landmarks.
    pub landmarks: Vec<MatchedLandmark>,
    /// Unit vector along gravity in G, where the map has it.
    pub gravity_in_global: Option<Vector3<f64>>,
    /// Noise of the map's pixels, px.
    pub sigma_map_px: f64,
    /// Natural logarithm of the odds that the image is of this place, and not of a picture that repeats, both being equally
    /// likely before.
    pub log_odds: f64,
    /// What of it holds for the map before any image is seen; it counts once for all places that say the same.
    pub log_prior_odds: f64,
}

impl MapAnswer {
    /// The keyframe `id` of this answer.
    pub fn keyframe(&self, id: KeyframeId) -> Option<&MapKeyframe> {
        self.keyframes.iter().find(|keyframe| keyframe.id == id)
    }

    /// Removes keyframes that the filter has dropped since the query: the answer does not state their correlations.
    /// [`Self::remove_dangling_references`] is to follow.
    ///
    /// # Arguments
    /// * `held`: keyframes that the filter holds now.
    pub(crate) fn remove_forgotten(&mut self, held: &[KeyframeId]) {
        let forgotten = |id: &KeyframeId| self.held_at_query.contains(id) && !held.contains(id);
        self.keyframes.retain(|keyframe| !forgotten(&keyframe.id));
    }

    /// Removes keyframes whose cross-covariance with keyframes added after the query is unknown.
    /// [`Self::remove_dangling_references`] is to follow.
    /// Treating them as independent could be inconsistent with the correlation of both with a third keyframe.
    ///
    /// # Arguments
    /// * `held`: keyframes that the filter holds now.
    pub(crate) fn remove_unknown_correlations(&mut self, held: &[KeyframeId]) {
        let answered = self.keyframes.iter().map(|keyframe| keyframe.id);
        let stated: HashSet<KeyframeId> = self.held_at_query.iter().copied().chain(answered).collect();
        if !held.iter().all(|id| stated.contains(id)) {
            self.keyframes.retain(|keyframe| held.contains(&keyframe.id));
        }
    }

    /// Removes landmarks and observations of keyframes that are not in the answer.
    pub(crate) fn remove_dangling_references(&mut self) {
        let known: Vec<KeyframeId> = self.keyframes.iter().map(|keyframe| keyframe.id).collect();
        self.landmarks.retain(|landmark| known.contains(&landmark.anchor));
        for landmark in &mut self.landmarks {
            landmark.observations.retain(|(id, _)| known.contains(id));
        }
    }

    /// Removes keyframes whose pose or covariance is invalid or whose cross-covariances are inconsistent with the
    /// covariances, what refers to them, and values that are not finite.
    ///
    /// # Arguments
    /// * `held`: covariance of a keyframe that the filter holds already: of its error, and of the rest of it.
    /// * `common_dim`: how many numbers of `x` the filter knows; `None` where it knows none.
    #[must_use]
    pub(crate) fn without_invalid(
        mut self,
        held: &dyn Fn(KeyframeId) -> Option<[Matrix6<f64>; 2]>,
        common_dim: Option<usize>,
    ) -> Self {
        self.keyframes.retain(|keyframe| keyframe.global_from_keyframe.is_plausible());
        let mut dims = self.keyframes.iter().map(|keyframe| keyframe.common_error.ncols());
        let dim = common_dim.or_else(|| dims.find(|dim| *dim > 0)).unwrap_or(0);
        let stated: HashMap<KeyframeId, [Matrix6<f64>; 2]> =
            self.keyframes.iter().map(|keyframe| (keyframe.id, stated_covariance(keyframe))).collect();
        let covariance_of = |id| held(id).or_else(|| stated.get(&id).copied());
        self.keyframes.retain(|keyframe| {
            let Some(own) = covariance_of(keyframe.id) else { return false };
            let common = &keyframe.common_error;
            let is_valid = common.ncols() == 0 || common.ncols() == dim;
            let is_alone_valid = is_joint_covariance(&own, &own, &Matrix6::zeros());
            is_valid
                && is_alone_valid
                && keyframe.cross_covariances.iter().all(|(other, block)| {
                    covariance_of(*other).is_none_or(|other| is_joint_covariance(&own, &other, block))
                })
        });
        self.remove_dangling_references();
        self.landmarks.retain(|landmark| {
            let numbers = landmark.pixel.iter().chain(landmark.position_in_anchor.iter());
            numbers.into_iter().all(|value| value.is_finite()) && landmark.position_in_anchor.z > 0.0
        });
        for landmark in &mut self.landmarks {
            landmark.observations.retain(|(_, pixel)| pixel.iter().all(|value| value.is_finite()));
        }
        let direction = |gravity: &Vector3<f64>| (gravity.norm() - 1.0).abs() < 1e-3;
        self.gravity_in_global = self.gravity_in_global.filter(direction);
        if !(self.log_odds.is_finite() && self.log_prior_odds.is_finite()) {
            (self.log_odds, self.log_prior_odds) = (0.0, 0.0);
        }
        self
    }
}

/// The covariance of a keyframe's error, and of the rest of it.
fn stated_covariance(keyframe: &MapKeyframe) -> [Matrix6<f64>; 2] {
    let covariance = keyframe.global_from_keyframe.covariance;
    [covariance, covariance - &keyframe.common_error * keyframe.common_error.transpose()]
}

/// Whether two covariances with a cross-covariance are a valid joint covariance, of what two errors are beyond what they have
/// in common.
///
/// # Arguments
/// * `a`, `b`: covariance of the error, and of the rest of it.
fn is_joint_covariance(a: &[Matrix6<f64>; 2], b: &[Matrix6<f64>; 2], block: &Matrix6<f64>) -> bool {
    let mut joint = SMatrix::<f64, 12, 12>::zeros();
    joint.fixed_view_mut::<6, 6>(0, 0).copy_from(&a[1]);
    joint.fixed_view_mut::<6, 6>(6, 6).copy_from(&b[1]);
    joint.fixed_view_mut::<6, 6>(0, 6).copy_from(block);
    joint.fixed_view_mut::<6, 6>(6, 0).copy_from(&block.transpose());
    for k in 0..12 {
        let variance = if k < 6 { a[0][(k, k)] } else { b[0][(k - 6, k - 6)] };
        // Tolerance for rounding, and for a keyframe without uncertainty.
        joint[(k, k)] += 1e-9 * variance + 1e-18;
    }
    joint.iter().all(|value| value.is_finite()) && joint.cholesky().is_some()
}
