//! One place or none: verified keyframes must agree on the camera pose.
//!
//! Keyframes of two halls that look alike are both verified. The places are distinguished by the camera pose in G that
//! each keyframe implies: keyframes that agree form a place, the place that explains most query features is selected, and
//! where another explains nearly as many the query is ambiguous. Two keyframes of a map may err together by metres: whether
//! they agree is a matter of the covariance of their difference.

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
/// * `prior`: see [`has_rival`].
pub(crate) fn find_consensus(
    mut verified: Vec<VerifiedKeyframe>,
    places: &[Vec<usize>],
    hypotheses: &[Hypothesis],
    prior: Option<&PoseWithCovariance>,
    options: &RecognitionOptions,
) -> Consensus {
    let Some(winner) = places.first() else { return Consensus::Nothing };
    if has_rival(&verified, places, hypotheses, prior, options) {
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
///
/// # Arguments
/// * `prior`: where it is narrow enough to tell places apart; one that contradicts it is no rival of one that does not.
pub(crate) fn has_rival(
    verified: &[VerifiedKeyframe],
    places: &[Vec<usize>],
    hypotheses: &[Hypothesis],
    prior: Option<&PoseWithCovariance>,
    options: &RecognitionOptions,
) -> bool {
    let Some(winner) = places.first() else { return false };
    let least = options.ambiguity_ratio * support(verified, winner) as f64;
    let is_near = |place: &[usize], prior: &PoseWithCovariance| {
        place.iter().any(|&at| is_consistent(&verified[at].global_from_camera, prior, options))
    };
    let near = prior.filter(|prior| is_near(winner, prior));
    places.iter().enumerate().skip(1).any(|(number, rival)| {
        let is_less_likely = hypotheses
            .get(number)
            .is_some_and(|rival| hypotheses[0].log_odds() - rival.log_odds() >= options.min_fix_log_odds);
        let is_excluded = || near.is_some_and(|prior| !is_near(rival, prior));
        !is_less_likely && support(verified, rival) as f64 >= least && !is_excluded()
    })
}

/// Sorts verified keyframes, most inliers first, and groups those that agree on a place: the place that explains most query
/// features first, each with its own keyframes of most inliers first. A place is told by that keyframe which constrains the pose best
/// among those that all agree, and has all that agree with this one; those that it shares with a former place come last.
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
        let members = best.map(|(_, members)| members).unwrap_or_default();
        let Some(anchor) = members
            .iter()
            .copied()
            .min_by(|&a, &b| position_variance(&verified[a]).total_cmp(&position_variance(&verified[b])))
        else {
            break;
        };
        let agrees = |at: &usize| *at == anchor || agreeing[at * count + anchor];
        let mut place: Vec<usize> = rest.iter().copied().filter(agrees).collect();
        let explained_before = (0..count).filter(|at| !rest.contains(at));
        // What says nothing of the difference between places explains as much of each.
        let shared: Vec<usize> = explained_before.filter(agrees).collect();
        rest.retain(|at| !agrees(at));
        place.extend(shared);
        places.push(place);
    }
    places
}

/// Sum of the variances of the camera's position in the keyframe's frame, square metres.
fn position_variance(found: &VerifiedKeyframe) -> f64 {
    found.keyframe_from_camera.covariance.fixed_view::<3, 3>(3, 3).trace()
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
    of_pixels + map.covariance_of_sum((own, &a_by_keyframe), (other, &-b_by_keyframe))
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
    use geometry::rotation;
    use map::CommonError;
    use nalgebra::{Matrix6xX, Vector3};
    use testing::{Place, PlaceOptions};
    use vision::Match;

    use super::*;

    /// A map whose keyframes err by 5 m along x, together or each by itself.
    fn map(together: bool) -> LoadedMap {
        let options = PlaceOptions { keyframes: 3, landmarks: 50, ..PlaceOptions::default() };
        let mut contents = Place::new(&options).map;
        let mut factor = Matrix6xX::zeros(1);
        factor[3] = 5.0;
        let error = &factor * factor.transpose() + Matrix6::identity() * 1e-6;
        let common = |keyframe| CommonError { keyframe, factor: factor.clone() };
        contents.cross_covariances.clear();
        contents.common_errors = contents.keyframes.iter().map(|keyframe| common(keyframe.id)).collect();
        contents.common_errors.retain(|_| together);
        for keyframe in &mut contents.keyframes {
            keyframe.global_from_keyframe.covariance = error;
        }
        LoadedMap::from_contents(contents).unwrap()
    }

    /// What a keyframe finds with some inliers: the camera at `x` (m) in G, by the pixels with a standard deviation of `sigma` (m).
    fn found(map: &LoadedMap, keyframe: usize, [x, sigma]: [f64; 2], inliers: usize) -> VerifiedKeyframe {
        let own = &map.poses.keyframes[keyframe].global_from_keyframe;
        let camera = Pose::new(rotation::exp(&Vector3::zeros()), Vector3::new(x, 0.0, 0.0));
        let covariance = Vector6::new(1e-6, 1e-6, 1e-6, sigma * sigma, sigma * sigma, sigma * sigma);
        let keyframe_from_camera =
            PoseWithCovariance::new(own.pose.inverse().compose(&camera), Matrix6::from_diagonal(&covariance));
        let features = 100 * keyframe..100 * keyframe + inliers;
        VerifiedKeyframe {
            keyframe,
            inliers: features.map(|query| Match { query, train: query, distance: 0.0 }).collect(),
            matches: Vec::new(),
            points: Vec::new(),
            global_from_camera: own.compose(&keyframe_from_camera),
            keyframe_from_camera,
            mean_error_px: 1.0,
        }
    }

    #[test]
    fn keyframes_that_err_together_by_metres_tell_places_apart_that_are_a_metre_apart() {
        let options = RecognitionOptions::default();
        for (together, apart_m, expected) in
            [(true, 0.3, true), (true, 1.0, false), (false, 1.0, true), (false, 50.0, false)]
        {
            let map = map(together);
            let [a, b] = [0, 1].map(|at| found(&map, at, [at as f64 * apart_m, 0.01], 20));
            assert_eq!(agree(&map, &a, &b, &options), expected, "{together} {apart_m}");
            assert_eq!(agree(&map, &b, &a, &options), expected, "{together} {apart_m}");
            assert!(agree(&map, &a, &a, &options));
        }
    }

    #[test]
    fn the_covariance_of_a_difference_is_that_of_the_errors_of_both() {
        let map = map(true);
        let [a, b] = [(0, 2.0), (1, 4.0)].map(|(at, x)| found(&map, at, [x, 0.01], 20));
        let of = |found: &VerifiedKeyframe| (found.keyframe, found.keyframe_from_camera);
        let stated = difference_covariance(&map, &of(&a), &of(&b));
        // A shared displacement cancels; what is left is the pixels' and the keyframes' own.
        assert!(stated[(3, 3)] < 0.1 && stated[(3, 3)] > 2e-4, "{stated}");
        // The numeric derivative by the error of one keyframe.
        let pose_of = |error: &Vector6<f64>| {
            let own = &map.poses.keyframes[0].global_from_keyframe.pose;
            own.retract(error).compose(&a.keyframe_from_camera.pose)
        };
        let (by_keyframe, _) = compose_jacobians(
            &map.poses.keyframes[0].global_from_keyframe.pose,
            &a.keyframe_from_camera.pose,
        );
        for axis in 0..6 {
            let step = Vector6::ith(axis, 1e-6);
            let numeric = pose_of(&-step).local(&pose_of(&step)) / 2e-6;
            assert!((numeric - by_keyframe.column(axis)).norm() < 1e-5, "{axis}");
        }
    }

    #[test]
    fn a_keyframe_that_hardly_constrains_the_pose_does_not_make_two_places_one() {
        let options = RecognitionOptions::default();
        let map = map(true);
        for (weak, [a, b]) in [(0, [1, 2]), (2, [0, 1]), (1, [0, 2])] {
            // The earlier a keyframe, the more inliers it has here.
            let inliers = |at: usize| 40 - at;
            let mut verified = vec![
                found(&map, weak, [1.5, 2.0], inliers(weak)),
                found(&map, a, [0.0, 0.01], inliers(a)),
                found(&map, b, [3.0, 0.01], inliers(b)),
            ];
            let places = group_places(&map, &mut verified, &options);
            assert_eq!(places.len(), 2, "{weak}: {places:?}");
            assert!(has_rival(&verified, &places, &[], None, &options), "{weak}");
        }
    }

    #[test]
    fn a_place_that_contradicts_the_prior_is_no_rival_of_one_that_does_not() {
        let options = RecognitionOptions::default();
        let mut contents = Place::new(&PlaceOptions { keyframes: 2, ..PlaceOptions::default() }).map;
        contents.cross_covariances.clear();
        contents.common_errors.clear();
        for keyframe in &mut contents.keyframes {
            keyframe.global_from_keyframe.covariance = Matrix6::identity() * 1e-6;
        }
        let map = LoadedMap::from_contents(contents).unwrap();
        let mut verified = vec![found(&map, 0, [0.0, 0.01], 40), found(&map, 1, [3.0, 0.01], 39)];
        let places = group_places(&map, &mut verified, &options);
        let prior_at = |x: f64| {
            let pose = Pose::new(rotation::exp(&Vector3::zeros()), Vector3::new(x, 0.0, 0.0));
            PoseWithCovariance::new(pose, Matrix6::identity() * 0.01)
        };
        let rivals = |prior: Option<&PoseWithCovariance>| has_rival(&verified, &places, &[], prior, &options);
        assert!(rivals(None));
        assert!(!rivals(Some(&prior_at(0.0))));
        // Nothing that explains less makes up for a first place that the prior does not support.
        assert!(rivals(Some(&prior_at(3.0))) && rivals(Some(&prior_at(1.5))));
    }
}
