//! The queries that a loaded map answers.

use std::time::Instant;

use nalgebra::Vector3;
use protocol::{
    DescriptorFormat, Extent, FeatureKind, FeatureSet, KeyframeId, KeyframeLandmark, KeyframeReply,
    LocalizeReply, LocalizeRequest, LocalizedPose, MapInfoReply, MatchOutcome, MatchReply, MatchRequest,
    MatchStatus,
};
use vision::DescriptorError;

use super::answer::{matched_keyframes, record};
use super::fusion::{FocalError, FusedPose, MAX_FUSED_KEYFRAMES, fuse};
use super::index::best_voted;
use super::kinds::describe;
use super::loaded_map::LoadedMap;
use super::options::RecognitionOptions;
use super::report::SearchReport;
use super::verification::{Image, VerifiedKeyframe};

/// Fewest keyframes that must agree before the search ends.
const MIN_AGREEING: usize = 4;

/// Why a query cannot be answered. "Nothing matched" is an answer, not an error.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum QueryError {
    /// The query's descriptors cannot be compared with the map's.
    #[error(
        "the query has {query:?} descriptors, the map has features of {}: use an extractor that the map has",
        describe(offered)
    )]
    DescriptorMismatch {
        /// Of the query.
        query: DescriptorFormat,
        /// The kinds of features of the map.
        offered: Vec<map::FeatureKind>,
    },
    /// The query's descriptors come from an extractor that the map has no features of.
    #[error(
        "the query's features come from the extractor {query:?}, the map has features of {}: use an extractor that the map has",
        describe(offered)
    )]
    ExtractorMismatch {
        /// Of the query.
        query: String,
        /// The kinds of features of the map.
        offered: Vec<map::FeatureKind>,
    },
    /// The query's features are not consistent in themselves.
    #[error("the query's features cannot be used: {0}")]
    Descriptors(#[from] DescriptorError),
}

impl LoadedMap {
    /// Answers a match query: keyframes by rank, and always a final status. Of a map with several kinds of features the one that the
    /// query has is searched.
    ///
    /// The rules of an answer are those of [`MatchReply`] and, for anchors: the anchor of every landmark is a keyframe
    /// of the answer that observed it; where the map's own anchor is not sent, the landmark is re-anchored in the
    /// keyframe that matched it.
    ///
    /// # Errors
    /// [`QueryError`] where the query cannot be compared with the map.
    pub fn answer(
        &self,
        request: &MatchRequest,
        options: &RecognitionOptions,
    ) -> Result<Vec<MatchReply>, QueryError> {
        Ok(self.answer_with_report(request, options)?.0)
    }

    /// The answer to a match query, and what the search found out.
    ///
    /// # Errors
    /// As of [`LoadedMap::answer`].
    pub fn answer_with_report(
        &self,
        request: &MatchRequest,
        options: &RecognitionOptions,
    ) -> Result<(Vec<MatchReply>, SearchReport), QueryError> {
        self.for_features(&request.features).answer_of_kind(request, options)
    }

    /// The answer with this kind of features.
    fn answer_of_kind(
        &self,
        request: &MatchRequest,
        options: &RecognitionOptions,
    ) -> Result<(Vec<MatchReply>, SearchReport), QueryError> {
        let start = Instant::now();
        let gravity = request.gravity_in_camera.map(Vector3::from);
        let (camera, features, prior) = (&request.camera, &request.features, request.prior.as_ref());
        let enough = usize::from(request.max_keyframes).max(MIN_AGREEING);
        let search = self.search(camera, features, prior, gravity, enough, options)?;
        let keyframes = if search.place.is_empty() {
            Vec::new()
        } else {
            let knows_held = request.map_version_held == Some(self.info.version);
            let count = usize::from(request.max_keyframes);
            matched_keyframes(self, &search.place, count, &request.held, knows_held, options)
        };
        let status = MatchStatus {
            map_version: self.info.version,
            map_identity: self.identity,
            outcome: search.outcome,
            keyframes_sent: keyframes.len() as u16,
            searched_keyframes: search.searched_keyframes as u32,
            elapsed_us: start.elapsed().as_micros() as u64,
            gravity_in_global: self.info.gravity_in_global.map(Into::into),
            sigma_map_px: self.info.sigma_px,
            log_odds: search.log_odds(),
            log_prior_odds: search.log_prior_odds(),
        };
        let mut replies: Vec<MatchReply> = keyframes.into_iter().map(MatchReply::Keyframe).collect();
        replies.push(MatchReply::Done(status));
        Ok((replies, search.into_report()))
    }

    /// Answers a one-shot localization query.
    ///
    /// The pose is estimated from all verified keyframes of the place together. Its covariance contains the pixel noise,
    /// the scatter of the landmarks and the uncertainty of the keyframes. Where the matches show that the camera's focal
    /// length is wrong by more than 5 %, no pose is given. Nor is one whose odds over a place that looks alike are less than
    /// [`RecognitionOptions::min_fix_log_odds`], unless a prior that is no wider than the distance of what is seen supports it.
    ///
    /// # Errors
    /// [`QueryError`] where the query cannot be compared with the map.
    pub fn localize(
        &self,
        request: &LocalizeRequest,
        options: &RecognitionOptions,
    ) -> Result<LocalizeReply, QueryError> {
        Ok(self.localize_with_report(request, options)?.0)
    }

    /// The answer to a one-shot localization query, and what the search found out.
    ///
    /// # Errors
    /// As of [`LoadedMap::localize`].
    pub fn localize_with_report(
        &self,
        request: &LocalizeRequest,
        options: &RecognitionOptions,
    ) -> Result<(LocalizeReply, SearchReport), QueryError> {
        self.for_features(&request.features).localize_of_kind(request, options)
    }

    /// The answer with this kind of features.
    fn localize_of_kind(
        &self,
        request: &LocalizeRequest,
        options: &RecognitionOptions,
    ) -> Result<(LocalizeReply, SearchReport), QueryError> {
        let gravity = request.gravity_in_camera.map(Vector3::from);
        let (camera, features, prior) = (&request.camera, &request.features, request.prior.as_ref());
        let search = self.search(camera, features, prior, gravity, MAX_FUSED_KEYFRAMES, options)?;
        let fix = match search.place.first() {
            Some(best) => {
                let descriptors = self.view(&request.features)?;
                let image = Image { camera, features, descriptors, gravity_in_camera: gravity };
                let fused = fuse(self, &search.place, &image, options);
                let contradiction = fused.as_ref().and_then(|fused| fused.focal_error);
                if let Some(error) = contradiction.filter(FocalError::contradicts_camera) {
                    tracing::warn!(
                        "the matches contradict the camera: they fit a focal length {:+.0} % ({:.0} px instead of \
                         {:.0} px); no pose is given, since it would be wrong by far more than its covariance: give the \
                         camera that took the image",
                        100.0 * error.relative,
                        camera.focal[0] * (1.0 + error.relative),
                        camera.focal[0]
                    );
                    let reply = LocalizeReply {
                        map_version: self.info.version,
                        map_identity: self.identity,
                        outcome: MatchOutcome::NotVerified,
                        fix: None,
                        places: search.places(),
                    };
                    return Ok((reply, search.into_report()));
                }
                Some(self.localized(best, fused))
            }
            None => None,
        };
        let fix = fix.filter(|fix| fix.inliers as usize >= options.min_fix_inliers);
        let unverified = search.outcome == MatchOutcome::Matched && fix.is_none();
        let is_ambiguous = fix.as_ref().is_some_and(|fix| {
            let is_told = |prior| self.is_told_by(prior, &search, &fix.global_from_camera);
            search.log_odds() < options.min_fix_log_odds && !prior.is_some_and(is_told)
        });
        let fix = fix.filter(|_| !is_ambiguous);
        let outcome = match search.outcome {
            _ if is_ambiguous => MatchOutcome::Ambiguous,
            _ if unverified => MatchOutcome::NotVerified,
            outcome => outcome,
        };
        let (map_version, map_identity) = (self.info.version, self.identity);
        let reply = LocalizeReply { map_version, map_identity, outcome, fix, places: search.places() };
        Ok((reply, search.into_report()))
    }

    /// The fused pose, or that of the best keyframe where fusion failed.
    fn localized(&self, best: &VerifiedKeyframe, fused: Option<FusedPose>) -> LocalizedPose {
        let fused = fused.unwrap_or(FusedPose {
            global_from_camera: best.global_from_camera,
            inliers: best.inliers.len(),
            matched: best.matches.len(),
            mean_error_px: best.mean_error_px,
            focal_error: None,
        });
        LocalizedPose {
            global_from_camera: fused.global_from_camera,
            keyframe: self.poses.keyframes[best.keyframe].id,
            matched_features: fused.matched as u32,
            inliers: fused.inliers as u32,
            mean_error_px: fused.mean_error_px,
        }
    }

    /// Ranks keyframes by appearance, best first, before any of them is matched feature by feature.
    ///
    /// # Arguments
    /// * `count`: at most so many; fewer where only few share a feature with the image.
    ///
    /// # Errors
    /// [`QueryError`] where the features cannot be compared with the map.
    pub fn rank_keyframes(&self, features: &FeatureSet, count: usize) -> Result<Vec<KeyframeId>, QueryError> {
        let map = self.for_features(features);
        let keyframes = self.poses.keyframes.len();
        let votes = map.index.vote(map.view(features)?, &map.landmarks.observers, keyframes)?;
        let ranked = best_voted(&votes, count, 1, |_| true);
        Ok(ranked.into_iter().map(|at| self.poses.keyframes[at].id).collect())
    }

    /// One keyframe with the landmarks of the primary kind that it observes, `None` where the map has none of that id.
    pub fn keyframe_reply(&self, id: KeyframeId) -> Option<KeyframeReply> {
        let keyframe = self.index_of(id)?;
        let observed = self.observations.of(keyframe);
        let landmarks = observed.landmarks.iter().zip(observed.pixels).map(|(&landmark, &pixel)| {
            let landmark = landmark as usize;
            KeyframeLandmark {
                landmark: self.landmarks.ids[landmark],
                anchor: self.poses.keyframes[self.landmarks.anchors[landmark] as usize].id,
                position_in_anchor: self.landmarks.positions_in_anchor[landmark].into(),
                pixel,
            }
        });
        let landmarks = landmarks.collect();
        let (map_version, map_identity) = (self.info.version, self.identity);
        Some(KeyframeReply {
            map_version,
            map_identity,
            keyframe: record(&self.poses.keyframes[keyframe]),
            landmarks,
        })
    }

    /// Describes the map under the name by which it is served.
    pub fn info_reply(&self, name: &str) -> MapInfoReply {
        let positions =
            || self.poses.keyframes.iter().map(|keyframe| keyframe.global_from_keyframe.pose.translation);
        let extent = positions().next().map(|first| Extent {
            min: positions().fold(first, |low, position| low.inf(&position)).into(),
            max: positions().fold(first, |high, position| high.sup(&position)).into(),
        });
        MapInfoReply {
            name: name.to_owned(),
            version: self.info.version,
            identity: self.identity,
            database_schema: self.store_schema,
            keyframes: self.keyframe_count() as u64,
            landmarks: self.landmark_count() as u64,
            observations: self.observation_count() as u64,
            cross_covariances: self.cross_covariance_count() as u64,
            gravity_in_global: self.info.gravity_in_global.map(Into::into),
            extent,
            descriptors: (!self.poses.keyframes.is_empty()).then(|| self.info.feature_kind().format()),
            sigma_map_px: self.info.sigma_px,
            extractor: self.info.extractor.clone(),
            feature_kinds: self
                .kinds()
                .filter(|_| !self.poses.keyframes.is_empty())
                .map(kind_reply)
                .collect(),
        }
    }
}

/// A kind of features as it is told.
fn kind_reply(map: &LoadedMap) -> FeatureKind {
    FeatureKind {
        extractor: map.info.extractor.clone(),
        descriptors: map.info.feature_kind().format(),
        landmarks: map.landmark_count() as u64,
        observations: map.observation_count() as u64,
        sigma_map_px: map.info.sigma_px,
    }
}
