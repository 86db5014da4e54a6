//! The answer of a map to the query of one image.

use crate::KeyframeId;
use geometry::{Camera, PoseWithCovariance};
use nalgebra::{Matrix6, SMatrix, Vector2, Vector3};
use std::collections::HashSet;

/// A keyframe of the map that shares landmarks with the image.
#[derive(Clone, Debug)]
pub struct MapKeyframe {
    /// Identity within the map.
    pub id: KeyframeId,
    /// Camera pose in G with the covariance of its error in G.
    pub global_from_keyframe: PoseWithCovariance,
    /// Intrinsics of its camera.
    pub camera: Camera,
    /// Cross-covariances with other keyframes, `E[own otherᵀ]`. A keyframe that is not listed is independent.
    pub cross_covariances: Vec<(KeyframeId, Matrix6<f64>)>,
}

/// A landmark of the map that is matched with a feature of the image.
#[derive(Clone, Debug)]
pub struct MatchedLandmark {
    /// Its pixel in the current image, as the camera sees it (distorted).
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
    /// Best first.
    pub keyframes: Vec<MapKeyframe>,
    /// Keyframes held by the filter at the time of the query; the answer contains its cross-covariances with them.
    pub held_at_query: Vec<KeyframeId>,
    /// Matched landmarks.
    pub landmarks: Vec<MatchedLandmark>,
    /// Unit vector along gravity in G, where the map has it.
    pub gravity_in_global: Option<Vector3<f64>>,
    /// Noise of the map's pixels, px.
    pub sigma_map_px: f64,
}

impl MapAnswer {
    /// The keyframe `id` of this answer.
    pub fn keyframe(&self, id: KeyframeId) -> Option<&MapKeyframe> {
        self.keyframes.iter().find(|keyframe| keyframe.id == id)
    }

    /// Removes keyframes whose cross-covariance with keyframes added after the query is unknown, and what refers to them.
    /// Treating them as independent could be inconsistent with the correlation of both with a third keyframe.
    ///
    /// # Arguments
    /// * `held`: keyframes that the filter holds now.
    #[must_use]
    pub fn with_known_correlations(mut self, held: &[KeyframeId]) -> Self {
        let answered = self.keyframes.iter().map(|keyframe| keyframe.id);
        let stated: HashSet<KeyframeId> = self.held_at_query.iter().copied().chain(answered).collect();
        if held.iter().all(|id| stated.contains(id)) {
            return self;
        }
        self.keyframes.retain(|keyframe| held.contains(&keyframe.id));
        self.remove_dangling_references();
        self
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
    /// * `held`: covariance of a keyframe that the filter holds already.
    #[must_use]
    pub fn without_invalid(mut self, held: &dyn Fn(KeyframeId) -> Option<Matrix6<f64>>) -> Self {
        self.keyframes.retain(|keyframe| keyframe.global_from_keyframe.is_plausible());
        let stated: Vec<(KeyframeId, Matrix6<f64>)> = self
            .keyframes
            .iter()
            .map(|keyframe| (keyframe.id, keyframe.global_from_keyframe.covariance))
            .collect();
        let covariance_of =
            |id| held(id).or_else(|| stated.iter().find(|(other, _)| *other == id).map(|(_, own)| *own));
        self.keyframes.retain(|keyframe| {
            keyframe.cross_covariances.iter().all(|(other, block)| {
                let both = covariance_of(keyframe.id).zip(covariance_of(*other));
                both.is_none_or(|(own, others)| is_joint_covariance(&own, &others, block))
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
        self
    }
}

/// Whether two covariances with a cross-covariance are a valid joint covariance.
fn is_joint_covariance(a: &Matrix6<f64>, b: &Matrix6<f64>, block: &Matrix6<f64>) -> bool {
    let mut joint = SMatrix::<f64, 12, 12>::zeros();
    joint.fixed_view_mut::<6, 6>(0, 0).copy_from(a);
    joint.fixed_view_mut::<6, 6>(6, 6).copy_from(b);
    joint.fixed_view_mut::<6, 6>(0, 6).copy_from(block);
    joint.fixed_view_mut::<6, 6>(6, 0).copy_from(&block.transpose());
    for k in 0..12 {
        // Tolerance for rounding, and for a keyframe without uncertainty.
        joint[(k, k)] += 1e-9 * joint[(k, k)] + 1e-18;
    }
    joint.iter().all(|value| value.is_finite()) && joint.cholesky().is_some()
}
