//! The keyframes of a map that show what an image shows, each verified for itself.

use geometry::{Camera, PoseWithCovariance};
use nalgebra::Vector3;
use protocol::{FeatureSet, KeyframeId, LandmarkId};
use vision::Matcher;

use super::index::best_voted;
use super::loaded_map::LoadedMap;
use super::options::RecognitionOptions;
use super::query::QueryError;
use super::verification::{Comparison, Image, VerifiedKeyframe, compare};

/// A keyframe that shows the place of an image.
#[derive(Clone, Debug)]
pub struct VerifiedPlace {
    /// The keyframe.
    pub keyframe: KeyframeId,
    /// The camera in G by this keyframe alone; its covariance contains that of the keyframe's pose.
    pub global_from_camera: PoseWithCovariance,
    /// The matches that agree with the pose: features of the image, by number, and landmarks.
    pub inliers: Vec<(usize, LandmarkId)>,
}

impl LoadedMap {
    /// The keyframes that show what an image shows, each verified by the camera's pose, most inliers first.
    ///
    /// Unlike the answer to a query they need not agree on one place: while a map is being built, its poses have drifted.
    ///
    /// # Arguments
    /// * `eligible`: which keyframes are searched.
    ///
    /// # Errors
    /// [`QueryError`] where the image cannot be compared with the map.
    pub fn verified_places(
        &self,
        camera: &Camera,
        features: &FeatureSet,
        gravity_in_camera: Option<Vector3<f64>>,
        eligible: &dyn Fn(KeyframeId) -> bool,
        options: &RecognitionOptions,
    ) -> Result<Vec<VerifiedPlace>, QueryError> {
        if features.len() < options.min_inliers {
            return Ok(Vec::new());
        }
        let map = self.for_features(features);
        let image = Image { camera, features, descriptors: map.view(features)?, gravity_in_camera };
        let is_eligible = |at: usize| eligible(self.poses.keyframes[at].id);
        let place = |found: VerifiedKeyframe| {
            let observed = map.observations.of(found.keyframe);
            let landmark = |at: usize| map.landmarks.ids[observed.landmark(at)];
            VerifiedPlace {
                keyframe: self.poses.keyframes[found.keyframe].id,
                global_from_camera: found.global_from_camera,
                inliers: found.inliers.iter().map(|inlier| (inlier.query, landmark(inlier.train))).collect(),
            }
        };
        let verified = map.verified_keyframes(&image, is_eligible, options)?;
        let mut places: Vec<VerifiedPlace> = verified.into_iter().map(place).collect();
        places.sort_by_key(|place| std::cmp::Reverse(place.inliers.len()));
        Ok(places)
    }

    /// Those of the keyframes with the most votes that show what an image shows, each verified for itself, most votes first.
    ///
    /// # Arguments
    /// * `eligible`: which keyframes are searched.
    pub(crate) fn verified_keyframes(
        &self,
        image: &Image<'_>,
        eligible: impl Fn(usize) -> bool,
        options: &RecognitionOptions,
    ) -> Result<Vec<VerifiedKeyframe>, QueryError> {
        let votes =
            self.index.vote(image.descriptors, &self.landmarks.observers, self.poses.keyframes.len())?;
        let mut matcher = Matcher::new(image.descriptors);
        let mut verified = Vec::new();
        for candidate in best_voted(&votes, options.candidates, options.min_votes, eligible) {
            if let Comparison::Verified(found) = compare(self, candidate, image, &mut matcher, None, options)?
            {
                verified.push(*found);
            }
        }
        Ok(verified)
    }
}
