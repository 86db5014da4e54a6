//! What a search found out on its way to an answer, small enough to be kept for each query.
//!
//! Unlike an [`Inspection`](super::Inspection) it costs no further comparison and holds no features.

use nalgebra::Vector3;
use protocol::KeyframeId;

use super::evidence::Coverage;
use super::index::Votes;
use super::inspection::KeyframeVerdict;
use super::loaded_map::LoadedMap;
use super::place::RecognizedPlace;
use super::verification::Comparison;

/// What a search found out.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct SearchReport {
    /// The candidates in the order in which they were compared: first those near the prior, then those of the whole map, where these were
    /// searched, by their votes, and those of other places than these. At most some three times
    /// [`candidates`](super::RecognitionOptions::candidates).
    pub candidates: Vec<Candidate>,
    /// The place that was recognized, or the strongest of those that were ambiguous.
    pub place: Option<RecognizedPlace>,
    /// The places that explain the image, the one that explains most features first, of the last list of candidates that was
    /// compared. At most [`MAX_HYPOTHESES`].
    pub hypotheses: Vec<Hypothesis>,
}

/// Hypotheses of one image that are reported, at most.
pub const MAX_HYPOTHESES: usize = 4;

/// A place that an image may be of.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Hypothesis {
    /// The place.
    pub place: RecognizedPlace,
    /// What it explains of all that it should.
    pub coverage: Coverage,
    /// Natural logarithm of the odds of the right place over one that looks alike, before the image is seen, see
    /// [`AliasingRate`](super::AliasingRate).
    pub log_prior_odds: f64,
}

impl Hypothesis {
    /// Natural logarithm of the odds that the image is of this place and not of a picture that repeats.
    pub fn log_odds(&self) -> f64 {
        self.log_prior_odds + self.coverage.log_likelihood_ratio()
    }
}

impl SearchReport {
    /// Position of the camera in G (m) by the keyframe with most inliers; `None` for an image that was not recognized.
    pub fn camera_in_global(&self) -> Option<Vector3<f64>> {
        self.place.as_ref().map(|place| place.global_from_camera.pose.translation)
    }
}

/// One of the keyframes that most features of a query voted for.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Candidate {
    /// Identity within the map.
    pub keyframe: KeyframeId,
    /// Whether it was searched because it is near the prior.
    pub near_prior: bool,
    /// Query features that voted for it. Near a prior, where some of the features vote for all, an estimate.
    pub votes: u32,
    /// Descriptor matches; none where it was not compared.
    pub matches: u32,
    /// Matches that agree with the pose that was found; none without one.
    pub inliers: u32,
    /// Mean reprojection error of the inliers (px).
    pub mean_error_px: Option<f64>,
    /// Result of the comparison; `None` where it was needless, since enough better candidates agreed.
    pub verdict: Option<KeyframeVerdict>,
    /// Whether it is one of the keyframes that agree on the answer.
    pub in_answer: bool,
}

impl Candidate {
    /// Candidates that are not compared yet.
    pub(super) fn list(
        map: &LoadedMap,
        candidates: &[usize],
        votes: &[Votes],
        near_prior: bool,
    ) -> Vec<Self> {
        let one = |&at: &usize| Self {
            keyframe: map.poses.keyframes[at].id,
            near_prior,
            votes: votes[at].features,
            matches: 0,
            inliers: 0,
            mean_error_px: None,
            verdict: None,
            in_answer: false,
        };
        candidates.iter().map(one).collect()
    }

    /// Notes the result of the comparison.
    pub(super) fn note(&mut self, comparison: &Comparison) {
        let (verdict, matches, found) = match comparison {
            Comparison::TooFewMatches { matches } => (KeyframeVerdict::TooFewMatches, *matches, None),
            Comparison::NoPose { matches } => (KeyframeVerdict::NoPose, *matches, None),
            Comparison::PoseUncertain(found) => {
                (KeyframeVerdict::PoseUncertain, found.matches.len(), Some(found))
            }
            Comparison::Verified(found) => (KeyframeVerdict::Verified, found.matches.len(), Some(found)),
        };
        self.verdict = Some(verdict);
        self.matches = matches as u32;
        self.inliers = found.map_or(0, |found| found.inliers.len() as u32);
        self.mean_error_px = found.map(|found| found.mean_error_px);
    }
}
