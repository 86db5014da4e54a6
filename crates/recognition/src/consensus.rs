//! One place or none: verified keyframes must agree on the camera pose.
//!
//! Keyframes of two halls that look alike are both verified. The places are distinguished by the camera pose in G that
//! each keyframe implies: keyframes whose poses agree within their covariances form a place, the place that explains
//! most query features is selected, and where another explains nearly as many the query is ambiguous.

use geometry::PoseWithCovariance;
use nalgebra::{Matrix6, Vector6};

use super::options::RecognitionOptions;
use super::place::RecognizedPlace;
use super::report::Hypothesis;
use super::verification::{VerifiedKeyframe, distinct_features};

/// 99.9 % of consistent poses have a smaller squared distance (chi-square, 6 degrees of freedom).
const CHI_SQUARE_6_999: f64 = 22.458;

/// Whether verified keyframes agree on a place.
pub(crate) enum Consensus {
    /// There are no verified keyframes.
    Nothing,
    /// Two different places explain the image nearly equally well. The stronger one.
    Ambiguous(Box<RecognizedPlace>),
    /// They agree: the verified keyframes of the place, most inliers first.
    Place(Vec<VerifiedKeyframe>),
}

/// Decides which of the places that verified keyframes are of is the image's.
///
/// # Arguments
/// * `places`: from [`group_places`] of the same keyframes.
/// * `hypotheses`: what the first of them explain.
pub(crate) fn find_consensus(
    mut verified: Vec<VerifiedKeyframe>,
    places: &[Vec<usize>],
    hypotheses: &[Hypothesis],
    options: &RecognitionOptions,
) -> Consensus {
    let Some(winner) = places.first() else { return Consensus::Nothing };
    if has_rival(&verified, places, hypotheses, options) {
        let global_from_camera = verified[winner[0]].global_from_camera;
        let place = RecognizedPlace { global_from_camera, features: support(&verified, winner) };
        return Consensus::Ambiguous(Box::new(place));
    }
    let mut at = 0;
    verified.retain(|_| {
        at += 1;
        winner.contains(&(at - 1))
    });
    Consensus::Place(verified)
}

/// Whether another place explains an image nearly as well as the first one does.
pub(crate) fn has_rival(
    verified: &[VerifiedKeyframe],
    places: &[Vec<usize>],
    hypotheses: &[Hypothesis],
    options: &RecognitionOptions,
) -> bool {
    let Some(winner) = places.first() else { return false };
    let least = options.ambiguity_ratio * support(verified, winner) as f64;
    places.iter().enumerate().skip(1).any(|(number, rival)| {
        let is_less_likely = hypotheses
            .get(number)
            .is_some_and(|rival| hypotheses[0].log_odds() - rival.log_odds() >= options.min_fix_log_odds);
        !is_less_likely && support(verified, rival) as f64 >= least
    })
}

/// Sorts verified keyframes, most inliers first, and groups those that agree on a place: the place that explains most query
/// features first.
pub(crate) fn group_places(
    verified: &mut [VerifiedKeyframe],
    options: &RecognitionOptions,
) -> Vec<Vec<usize>> {
    verified.sort_by_key(|verified| (std::cmp::Reverse(verified.inliers.len()), verified.keyframe));
    let verified = &*verified;
    let members_of = |seed: usize, among: &[usize]| -> Vec<usize> {
        let consistent = |&other: &usize| {
            let (a, b) = (&verified[seed].global_from_camera, &verified[other].global_from_camera);
            seed == other || is_consistent(a, b, options)
        };
        among.iter().copied().filter(consistent).collect()
    };
    let mut rest: Vec<usize> = (0..verified.len()).collect();
    let mut places = Vec::new();
    while !rest.is_empty() {
        let candidates = rest.iter().map(|&seed| members_of(seed, &rest));
        let supported = candidates.map(|members| (support(verified, &members), members));
        // Of equal support the first, whose seed has most inliers.
        let best = supported.reduce(|best, next| if next.0 > best.0 { next } else { best });
        let place = best.map(|(_, members)| members).unwrap_or_default();
        rest.retain(|at| !place.contains(at));
        places.push(place);
    }
    places
}

/// How many query features a place explains.
pub(crate) fn support(verified: &[VerifiedKeyframe], members: &[usize]) -> usize {
    distinct_features(members.iter().map(|&member| &verified[member]))
}

/// Whether two estimates of one camera pose are consistent: chi-square test of their difference.
pub(crate) fn is_consistent(
    a: &PoseWithCovariance,
    b: &PoseWithCovariance,
    options: &RecognitionOptions,
) -> bool {
    let (theta, p) = (options.tolerance_theta.powi(2), options.tolerance_p.powi(2));
    let tolerance = Matrix6::from_diagonal(&Vector6::new(theta, theta, theta, p, p, p));
    let difference = a.pose.local(&b.pose);
    let covariance = a.covariance + b.covariance + tolerance;
    let squared = covariance.cholesky().map(|factor| difference.dot(&factor.solve(&difference)));
    squared.is_some_and(|squared| squared <= CHI_SQUARE_6_999)
}
