//! One place or none: verified keyframes must agree on the camera pose.
//!
//! Keyframes of two halls that look alike are both verified. The places are distinguished by the camera pose in G that
//! each keyframe implies: keyframes of which each agrees with all others form a place, the place that explains most query
//! features is selected, and where another explains nearly as many the query is ambiguous. Two keyframes of a map may err
//! together by metres: whether they agree is a matter of the covariance of their difference.

use geometry::{Pose, PoseWithCovariance, compose_jacobians};
use nalgebra::{Matrix6, Vector6};

use super::loaded_map::LoadedMap;
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
    map: &LoadedMap,
    mut verified: Vec<VerifiedKeyframe>,
    places: &[Vec<usize>],
    hypotheses: &[Hypothesis],
    options: &RecognitionOptions,
) -> Consensus {
    let Some(winner) = places.first() else { return Consensus::Nothing };
    if has_rival(map, &verified, places, hypotheses, options) {
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

/// Whether another place explains an image nearly as well as the first one does. One whose best keyframe agrees with that of
/// the first is no other place.
pub(crate) fn has_rival(
    map: &LoadedMap,
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
        let is_elsewhere = || !agree(map, &verified[winner[0]], &verified[rival[0]], options);
        !is_less_likely && support(verified, rival) as f64 >= least && is_elsewhere()
    })
}

/// Sorts verified keyframes, most inliers first, and groups those that agree on a place: the place that explains most query
/// features first, each with its keyframes of most inliers first.
pub(crate) fn group_places(
    map: &LoadedMap,
    verified: &mut [VerifiedKeyframe],
    options: &RecognitionOptions,
) -> Vec<Vec<usize>> {
    verified.sort_by_key(|verified| (std::cmp::Reverse(verified.inliers.len()), verified.keyframe));
    let verified = &*verified;
    let count = verified.len();
    let mut agreeing = vec![true; count * count];
    for a in 0..count {
        for b in 0..a {
            let pair = agree(map, &verified[a], &verified[b], options);
            (agreeing[a * count + b], agreeing[b * count + a]) = (pair, pair);
        }
    }
    let mut rest: Vec<usize> = (0..count).collect();
    let mut places = Vec::new();
    while !rest.is_empty() {
        let candidates = rest.iter().map(|&seed| members_of(seed, &rest, |a, b| agreeing[a * count + b]));
        let supported = candidates.map(|members| (support(verified, &members), members));
        // Of equal support the first, whose seed has most inliers.
        let best = supported.reduce(|best, next| if next.0 > best.0 { next } else { best });
        let place = best.map(|(_, members)| members).unwrap_or_default();
        rest.retain(|at| !place.contains(at));
        places.push(place);
    }
    places
}

/// The keyframes that agree with a seed and with each other, in their order. A keyframe that hardly constrains the pose agrees with
/// places that contradict each other, and does not make one of them.
fn members_of(seed: usize, among: &[usize], agree: impl Fn(usize, usize) -> bool) -> Vec<usize> {
    let mut members = vec![seed];
    for &other in among {
        if other != seed && members.iter().all(|&member| agree(member, other)) {
            members.push(other);
        }
    }
    members.sort_unstable();
    members
}

/// How many query features a place explains.
pub(crate) fn support(verified: &[VerifiedKeyframe], members: &[usize]) -> usize {
    distinct_features(members.iter().map(|&member| &verified[member]))
}

/// Whether two keyframes place the camera at one pose, see [`agree_by`].
pub(crate) fn agree(
    map: &LoadedMap,
    a: &VerifiedKeyframe,
    b: &VerifiedKeyframe,
    options: &RecognitionOptions,
) -> bool {
    let of = |found: &VerifiedKeyframe| (found.keyframe, found.keyframe_from_camera);
    agree_by(map, &of(a), &of(b), options)
}

/// Whether two poses of a camera in the frames of keyframes are one in G: chi-square test of the difference, in which errors that the
/// keyframes share cancel.
///
/// # Arguments
/// * `a`, `b`: index of the keyframe, and the camera in its frame with the uncertainty of the pixels.
pub(crate) fn agree_by(
    map: &LoadedMap,
    a: &(usize, PoseWithCovariance),
    b: &(usize, PoseWithCovariance),
    options: &RecognitionOptions,
) -> bool {
    let in_global = |(keyframe, camera): &(usize, PoseWithCovariance)| {
        map.poses.keyframes[*keyframe].global_from_keyframe.pose.compose(&camera.pose)
    };
    is_within(&in_global(a), &in_global(b), &difference_covariance(map, a, b), options)
}

/// Covariance of the difference of two poses of a camera in the frames of keyframes: of the pixels of both, and of the keyframes'
/// poses relative to each other.
fn difference_covariance(
    map: &LoadedMap,
    a: &(usize, PoseWithCovariance),
    b: &(usize, PoseWithCovariance),
) -> Matrix6<f64> {
    let (own, other) = (&map.poses.keyframes[a.0], &map.poses.keyframes[b.0]);
    let (a_by_keyframe, a_by_camera) = compose_jacobians(&own.global_from_keyframe.pose, &a.1.pose);
    let (b_by_keyframe, b_by_camera) = compose_jacobians(&other.global_from_keyframe.pose, &b.1.pose);
    let of_pixels = a_by_camera * a.1.covariance * a_by_camera.transpose()
        + b_by_camera * b.1.covariance * b_by_camera.transpose();
    let (own_covariance, other_covariance) =
        (own.global_from_keyframe.covariance, other.global_from_keyframe.covariance);
    let cross = if own.id == other.id {
        own_covariance
    } else {
        map.joint_covariance(own.id, other.id).unwrap_or_default()
    };
    let cross = a_by_keyframe * cross * b_by_keyframe.transpose();
    let of_keyframes = a_by_keyframe * own_covariance * a_by_keyframe.transpose()
        + b_by_keyframe * other_covariance * b_by_keyframe.transpose()
        - cross
        - cross.transpose();
    of_pixels + positive_part(&of_keyframes)
}

/// A symmetric matrix without its negative eigenvalues: single blocks of a joint covariance are rounded.
fn positive_part(matrix: &Matrix6<f64>) -> Matrix6<f64> {
    let mut eigen = matrix.symmetric_eigen();
    eigen.eigenvalues.apply(|value| *value = value.max(0.0));
    eigen.recompose()
}

/// Whether two estimates of one camera pose whose errors are independent are consistent: chi-square test of their difference.
pub(crate) fn is_consistent(
    a: &PoseWithCovariance,
    b: &PoseWithCovariance,
    options: &RecognitionOptions,
) -> bool {
    is_within(&a.pose, &b.pose, &(a.covariance + b.covariance), options)
}

/// Whether two poses differ by no more than a covariance of their difference and the tolerances allow.
fn is_within(a: &Pose, b: &Pose, covariance: &Matrix6<f64>, options: &RecognitionOptions) -> bool {
    let (theta, p) = (options.tolerance_theta.powi(2), options.tolerance_p.powi(2));
    let tolerance = Matrix6::from_diagonal(&Vector6::new(theta, theta, theta, p, p, p));
    let difference = a.local(b);
    let squared =
        (covariance + tolerance).cholesky().map(|factor| difference.dot(&factor.solve(&difference)));
    squared.is_some_and(|squared| squared <= CHI_SQUARE_6_999)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_keyframe_that_agrees_with_two_places_does_not_make_them_one() {
        // 0 and 1 contradict each other; 2, which hardly constrains the pose, contradicts neither.
        let agree = |a: usize, b: usize| a.min(b) != 0 || a.max(b) != 1;
        assert_eq!(members_of(0, &[0, 1, 2], agree), [0, 2]);
        assert_eq!(members_of(1, &[0, 1, 2], agree), [1, 2]);
        assert_eq!(members_of(2, &[0, 1, 2], agree), [0, 2]);
        assert_eq!(members_of(2, &[1, 2], agree), [1, 2]);
    }

    #[test]
    fn the_positive_part_of_a_covariance_is_itself() {
        let root = Matrix6::from_fn(|row, column| ((3 * row + 5 * column) % 7) as f64 - 2.0);
        let covariance = root * root.transpose();
        assert!((positive_part(&covariance) - covariance).norm() < 1e-9 * covariance.norm());
        let diagonal = Matrix6::from_diagonal(&Vector6::new(1.0, -2.0, 3.0, 0.0, -1e-9, 4.0));
        let expected = Matrix6::from_diagonal(&Vector6::new(1.0, 0.0, 3.0, 0.0, 0.0, 4.0));
        assert!((positive_part(&diagonal) - expected).norm() < 1e-12);
    }
}
