//! The queries that a loaded map answers.

use std::time::Instant;

use geometry::{Camera, PoseWithCovariance};
use nalgebra::Vector3;
use protocol::{
    DescriptorFormat, Extent, FeatureSet, KeyframeId, KeyframeLandmark, KeyframeReply, LocalizeReply,
    LocalizeRequest, LocalizedPose, MapInfoReply, MatchOutcome, MatchReply, MatchRequest, MatchStatus,
    PosePrior,
};
use vision::{DescriptorError, DescriptorView};

use super::answer::{matched_keyframes, record};
use super::consensus::{Consensus, find_consensus, is_consistent};
use super::fusion::{FocalError, FusedPose, MAX_FUSED_KEYFRAMES, fuse};
use super::index::{Votes, best_voted};
use super::loaded_map::LoadedMap;
use super::options::RecognitionOptions;
use super::verification::{Comparison, Image, VerifiedKeyframe, compare, distinct_features};
use map::model::Keyframe;
use map::store::STORE_SCHEMA;

/// How many standard deviations of the prior's position a keyframe may be away, beyond the viewing distance.
const PRIOR_SIGMAS: f64 = 3.0;

/// Angle (rad) between the optical axes of two cameras beyond which no descriptor matches, before the prior's uncertainty:
/// what both see is seen from sides that look different.
const MAX_VIEW_ANGLE: f64 = std::f64::consts::FRAC_PI_2;

/// Keyframes near a prior are few where the map has so many times as many: comparing a landmark by itself takes several
/// times as long as in a whole list.
const FEW_KEYFRAMES: usize = 8;

/// Fewest keyframes that must agree before the search ends.
const MIN_AGREEING: usize = 4;

/// Features that vote for keyframes near a prior, at most: these are few, and the votes only rank them.
const VOTERS_NEAR_PRIOR: usize = 160;

/// Why a query cannot be answered. "Nothing matched" is an answer, not an error.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum QueryError {
    /// The query's descriptors cannot be compared with the map's.
    #[error(
        "the query has {query:?} descriptors, the map has {map:?}: use the extractor that the map was built with"
    )]
    DescriptorMismatch {
        /// Of the query.
        query: DescriptorFormat,
        /// Of the map.
        map: DescriptorFormat,
    },
    /// The query's descriptors come from another extractor than the map's.
    #[error(
        "the query's features come from the extractor {query:?}, the map was built with {map:?}: use the map's extractor"
    )]
    ExtractorMismatch {
        /// Of the query.
        query: String,
        /// Of the map.
        map: String,
    },
    /// The query's features are not consistent in themselves.
    #[error("the query's features cannot be used: {0}")]
    Descriptors(#[from] DescriptorError),
}

/// The result of a search.
struct Search {
    outcome: MatchOutcome,
    /// VerifiedKeyframe keyframes of one place, most inliers first; empty unless matched.
    place: Vec<VerifiedKeyframe>,
    searched_keyframes: usize,
}

/// What makes further candidates of a place needless: they share fewer features with the image.
struct Sufficient<'a> {
    prior: Option<&'a PoseWithCovariance>,
    enough: usize,
}

impl Sufficient<'_> {
    /// Whether enough keyframes are verified, and all of them agree with the prior, or without one with the first.
    fn is_reached(&self, verified: &[VerifiedKeyframe], options: &RecognitionOptions) -> bool {
        let Some(first) = verified.first().filter(|_| verified.len() >= self.enough) else { return false };
        let reference = self.prior.unwrap_or(&first.global_from_camera);
        verified.iter().all(|keyframe| is_consistent(&keyframe.global_from_camera, reference, options))
    }
}

impl LoadedMap {
    /// Answers a match query: keyframes by rank, and always a final status.
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
        let start = Instant::now();
        let gravity = request.gravity_in_camera.map(Vector3::from);
        let (camera, features, prior) = (&request.camera, &request.features, request.prior.as_ref());
        let enough = usize::from(request.max_keyframes).max(MIN_AGREEING);
        let search = self.search(camera, features, prior, gravity, enough, options)?;
        let keyframes = if search.place.is_empty() {
            Vec::new()
        } else {
            matched_keyframes(self, &search.place, usize::from(request.max_keyframes), &request.held, options)
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
        };
        let mut replies: Vec<MatchReply> = keyframes.into_iter().map(MatchReply::Keyframe).collect();
        replies.push(MatchReply::Done(status));
        Ok(replies)
    }

    /// Answers a one-shot localization query.
    ///
    /// The pose is estimated from all verified keyframes of the place together. Its covariance contains the pixel noise,
    /// the scatter of the landmarks and the uncertainty of the keyframes. Where the matches show that the camera's focal
    /// length is wrong by more than 5 %, no pose is given.
    ///
    /// # Errors
    /// [`QueryError`] where the query cannot be compared with the map.
    pub fn localize(
        &self,
        request: &LocalizeRequest,
        options: &RecognitionOptions,
    ) -> Result<LocalizeReply, QueryError> {
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
                    return Ok(LocalizeReply {
                        map_version: self.info.version,
                        map_identity: self.identity,
                        outcome: MatchOutcome::NotVerified,
                        fix: None,
                    });
                }
                Some(self.localized(best, fused))
            }
            None => None,
        };
        let fix = fix.filter(|fix| fix.inliers as usize >= options.min_fix_inliers);
        let unverified = search.outcome == MatchOutcome::Matched && fix.is_none();
        let outcome = if unverified { MatchOutcome::NotVerified } else { search.outcome };
        Ok(LocalizeReply { map_version: self.info.version, map_identity: self.identity, outcome, fix })
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
            keyframe: self.keyframes[best.keyframe].id,
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
        let votes = self.index.vote(self.view(features)?, &self.landmarks, self.keyframes.len())?;
        let ranked = best_voted(&votes, count, 1, |_| true);
        Ok(ranked.into_iter().map(|at| self.keyframes[at].id).collect())
    }

    /// One keyframe with the landmarks that it observes, `None` where the map has none of that id.
    pub fn keyframe_reply(&self, id: KeyframeId) -> Option<KeyframeReply> {
        let keyframe = self.index_of(id)?;
        let observed = self.observations.of(keyframe);
        let landmarks = observed.landmarks.iter().zip(observed.pixels).map(|(&landmark, &pixel)| {
            let landmark = landmark as usize;
            KeyframeLandmark {
                landmark: self.landmarks.ids[landmark],
                anchor: self.keyframes[self.landmarks.anchors[landmark] as usize].id,
                position_in_anchor: self.landmarks.positions_in_anchor[landmark].into(),
                pixel,
            }
        });
        let landmarks = landmarks.collect();
        let (map_version, map_identity) = (self.info.version, self.identity);
        Some(KeyframeReply {
            map_version,
            map_identity,
            keyframe: record(&self.keyframes[keyframe]),
            landmarks,
        })
    }

    /// Describes the map under the name by which it is served.
    pub fn info_reply(&self, name: &str) -> MapInfoReply {
        let positions =
            || self.keyframes.iter().map(|keyframe| keyframe.global_from_keyframe.pose.translation);
        let extent = positions().next().map(|first| Extent {
            min: positions().fold(first, |low, position| low.inf(&position)).into(),
            max: positions().fold(first, |high, position| high.sup(&position)).into(),
        });
        MapInfoReply {
            name: name.to_owned(),
            version: self.info.version,
            identity: self.identity,
            database_schema: STORE_SCHEMA,
            keyframes: self.keyframe_count() as u64,
            landmarks: self.landmark_count() as u64,
            observations: self.observation_count() as u64,
            cross_covariances: self.cross_covariance_count() as u64,
            gravity_in_global: self.info.gravity_in_global.map(Into::into),
            extent,
            descriptors: (!self.keyframes.is_empty()).then(|| self.format()),
            sigma_map_px: self.info.sigma_px,
            extractor: self.info.extractor.clone(),
        }
    }

    fn format(&self) -> DescriptorFormat {
        DescriptorFormat { kind: self.info.descriptor_kind, width: self.info.descriptor_width }
    }

    /// A query's descriptors, which must be comparable with the map's.
    pub(super) fn view<'a>(&self, features: &'a FeatureSet) -> Result<DescriptorView<'a>, QueryError> {
        let query = features.descriptors.format();
        if query != self.format() {
            return Err(QueryError::DescriptorMismatch { query, map: self.format() });
        }
        let (stated, wanted) = (&features.extractor, &self.info.extractor);
        if !stated.is_empty() && !wanted.is_empty() && stated != wanted {
            return Err(QueryError::ExtractorMismatch { query: stated.clone(), map: wanted.clone() });
        }
        let width = usize::from(query.width);
        Ok(DescriptorView::new(self.metric(), width, &features.descriptors.bytes)?)
    }

    /// Finds the place of an image: near the prior, and where none is verified there, in the whole map.
    ///
    /// # Arguments
    /// * `enough`: once so many keyframes agree, further candidates of their place are not compared.
    fn search(
        &self,
        camera: &Camera,
        features: &FeatureSet,
        prior: Option<&PosePrior>,
        gravity_in_camera: Option<Vector3<f64>>,
        enough: usize,
        options: &RecognitionOptions,
    ) -> Result<Search, QueryError> {
        let nothing = |outcome| Ok(Search { outcome, place: Vec::new(), searched_keyframes: 0 });
        if self.keyframes.is_empty() {
            return nothing(MatchOutcome::EmptyMap);
        }
        if features.len() < options.min_inliers {
            return nothing(MatchOutcome::TooFewFeatures);
        }
        let descriptors = self.view(features)?;
        let image = Image { camera, features, descriptors, gravity_in_camera };
        let candidates = |votes: &[Votes], eligible: &dyn Fn(usize) -> bool| {
            best_voted(votes, options.candidates, options.min_votes, eligible)
        };
        if let Some(prior) = prior {
            let near = self.near(&prior.global_from_camera);
            let sufficient = Sufficient { prior: Some(&prior.global_from_camera), enough };
            let votes = self.votes_near(descriptors, &near)?;
            let candidates = candidates(&votes, &|at| near[at]);
            let place = self.recognize(&candidates, &image, &sufficient, options)?;
            if place.outcome == MatchOutcome::Matched {
                let searched_keyframes = near.iter().filter(|&&near| near).count();
                return Ok(Search { searched_keyframes, ..place });
            }
        }
        let votes = self.index.vote(descriptors, &self.landmarks, self.keyframes.len())?;
        let sufficient = Sufficient { prior: None, enough };
        let place = self.recognize(&candidates(&votes, &|_| true), &image, &sufficient, options)?;
        Ok(Search { searched_keyframes: self.keyframes.len(), ..place })
    }

    /// Which keyframes may share a field of view with a camera near a prior pose: by their distance, and by the angle
    /// between their optical axes.
    pub(super) fn near(&self, prior: &PoseWithCovariance) -> Vec<bool> {
        let sigma = |start: usize| {
            let block = prior.covariance.fixed_view::<3, 3>(start, start).into_owned();
            block.symmetric_eigenvalues().max().max(0.0).sqrt()
        };
        let radius = PRIOR_SIGMAS * sigma(3) + self.viewing_distance();
        let least_cosine = (MAX_VIEW_ANGLE + PRIOR_SIGMAS * sigma(0)).min(std::f64::consts::PI).cos();
        let axis = prior.pose.rotation * Vector3::z();
        let is_near = |keyframe: &Keyframe| {
            let pose = &keyframe.global_from_keyframe.pose;
            (pose.translation - prior.pose.translation).norm() <= radius
                && (pose.rotation * Vector3::z()).dot(&axis) >= least_cosine
        };
        self.keyframes.iter().map(is_near).collect()
    }

    /// The votes for keyframes near a prior. Where these are few, some of the features vote, and only the landmarks that
    /// the keyframes observe are searched.
    pub(super) fn votes_near(
        &self,
        descriptors: DescriptorView<'_>,
        near: &[bool],
    ) -> Result<Vec<Votes>, DescriptorError> {
        let few: Vec<usize> = (0..near.len()).filter(|&at| near[at]).collect();
        if few.len() * FEW_KEYFRAMES > near.len() {
            return self.index.vote(descriptors, &self.landmarks, self.keyframes.len());
        }
        let mut among = vec![false; self.landmarks.len()];
        for landmark in few.iter().flat_map(|&keyframe| self.observations.of(keyframe).landmarks) {
            among[*landmark as usize] = true;
        }
        let step = descriptors.len().div_ceil(VOTERS_NEAR_PRIOR).max(1);
        let voters: Vec<u8> = descriptors.iter().step_by(step).flatten().copied().collect();
        let voters = DescriptorView::new(descriptors.metric(), descriptors.width(), &voters)?;
        let mut votes = self.index.vote_among(voters, &self.landmarks, self.keyframes.len(), &among)?;
        for votes in &mut votes {
            votes.stand_for(step as u32);
        }
        Ok(votes)
    }

    /// Compares an image with each candidate and finds the one place that they agree on.
    ///
    /// Where enough of them agree, the candidates that remain matter only if they are of another place, which makes the
    /// answer ambiguous; with a prior not even these.
    fn recognize(
        &self,
        candidates: &[usize],
        image: &Image<'_>,
        sufficient: &Sufficient<'_>,
        options: &RecognitionOptions,
    ) -> Result<Search, QueryError> {
        let mut verified: Vec<VerifiedKeyframe> = Vec::new();
        let mut outcome = MatchOutcome::NoMatch;
        // Whether a keyframe may share a field of view with those that are sufficient.
        let mut of_the_place: Option<Vec<bool>> = None;
        for &candidate in candidates {
            if of_the_place.is_none() && sufficient.is_reached(&verified, options) {
                if sufficient.prior.is_some() {
                    break;
                }
                of_the_place = Some(self.near(&verified[0].global_from_camera));
            }
            if of_the_place.as_ref().is_some_and(|of_the_place| of_the_place[candidate]) {
                continue;
            }
            let first = verified.first().map(|first| &first.global_from_camera.pose);
            match compare(self, candidate, image, first, options)? {
                Comparison::TooFewMatches => {}
                Comparison::NoPose | Comparison::PoseUncertain(_) => outcome = MatchOutcome::NotVerified,
                Comparison::Verified(keyframe) => verified.push(*keyframe),
            }
        }
        let place = match find_consensus(verified, options) {
            Consensus::Nothing => Vec::new(),
            Consensus::Ambiguous => {
                tracing::debug!("several places that look alike explain the image: no answer");
                outcome = MatchOutcome::Ambiguous;
                Vec::new()
            }
            Consensus::Place(place) => {
                outcome = MatchOutcome::Matched;
                let features = distinct_features(place.iter());
                tracing::debug!(keyframes = place.len(), features, "recognized a place");
                place
            }
        };
        Ok(Search { outcome, place, searched_keyframes: 0 })
    }
}
