//! The search for the place of an image: near the prior first, else in the whole map.

use geometry::{Camera, PoseWithCovariance, Viewpoint};
use nalgebra::Vector3;
use protocol::{FeatureSet, MatchOutcome, PosePrior, PossiblePlace};
use vision::{DescriptorError, DescriptorView};

use super::comparisons::{Comparisons, Ranking, Sufficient};
use super::consensus::{Consensus, find_consensus, group_places, support};
use super::evidence::coverage;
use super::index::{LandmarkSet, Votes, best_voted};
use super::loaded_map::LoadedMap;
use super::options::RecognitionOptions;
use super::place::RecognizedPlace;
use super::query::QueryError;
use super::report::{Candidate, Hypothesis, MAX_HYPOTHESES, SearchReport};
use super::verification::{Image, VerifiedKeyframe, distinct_features};

/// How many standard deviations of the prior's position a keyframe may be away, beyond the viewing distance.
const PRIOR_SIGMAS: f64 = 3.0;

/// Angle (rad) between the optical axes of two cameras beyond which no descriptor matches, before the prior's uncertainty:
/// what both see is seen from sides that look different.
const MAX_VIEW_ANGLE: f64 = std::f64::consts::FRAC_PI_2;

/// Keyframes near a prior are few where the map has so many times as many: comparing a landmark by itself takes several
/// times as long as in a whole list.
const FEW_KEYFRAMES: usize = 8;

/// Keyframes of the whole map that are ranked by their votes, at most, unless more are compared.
const RANKED: usize = 200;

/// Features that vote for keyframes near a prior, at most: these are few, and the votes only rank them.
const VOTERS_NEAR_PRIOR: usize = 160;

/// The result of a search.
pub(super) struct Search {
    pub(super) outcome: MatchOutcome,
    /// Verified keyframes of one place, most inliers first; empty unless matched.
    pub(super) place: Vec<VerifiedKeyframe>,
    /// That place in short, or the strongest of those that are ambiguous.
    pub(super) strongest: Option<RecognizedPlace>,
    pub(super) searched_keyframes: usize,
    /// The place was found among the keyframes near the prior.
    pub(super) is_near_prior: bool,
    pub(super) candidates: Vec<Candidate>,
    pub(super) hypotheses: Vec<Hypothesis>,
}

impl Search {
    /// Of the place that explains the image best, see [`Hypothesis::log_odds`]; zero without one.
    pub(super) fn log_odds(&self) -> f64 {
        self.hypotheses.first().map_or(0.0, Hypothesis::log_odds)
    }

    /// What of them holds for the map before the image is seen.
    pub(super) fn log_prior_odds(&self) -> f64 {
        self.hypotheses.first().map_or(0.0, |place| place.log_prior_odds)
    }

    /// The places that explain the image, as they are sent.
    pub(super) fn places(&self) -> Vec<PossiblePlace> {
        let place = |hypothesis: &Hypothesis| PossiblePlace {
            global_from_camera: hypothesis.place.global_from_camera,
            features: hypothesis.place.features as u32,
            log_odds: hypothesis.log_odds(),
        };
        self.hypotheses.iter().map(place).collect()
    }

    pub(super) fn into_report(self) -> SearchReport {
        SearchReport { candidates: self.candidates, place: self.strongest, hypotheses: self.hypotheses }
    }
}

/// How far from a prior pose the camera may be (m): 3 standard deviations of its position.
pub fn prior_radius(prior: &PoseWithCovariance) -> f64 {
    PRIOR_SIGMAS * largest_sigma(prior, 3)
}

/// Whether a prior pose supports one that was found: it lies within 3 standard deviations of both, in position and rotation.
pub fn is_supported(found: &PoseWithCovariance, prior: &PoseWithCovariance) -> bool {
    let sigma = |start: usize| largest_sigma(prior, start).hypot(largest_sigma(found, start));
    let distance = (found.pose.translation - prior.pose.translation).norm();
    let angle = found.pose.rotation.angle_to(&prior.pose.rotation);
    distance <= PRIOR_SIGMAS * sigma(3) && angle <= PRIOR_SIGMAS * sigma(0)
}

/// The largest standard deviation of a pose's rotation (rad; starts at 0) or position (m; starts at 3).
fn largest_sigma(prior: &PoseWithCovariance, start: usize) -> f64 {
    let block = prior.covariance.fixed_view::<3, 3>(start, start).into_owned();
    block.symmetric_eigenvalues().max().max(0.0).sqrt()
}

impl LoadedMap {
    /// Finds the place of an image: near the prior, and where none is verified there, in the whole map.
    ///
    /// # Arguments
    /// * `enough`: once so many keyframes agree, further candidates of their place are not compared.
    pub(super) fn search(
        &self,
        camera: &Camera,
        features: &FeatureSet,
        prior: Option<&PosePrior>,
        gravity_in_camera: Option<Vector3<f64>>,
        enough: usize,
        options: &RecognitionOptions,
    ) -> Result<Search, QueryError> {
        let nothing = |outcome| {
            let (place, candidates, hypotheses) = (Vec::new(), Vec::new(), Vec::new());
            let (strongest, searched_keyframes, is_near_prior) = (None, 0, false);
            Ok(Search {
                outcome,
                place,
                strongest,
                searched_keyframes,
                is_near_prior,
                candidates,
                hypotheses,
            })
        };
        if self.poses.keyframes.is_empty() {
            return nothing(MatchOutcome::EmptyMap);
        }
        if features.len() < options.min_inliers {
            return nothing(MatchOutcome::TooFewFeatures);
        }
        let descriptors = self.view(features)?;
        let image = Image { camera, features, descriptors, gravity_in_camera };
        let mut of_prior = Vec::new();
        if let Some(prior) = prior {
            let near = self.near(&prior.global_from_camera);
            let sufficient = Sufficient { prior: Some(&prior.global_from_camera), enough };
            let votes = self.votes_near(descriptors, &near)?;
            let ranked = best_voted(&votes, options.candidates, options.min_votes, |at| near[at]);
            let ranking = Ranking { votes: &votes, ranked, near_prior: true };
            let place = self.recognize(&ranking, &image, &sufficient, options)?;
            if place.outcome == MatchOutcome::Matched {
                let searched_keyframes = near.iter().filter(|&&near| near).count();
                return Ok(Search { searched_keyframes, is_near_prior: true, ..place });
            }
            of_prior = place.candidates;
        }
        let votes = self.index.vote(descriptors, &self.landmarks.observers, self.poses.keyframes.len())?;
        let sufficient = Sufficient { prior: None, enough };
        let ranked = best_voted(&votes, RANKED.max(options.candidates), options.min_votes, |_| true);
        let ranking = Ranking { votes: &votes, ranked, near_prior: false };
        let mut place = self.recognize(&ranking, &image, &sufficient, options)?;
        place.candidates.splice(0..0, of_prior);
        Ok(Search { searched_keyframes: self.poses.keyframes.len(), ..place })
    }

    /// Whether a prior tells the place that was found from those that look alike: it was found near the prior, at a pose that the prior
    /// supports, and the prior is not so wide that another place could be, too.
    pub(super) fn is_told_by(&self, prior: &PosePrior, search: &Search, found: &PoseWithCovariance) -> bool {
        let prior = &prior.global_from_camera;
        search.is_near_prior && is_supported(found, prior) && self.tells_places_apart(prior)
    }

    /// Whether a prior is not so wide that the camera could be at another place that looks alike.
    fn tells_places_apart(&self, prior: &PoseWithCovariance) -> bool {
        prior_radius(prior) <= self.viewing_distance()
    }

    /// Which keyframes may share a field of view with a camera near a prior pose: by their distance, and by the angle
    /// between their optical axes.
    pub(super) fn near(&self, prior: &PoseWithCovariance) -> Vec<bool> {
        let radius = prior_radius(prior) + self.viewing_distance();
        let angle = MAX_VIEW_ANGLE + PRIOR_SIGMAS * largest_sigma(prior, 0);
        let least_cosine = angle.min(std::f64::consts::PI).cos();
        let wanted = Viewpoint::of(&prior.pose);
        let is_near = |viewpoint: &Viewpoint| {
            (viewpoint.position - wanted.position).norm() <= radius
                && viewpoint.axis.dot(&wanted.axis) >= least_cosine
        };
        self.poses.viewpoints.iter().map(is_near).collect()
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
            return self.index.vote(descriptors, &self.landmarks.observers, self.poses.keyframes.len());
        }
        let mut among = LandmarkSet::empty(self.landmarks.len());
        for landmark in few.iter().flat_map(|&keyframe| self.observations.of(keyframe).landmarks) {
            among.insert(*landmark);
        }
        let step = descriptors.len().div_ceil(VOTERS_NEAR_PRIOR).max(1);
        let voters: Vec<u8> = descriptors.iter().step_by(step).flatten().copied().collect();
        let voters = DescriptorView::new(descriptors.metric(), descriptors.width(), &voters)?;
        let mut votes =
            self.index.vote_among(voters, &self.landmarks.observers, self.poses.keyframes.len(), &among)?;
        for votes in &mut votes {
            votes.stand_for(step as u32);
        }
        Ok(votes)
    }

    /// Compares an image with candidates and finds the one place that they agree on.
    ///
    /// Without a prior, where no place of the candidates with most votes is told from a picture that repeats, others are compared.
    fn recognize(
        &self,
        ranking: &Ranking<'_>,
        image: &Image<'_>,
        sufficient: &Sufficient<'_>,
        options: &RecognitionOptions,
    ) -> Result<Search, QueryError> {
        let mut comparisons = Comparisons::new(self, image, ranking, options);
        comparisons.compare_best(sufficient)?;
        let log_prior_odds = self.aliasing_rate().log_odds();
        let weigh = |verified: &mut Vec<VerifiedKeyframe>| {
            let places = group_places(self, verified, options);
            let hypotheses = self.hypotheses(image, verified, &places, log_prior_odds);
            (places, hypotheses)
        };
        let (mut places, mut hypotheses) = weigh(&mut comparisons.verified);
        let is_told = |first: &Hypothesis| first.log_odds() >= options.min_fix_log_odds;
        if sufficient.prior.is_none() && !hypotheses.first().is_some_and(is_told) {
            comparisons.compare_others(sufficient)?;
            (places, hypotheses) = weigh(&mut comparisons.verified);
        }
        let Comparisons { verified, mut outcome, report: mut candidates, .. } = comparisons;
        let mut strongest = None;
        let telling = sufficient.prior.filter(|prior| self.tells_places_apart(prior));
        let place = match find_consensus(verified, &places, &hypotheses, telling, options) {
            Consensus::Nothing => Vec::new(),
            Consensus::Ambiguous(place) => {
                strongest = Some(*place);
                tracing::debug!("several places that look alike explain the image: no answer");
                outcome = MatchOutcome::Ambiguous;
                Vec::new()
            }
            Consensus::Place(_)
                if sufficient.prior.is_none()
                    && hypotheses.first().is_some_and(|place| place.log_odds() < options.min_log_odds) =>
            {
                strongest = hypotheses.first().map(|hypothesis| hypothesis.place.clone());
                tracing::debug!(?hypotheses, "a picture that repeats explains the image better: no answer");
                outcome = MatchOutcome::Ambiguous;
                Vec::new()
            }
            Consensus::Place(place) => {
                outcome = MatchOutcome::Matched;
                let features = distinct_features(place.iter());
                tracing::debug!(keyframes = place.len(), features, "recognized a place");
                strongest = place.first().map(|best| {
                    let global_from_camera = best.global_from_camera;
                    RecognizedPlace { global_from_camera, features }
                });
                for candidate in &mut candidates {
                    candidate.in_answer = place
                        .iter()
                        .any(|verified| self.poses.keyframes[verified.keyframe].id == candidate.keyframe);
                }
                place
            }
        };
        let (searched_keyframes, is_near_prior) = (0, false);
        Ok(Search { outcome, place, strongest, searched_keyframes, is_near_prior, candidates, hypotheses })
    }

    /// What each place explains of all that it should.
    ///
    /// # Arguments
    /// * `log_prior_odds`: of the right place over one that looks alike, before the image is seen.
    pub(super) fn hypotheses(
        &self,
        image: &Image<'_>,
        verified: &[VerifiedKeyframe],
        places: &[Vec<usize>],
        log_prior_odds: f64,
    ) -> Vec<Hypothesis> {
        let hypothesis = |members: &Vec<usize>| {
            let of_place: Vec<&VerifiedKeyframe> = members.iter().map(|&at| &verified[at]).collect();
            let global_from_camera = of_place.first()?.global_from_camera;
            let coverage = coverage(self, image.camera, image.features, &global_from_camera.pose, &of_place);
            let features = support(verified, members);
            let place = RecognizedPlace { global_from_camera, features };
            Some(Hypothesis { place, coverage, log_prior_odds })
        };
        places.iter().take(MAX_HYPOTHESES).filter_map(hypothesis).collect()
    }
}
