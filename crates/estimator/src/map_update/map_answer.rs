//! What the map answered to one image, in the estimator's own terms.

use crate::KeyframeId;
use geometry::{Camera, PoseWithCovariance};
use nalgebra::{Matrix6, SMatrix, Vector2, Vector3};
use std::collections::HashSet;

/// A keyframe of the map that shares landmarks with the image.
#[derive(Clone, Debug)]
pub struct MapKeyframe {
    /// Its name in the map.
    pub id: KeyframeId,
    /// Camera pose in G with covariance.
    pub global_from_keyframe: PoseWithCovariance,
    /// Its camera.
    pub camera: Camera,
    /// Its covariance with other keyframes, rows are its own error. Absent means independent.
    pub cross_covariances: Vec<(KeyframeId, Matrix6<f64>)>,
}

/// A landmark of the map that the image saw.
#[derive(Clone, Debug)]
pub struct MatchedLandmark {
    /// Where the current image saw it, pixels.
    pub pixel: Vector2<f64>,
    /// The keyframe in whose camera frame its position is given.
    pub anchor: KeyframeId,
    /// Position in the anchor's camera frame, metres. A point to linearize at, not a measurement.
    pub position_in_anchor: Vector3<f64>,
    /// Where keyframes saw it, pixels; the anchor among them.
    pub observations: Vec<(KeyframeId, Vector2<f64>)>,
}

/// All that the map had to say about one image.
#[derive(Clone, Debug)]
pub struct MapAnswer {
    /// Version of the map that answered.
    pub map_version: u64,
    /// Best first.
    pub keyframes: Vec<MapKeyframe>,
    /// Keyframes that the filter held when it asked: the answer states how its own depend on these.
    pub asked_with: Vec<KeyframeId>,
    /// What matched.
    pub landmarks: Vec<MatchedLandmark>,
    /// Unit vector along gravity in G, where the map states it.
    pub gravity_in_global: Option<Vector3<f64>>,
    /// Noise of the map's pixels as the map states it, px.
    pub sigma_map_px: f64,
}

impl MapAnswer {
    /// A keyframe of this answer.
    pub fn keyframe(&self, id: KeyframeId) -> Option<&MapKeyframe> {
        self.keyframes.iter().find(|keyframe| keyframe.id == id)
    }

    /// Leaves out keyframes of which nobody said how they depend on some that came since the question, and whatever
    /// hangs on them. To take them for independent could contradict what both have in common with a third.
    ///
    /// # Arguments
    /// * `held`: keyframes that the filter holds now.
    #[must_use]
    pub fn with_known_relations(mut self, held: &[KeyframeId]) -> Self {
        let sent = self.keyframes.iter().map(|keyframe| keyframe.id);
        let stated: HashSet<KeyframeId> = self.asked_with.iter().copied().chain(sent).collect();
        if held.iter().all(|id| stated.contains(id)) {
            return self;
        }
        self.keyframes.retain(|keyframe| held.contains(&keyframe.id));
        self.keep_what_hangs_together();
        self
    }

    fn keep_what_hangs_together(&mut self) {
        let known: Vec<KeyframeId> = self.keyframes.iter().map(|keyframe| keyframe.id).collect();
        self.landmarks.retain(|landmark| known.contains(&landmark.anchor));
        for landmark in &mut self.landmarks {
            landmark.observations.retain(|(id, _)| known.contains(id));
        }
    }

    /// Leaves out what no filter can use: keyframes whose pose or covariance is none, cross-covariances
    /// that the covariances do not allow, and whatever hangs on them; numbers that are not finite.
    ///
    /// # Arguments
    /// * `held`: covariance of a keyframe that the filter holds already.
    #[must_use]
    pub fn sound(mut self, held: &dyn Fn(KeyframeId) -> Option<Matrix6<f64>>) -> Self {
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
                both.is_none_or(|(own, others)| allows(&own, &others, block))
            })
        });
        self.keep_what_hangs_together();
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

/// Whether two covariances and the block between them are a joint covariance.
fn allows(a: &Matrix6<f64>, b: &Matrix6<f64>, block: &Matrix6<f64>) -> bool {
    let mut joint = SMatrix::<f64, 12, 12>::zeros();
    joint.fixed_view_mut::<6, 6>(0, 0).copy_from(a);
    joint.fixed_view_mut::<6, 6>(6, 6).copy_from(b);
    joint.fixed_view_mut::<6, 6>(0, 6).copy_from(block);
    joint.fixed_view_mut::<6, 6>(6, 0).copy_from(&block.transpose());
    for k in 0..12 {
        // Room for rounding, and for a keyframe that is known exactly.
        joint[(k, k)] += 1e-9 * joint[(k, k)] + 1e-18;
    }
    joint.iter().all(|value| value.is_finite()) && joint.cholesky().is_some()
}
