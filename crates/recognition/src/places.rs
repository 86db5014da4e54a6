//! The keyframes of a map that show what an image shows, each verified for itself.

use geometry::{Camera, PoseWithCovariance};
use nalgebra::Vector3;
use protocol::{FeatureSet, KeyframeId, LandmarkId};
use vision::Matcher;

use super::consensus::{group_places, has_rival};
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

impl VerifiedPlace {
    fn new(map: &LoadedMap, found: &VerifiedKeyframe) -> VerifiedPlace {
        let observed = map.observations.of(found.keyframe);
        let landmark = |at: usize| map.landmarks.ids[observed.landmark(at)];
        VerifiedPlace {
            keyframe: map.poses.keyframes[found.keyframe].id,
            global_from_camera: found.global_from_camera,
            inliers: found.inliers.iter().map(|inlier| (inlier.query, landmark(inlier.train))).collect(),
        }
    }
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
        let Some((map, image)) = self.searched(camera, features, gravity_in_camera, options)? else {
            return Ok(Vec::new());
        };
        let is_eligible = |at: usize| eligible(self.poses.keyframes[at].id);
        let verified = map.verified_keyframes(&image, is_eligible, options)?;
        let mut places: Vec<VerifiedPlace> =
            verified.iter().map(|found| VerifiedPlace::new(map, found)).collect();
        places.sort_by_key(|place| std::cmp::Reverse(place.inliers.len()));
        Ok(places)
    }

    /// As [`LoadedMap::verified_places`], in the whole map, each with whether it is told apart: it is of the place that explains the image
    /// so much better than all others, and than a picture that repeats, that a client without an estimator would be told
    /// ([`RecognitionOptions::min_fix_log_odds`]).
    ///
    /// # Errors
    /// [`QueryError`] where the image cannot be compared with the map.
    pub fn weighed_places(
        &self,
        camera: &Camera,
        features: &FeatureSet,
        gravity_in_camera: Option<Vector3<f64>>,
        options: &RecognitionOptions,
    ) -> Result<Vec<(VerifiedPlace, bool)>, QueryError> {
        let Some((map, image)) = self.searched(camera, features, gravity_in_camera, options)? else {
            return Ok(Vec::new());
        };
        let mut verified = map.verified_keyframes(&image, |_| true, options)?;
        let groups = group_places(map, &mut verified, options);
        let hypotheses = map.hypotheses(&image, &verified, &groups, map.aliasing_rate().log_odds());
        let is_certain = !has_rival(&verified, &groups, &hypotheses, None, options)
            && hypotheses.first().is_some_and(|place| place.log_odds() >= options.min_fix_log_odds);
        let is_told_apart = |at: usize| is_certain && groups[0].contains(&at);
        let weighed = |(at, found)| (VerifiedPlace::new(map, found), is_told_apart(at));
        Ok(verified.iter().enumerate().map(weighed).collect())
    }

    /// What is compared with an image, and the image for it; `None` where it has too few features for any place.
    fn searched<'a>(
        &'a self,
        camera: &'a Camera,
        features: &'a FeatureSet,
        gravity_in_camera: Option<Vector3<f64>>,
        options: &RecognitionOptions,
    ) -> Result<Option<(&'a LoadedMap, Image<'a>)>, QueryError> {
        if features.len() < options.min_inliers {
            return Ok(None);
        }
        let map = self.for_features(features);
        let image = Image { camera, features, descriptors: map.view(features)?, gravity_in_camera };
        Ok(Some((map, image)))
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
