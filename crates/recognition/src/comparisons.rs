//! The comparison of an image with candidates, as far as it is needed.

use geometry::{PoseWithCovariance, Viewpoint};
use protocol::MatchOutcome;
use vision::Matcher;

use super::consensus::{agree, is_consistent};
use super::evidence::OTHER_PLACE;
use super::index::Votes;
use super::loaded_map::LoadedMap;
use super::options::RecognitionOptions;
use super::query::QueryError;
use super::report::Candidate;
use super::search::prior_radius;
use super::verification::{Comparison, Image, VerifiedKeyframe, compare};

/// Keyframes show one place where they are no farther apart than this part of the map's viewing distance ...
const SAME_PLACE: f64 = 0.4;
/// ... and the cosine of the angle between their optical axes is at least this.
const SAME_PLACE_COSINE: f64 = 0.8;
/// Keyframes of each place that are compared first of all: one may be blurred.
const OF_EACH_PLACE: usize = 2;

/// What makes further candidates of a place needless: they share fewer features with the image.
pub(super) struct Sufficient<'a> {
    pub(super) prior: Option<&'a PoseWithCovariance>,
    pub(super) enough: usize,
}

impl Sufficient<'_> {
    /// Whether enough keyframes are verified, and all of them agree with a tight prior, or without one with the first.
    fn is_reached(
        &self,
        map: &LoadedMap,
        verified: &[VerifiedKeyframe],
        options: &RecognitionOptions,
    ) -> bool {
        let Some(first) = verified.first().filter(|_| verified.len() >= self.enough) else { return false };
        verified.iter().all(|keyframe| match self.tight_prior(map) {
            Some(prior) => is_consistent(&keyframe.global_from_camera, prior, options),
            None => agree(map, first, keyframe, options),
        })
    }

    /// The prior, where no other place that looks alike could be within it.
    fn tight_prior(&self, map: &LoadedMap) -> Option<&PoseWithCovariance> {
        self.prior.filter(|prior| prior_radius(prior) <= OTHER_PLACE * map.viewing_distance())
    }
}

/// Keyframes by the votes for them.
pub(super) struct Ranking<'a> {
    /// Of all keyframes.
    pub(super) votes: &'a [Votes],
    /// Those that may be compared, most votes first.
    pub(super) ranked: Vec<usize>,
    pub(super) near_prior: bool,
}

/// An image that is compared with keyframes, one after the other.
pub(super) struct Comparisons<'a> {
    map: &'a LoadedMap,
    image: &'a Image<'a>,
    ranking: &'a Ranking<'a>,
    options: &'a RecognitionOptions,
    matcher: Matcher,
    compared: Vec<usize>,
    /// Of each of these.
    pub(super) report: Vec<Candidate>,
    /// The keyframes that show what it shows.
    pub(super) verified: Vec<VerifiedKeyframe>,
    /// Of a search in which none is verified.
    pub(super) outcome: MatchOutcome,
}

impl<'a> Comparisons<'a> {
    pub(super) fn new(
        map: &'a LoadedMap,
        image: &'a Image<'a>,
        ranking: &'a Ranking<'a>,
        options: &'a RecognitionOptions,
    ) -> Self {
        Self {
            map,
            image,
            ranking,
            options,
            matcher: Matcher::new(image.descriptors),
            compared: Vec::new(),
            report: Vec::new(),
            verified: Vec::new(),
            outcome: MatchOutcome::NoMatch,
        }
    }

    /// Compares the image with the candidates of most votes, until enough of them agree: those that remain matter only if they are of
    /// another place, which makes the answer ambiguous; with a tight prior not even these.
    pub(super) fn compare_best(&mut self, sufficient: &Sufficient<'_>) -> Result<(), QueryError> {
        let ranking = self.ranking;
        let best = &ranking.ranked[..ranking.ranked.len().min(self.options.candidates)];
        self.compare(best, sufficient)
    }

    /// Compares the image with candidates of other places than those that have most votes, and with more of a place that is found so.
    ///
    /// The neighbours of a keyframe that has many votes have them, too: where the place of an image has changed or is dark, others that look
    /// alike leave it none of the candidates.
    pub(super) fn compare_others(&mut self, sufficient: &Sufficient<'_>) -> Result<(), QueryError> {
        let before = self.verified.len();
        let others = self.of_other_places(self.options.candidates);
        self.compare(&others, sufficient)?;
        let new = self.verified[before..].iter().max_by_key(|found| found.inliers.len());
        let Some(near) = new.map(|found| self.map.near(&found.global_from_camera)) else { return Ok(()) };
        let left = self.ranking.ranked.iter().filter(|at| near[**at] && !self.compared.contains(at));
        let beside: Vec<usize> = left.take(sufficient.enough).copied().collect();
        self.compare(&beside, sufficient)
    }

    /// The candidates of most votes of places of which hardly any keyframe was compared.
    fn of_other_places(&self, count: usize) -> Vec<usize> {
        let map = self.map;
        let reach = SAME_PLACE * map.viewing_distance();
        let view = |at: usize| &map.poses.viewpoints[at];
        let is_same = |a: &Viewpoint, b: &Viewpoint| {
            (a.position - b.position).norm() <= reach && a.axis.dot(&b.axis) >= SAME_PLACE_COSINE
        };
        let mut chosen: Vec<usize> = Vec::new();
        for &candidate in self.ranking.ranked.iter().filter(|at| !self.compared.contains(at)) {
            if chosen.len() == count {
                break;
            }
            let of_place = |at: &&usize| is_same(view(**at), view(candidate));
            if self.compared.iter().chain(&chosen).filter(of_place).count() < OF_EACH_PLACE {
                chosen.push(candidate);
            }
        }
        chosen
    }

    fn compare(&mut self, candidates: &[usize], sufficient: &Sufficient<'_>) -> Result<(), QueryError> {
        let (map, options) = (self.map, self.options);
        // Whether a keyframe may share a field of view with those that are sufficient.
        let mut of_the_place: Option<Vec<bool>> = None;
        let mut reports = Candidate::list(map, candidates, self.ranking.votes, self.ranking.near_prior);
        for (&candidate, report) in candidates.iter().zip(&mut reports) {
            if of_the_place.is_none() && sufficient.is_reached(map, &self.verified, options) {
                if sufficient.tight_prior(map).is_some() {
                    break;
                }
                of_the_place = Some(map.near(&self.verified[0].global_from_camera));
            }
            if of_the_place.as_ref().is_some_and(|of_the_place| of_the_place[candidate]) {
                continue;
            }
            let first = self.verified.first().map(|first| &first.global_from_camera.pose);
            let comparison = compare(map, candidate, self.image, &mut self.matcher, first, options)?;
            report.note(&comparison);
            match comparison {
                Comparison::TooFewMatches { .. } => {}
                Comparison::NoPose { .. } | Comparison::PoseUncertain(_) => {
                    self.outcome = MatchOutcome::NotVerified;
                }
                Comparison::Verified(keyframe) => self.verified.push(*keyframe),
            }
        }
        self.compared.extend(candidates);
        self.report.extend(reports);
        Ok(())
    }
}
