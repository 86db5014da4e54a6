//! Every intermediate result of a query, for diagnosing why an image was recognized or not.
//!
//! Candidates and comparison are those of the answers themselves, and the search tells which keyframes are part of the answer; here
//! nothing is discarded, and candidates that an answer needs no more are compared too.

use std::collections::HashSet;

use geometry::{Camera, Pose, PoseWithCovariance};
use nalgebra::{Vector2, Vector3};
use protocol::{KeyframeId, LandmarkId, LocalizeReply, LocalizeRequest};
use vision::{Match, Matcher};

use super::index::{Votes, best_voted};
use super::loaded_map::LoadedMap;
use super::options::RecognitionOptions;
use super::query::QueryError;
use super::report::SearchReport;
use super::verification::{Comparison, Image, VerifiedKeyframe, compare};

/// The answer to a query, and the comparison with each candidate.
#[derive(Clone, Debug, PartialEq)]
pub struct Inspection {
    /// What [`LoadedMap::localize`] answers.
    pub reply: LocalizeReply,
    /// The candidates: first those that the answer is made of, then by verdict, inliers and matches. Empty where there
    /// was nothing to compare: an empty map, too few features, no keyframe with enough votes.
    pub keyframes: Vec<InspectedKeyframe>,
}

/// The result of the comparison with one keyframe; better is greater.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum KeyframeVerdict {
    /// Fewer matches than a verification needs.
    TooFewMatches,
    /// No camera pose explains enough of the matches.
    NoPose,
    /// A pose explains enough of them, but do not constrain it: they lie in a corner, or are all far away.
    PoseUncertain,
    /// One pose explains enough of them and is well constrained.
    Verified,
}

impl KeyframeVerdict {
    /// The verdict in words.
    ///
    /// # Arguments
    /// * `in_answer`: whether the keyframe agrees with the others of the answer.
    pub fn describe(self, in_answer: bool) -> &'static str {
        match self {
            Self::Verified if in_answer => "part of the answer",
            Self::Verified => "verified",
            Self::PoseUncertain => "pose too uncertain",
            Self::NoPose => "no pose fits",
            Self::TooFewMatches => "too few matches",
        }
    }
}

/// One keyframe beside the query.
#[derive(Clone, Debug, PartialEq)]
pub struct InspectedKeyframe {
    /// Identity within the map.
    pub id: KeyframeId,
    /// When its image was taken (ns).
    pub stamp_ns: i64,
    /// The camera that took it.
    pub camera: Camera,
    /// Pixels of its landmarks (px).
    pub landmark_pixels: Vec<[f32; 2]>,
    /// Query features that voted for it; the candidates with most votes are compared.
    pub votes: usize,
    /// Result of the comparison.
    pub verdict: KeyframeVerdict,
    /// Whether it is one of the keyframes that agree on the answer.
    pub in_answer: bool,
    /// All descriptor matches, inliers and outliers.
    pub matches: Vec<InspectedMatch>,
    /// The camera's pose in G from this keyframe alone, where one was found.
    pub global_from_camera: Option<PoseWithCovariance>,
    /// Mean reprojection error of the inliers (px), where a pose was found.
    pub mean_error_px: Option<f64>,
    /// Largest reprojection error of an inlier (px).
    pub gate_px: f64,
}

/// A query feature and the landmark that it was matched with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InspectedMatch {
    /// Index of the query's feature.
    pub feature: usize,
    /// The landmark.
    pub landmark: LandmarkId,
    /// The feature in the query (px).
    pub query_pixel: [f32; 2],
    /// The landmark in the keyframe (px).
    pub keyframe_pixel: [f32; 2],
    /// Distance of the descriptors, in the unit of the metric.
    pub distance: f32,
    /// Whether it agrees with the pose that was found; `false` where none was.
    pub inlier: bool,
    /// Projection of the landmark at that pose (px); `None` without a pose, and behind the camera.
    pub predicted_pixel: Option<[f64; 2]>,
}

impl InspectedKeyframe {
    /// Number of matches that agree with the pose.
    pub fn inliers(&self) -> usize {
        self.matches.iter().filter(|found| found.inlier).count()
    }
}

impl InspectedMatch {
    /// Reprojection error at the pose that was found (px).
    pub fn error_px(&self) -> Option<f64> {
        let predicted = self.predicted_pixel?;
        let [u, v] = self.query_pixel.map(f64::from);
        Some((u - predicted[0]).hypot(v - predicted[1]))
    }
}

impl LoadedMap {
    /// Answers a one-shot localization query and reports every intermediate result.
    ///
    /// # Errors
    /// [`QueryError`] where the query cannot be compared with the map.
    pub fn inspect(
        &self,
        request: &LocalizeRequest,
        options: &RecognitionOptions,
    ) -> Result<Inspection, QueryError> {
        let (reply, report) = self.localize_with_report(request, options)?;
        self.for_features(&request.features).inspect_of_kind(request, reply, &report, options)
    }

    /// The comparison with this kind of features.
    ///
    /// # Arguments
    /// * `report`: of the search for the reply.
    fn inspect_of_kind(
        &self,
        request: &LocalizeRequest,
        reply: LocalizeReply,
        report: &SearchReport,
        options: &RecognitionOptions,
    ) -> Result<Inspection, QueryError> {
        if self.poses.keyframes.is_empty() || request.features.len() < options.min_inliers {
            return Ok(Inspection { reply, keyframes: Vec::new() });
        }
        let agreeing = || report.candidates.iter().filter(|candidate| candidate.in_answer);
        let mut compared = match &request.prior {
            Some(prior) if agreeing().any(|candidate| candidate.near_prior) => {
                let near = self.near(&prior.global_from_camera);
                self.inspector(request, options, Some(&near))?.candidates(|at| near[at])?
            }
            _ => self.inspector(request, options, None)?.candidates(|_| true)?,
        };
        let in_answer: HashSet<KeyframeId> = agreeing().map(|candidate| candidate.keyframe).collect();
        for keyframe in &mut compared {
            keyframe.in_answer = reply.fix.is_some() && in_answer.contains(&keyframe.id);
        }
        let best = reply.fix.as_ref().map(|fix| fix.keyframe);
        let rank = |keyframe: &InspectedKeyframe| {
            let is_best = Some(keyframe.id) == best;
            (is_best, keyframe.in_answer, keyframe.verdict, keyframe.inliers(), keyframe.matches.len())
        };
        // Stable: of equals, the one with more votes stays first.
        compared.sort_by_key(|keyframe| std::cmp::Reverse(rank(keyframe)));
        Ok(Inspection { reply, keyframes: compared })
    }

    /// Compares a query with one keyframe, whether it is a candidate or not, as a search of the whole map does.
    ///
    /// # Returns
    /// `None` where the map has no keyframe of that id. It is never marked as part of an answer.
    ///
    /// # Errors
    /// [`QueryError`] where the query cannot be compared with the map.
    pub fn inspect_keyframe(
        &self,
        request: &LocalizeRequest,
        id: KeyframeId,
        options: &RecognitionOptions,
    ) -> Result<Option<InspectedKeyframe>, QueryError> {
        let Some(at) = self.index_of(id) else { return Ok(None) };
        let inspector = self.for_features(&request.features).inspector(request, options, None)?;
        let expected = inspector.expected_at(at)?;
        Ok(Some(inspector.keyframe(at, expected.as_ref())?.0))
    }

    fn inspector<'a>(
        &'a self,
        request: &'a LocalizeRequest,
        options: &'a RecognitionOptions,
        near: Option<&[bool]>,
    ) -> Result<Inspector<'a>, QueryError> {
        let descriptors = self.view(&request.features)?;
        let gravity_in_camera = request.gravity_in_camera.map(Vector3::from);
        let image =
            Image { camera: &request.camera, features: &request.features, descriptors, gravity_in_camera };
        let votes = match near {
            Some(near) => self.votes_near(descriptors, near)?,
            None => self.index.vote(descriptors, &self.landmarks.observers, self.poses.keyframes.len())?,
        };
        Ok(Inspector { map: self, image, votes, options })
    }
}

/// One query against one map.
struct Inspector<'a> {
    map: &'a LoadedMap,
    image: Image<'a>,
    votes: Vec<Votes>,
    options: &'a RecognitionOptions,
}

impl Inspector<'_> {
    /// The keyframes that a search compares, most votes first.
    fn best_voted(&self, eligible: impl Fn(usize) -> bool) -> Vec<usize> {
        best_voted(&self.votes, self.options.candidates, self.options.min_votes, eligible)
    }

    /// Compares the candidates among some keyframes, most votes first; none is marked as part of an answer.
    fn candidates(&self, eligible: impl Fn(usize) -> bool) -> Result<Vec<InspectedKeyframe>, QueryError> {
        let mut inspected = Vec::new();
        let mut expected: Option<Pose> = None;
        for at in self.best_voted(eligible) {
            let (keyframe, comparison) = self.keyframe(at, expected.as_ref())?;
            inspected.push(keyframe);
            if let Comparison::Verified(found) = comparison {
                expected = expected.or(Some(found.global_from_camera.pose));
            }
        }
        Ok(inspected)
    }

    /// The pose that a search expects when it comes to a keyframe: that of the first candidate that it verified before.
    fn expected_at(&self, keyframe: usize) -> Result<Option<Pose>, QueryError> {
        let mut matcher = Matcher::new(self.image.descriptors);
        for at in self.best_voted(|_| true).into_iter().take_while(|&at| at != keyframe) {
            let comparison = compare(self.map, at, &self.image, &mut matcher, None, self.options)?;
            if let Comparison::Verified(found) = comparison {
                return Ok(Some(found.global_from_camera.pose));
            }
        }
        Ok(None)
    }

    /// # Arguments
    /// * `expected`: the camera in G, see [`compare`].
    fn keyframe(
        &self,
        at: usize,
        expected: Option<&Pose>,
    ) -> Result<(InspectedKeyframe, Comparison), QueryError> {
        let keyframe = &self.map.poses.keyframes[at];
        let match_options = self.map.match_options();
        let mut matcher = Matcher::new(self.image.descriptors);
        let matches = matcher.matches(self.map.descriptors_of(at)?, &match_options)?;
        let comparison = compare(self.map, at, &self.image, &mut matcher, expected, self.options)?;
        let (verdict, found) = match &comparison {
            Comparison::TooFewMatches { .. } => (KeyframeVerdict::TooFewMatches, None),
            Comparison::NoPose { .. } => (KeyframeVerdict::NoPose, None),
            Comparison::PoseUncertain(found) => (KeyframeVerdict::PoseUncertain, Some(found.as_ref())),
            Comparison::Verified(found) => (KeyframeVerdict::Verified, Some(found.as_ref())),
        };
        let focal = f64::midpoint(self.image.camera.focal[0], self.image.camera.focal[1]);
        let inspected = InspectedKeyframe {
            id: keyframe.id,
            stamp_ns: keyframe.stamp_ns,
            camera: keyframe.camera.clone(),
            landmark_pixels: self.map.observations.of(at).pixels.to_vec(),
            votes: self.votes[at].features as usize,
            verdict,
            in_answer: false,
            matches: matches.iter().map(|one| self.one_match(at, one, found)).collect(),
            global_from_camera: found.map(|found| found.global_from_camera),
            mean_error_px: found.map(|found| found.mean_error_px),
            gate_px: self.options.inlier_angle * focal,
        };
        Ok((inspected, comparison))
    }

    fn one_match(&self, at: usize, one: &Match, found: Option<&VerifiedKeyframe>) -> InspectedMatch {
        let observed = self.map.observations.of(at);
        let predicted = found.and_then(|found| {
            let point = self.map.observed_point(at, one.train);
            let in_global = self.map.poses.keyframes[at].global_from_keyframe.pose.transform(&point);
            let in_camera = found.global_from_camera.pose.inverse_transform(&in_global);
            self.image.camera.project(&in_camera).ok()
        });
        InspectedMatch {
            feature: one.query,
            landmark: self.map.landmarks.ids[observed.landmark(one.train)],
            query_pixel: self.image.features.pixels[one.query],
            keyframe_pixel: observed.pixels[one.train],
            distance: one.distance,
            inlier: found.is_some_and(|found| found.inliers.contains(one)),
            predicted_pixel: predicted.map(|pixel: Vector2<f64>| pixel.into()),
        }
    }
}

#[cfg(test)]
mod tests {
    use protocol::MatchOutcome;
    use rand::SeedableRng;
    use rand::rngs::StdRng;
    use testing::{Place, PlaceOptions};

    use super::*;

    #[test]
    fn what_the_search_refuses_is_no_part_of_an_answer() {
        let place = Place::new(&PlaceOptions::default());
        let map = LoadedMap::from_contents(place.map.clone()).unwrap();
        let request = place.request(&place.camera_at(12.0, 0.3, 0.05), 3, &mut StdRng::seed_from_u64(12));
        let request = LocalizeRequest {
            camera: request.camera,
            features: request.features,
            prior: None,
            gravity_in_camera: None,
        };
        // No answer has odds of 1e3.
        for (min_log_odds, is_refused) in [(-1e3, false), (1e3, true)] {
            let options = RecognitionOptions { min_log_odds, ..RecognitionOptions::default() };
            let inspection = map.inspect(&request, &options).unwrap();
            assert!(!is_refused || inspection.reply.outcome == MatchOutcome::Ambiguous);
            let verified = |keyframe: &&InspectedKeyframe| keyframe.verdict == KeyframeVerdict::Verified;
            assert!(inspection.keyframes.iter().filter(verified).count() > 1);
            assert_eq!(inspection.keyframes.iter().any(|keyframe| keyframe.in_answer), !is_refused);
            for keyframe in &inspection.keyframes {
                let alone = map.inspect_keyframe(&request, keyframe.id, &options).unwrap().unwrap();
                assert_eq!(alone, InspectedKeyframe { in_answer: false, ..keyframe.clone() });
            }
        }
    }
}
