//! Matching a query with one keyframe, and verifying the matches by the camera pose (PnP).

use geometry::pnp::{Correspondence, Gravity, PnpError, PnpSolution, RansacOptions, refine, solve_ransac};
use geometry::{Camera, Pose, PoseWithCovariance};
use nalgebra::{Vector2, Vector3};
use protocol::FeatureSet;
use vision::{DescriptorError, DescriptorView, Match, Matcher};

use super::loaded_map::LoadedMap;
use super::options::RecognitionOptions;

/// Ratio of the mean length of a two-dimensional normal error to its standard deviation.
const MEAN_OF_RAYLEIGH: f64 = 1.2533;

/// The first gate around an expected pose is this many times wider than that of inliers, for the errors of the keyframes'
/// poses.
const GUIDED_FACTOR: f64 = 3.0;
/// Rounds of refinement and reselection of the inliers from an expected pose, by how many of these each takes; two suffice on
/// recorded maps.
const GUIDED_POINTS: [usize; 2] = [100, usize::MAX];
/// Gauss-Newton iterations of each of these refinements.
const GUIDED_ITERATIONS: usize = 6;
/// Huber's threshold of these refinements, in standard deviations of a pixel; as in RANSAC.
const HUBER_SIGMAS: f64 = 2.5;

/// An image to be recognized.
pub(crate) struct Image<'a> {
    pub(crate) camera: &'a Camera,
    pub(crate) features: &'a FeatureSet,
    pub(crate) descriptors: DescriptorView<'a>,
    /// Unit vector downwards.
    pub(crate) gravity_in_camera: Option<Vector3<f64>>,
}

/// A keyframe whose landmarks explain part of an image by one camera pose.
pub(crate) struct VerifiedKeyframe {
    /// Index into [`LoadedMap::keyframes`].
    pub(crate) keyframe: usize,
    /// Matches that agree with the pose; `train` counts [`super::elements::Observations::of`].
    pub(crate) inliers: Vec<Match>,
    /// All matches before verification.
    pub(crate) matches: Vec<Match>,
    /// The landmark of each match in the keyframe's camera frame (m).
    pub(crate) points: Vec<Vector3<f64>>,
    /// The camera in the keyframe's frame, with the uncertainty of the pixels.
    pub(crate) keyframe_from_camera: PoseWithCovariance,
    /// The camera in G, with the uncertainty of the keyframe and of the pixels.
    pub(crate) global_from_camera: PoseWithCovariance,
    /// Mean reprojection error of the inliers (px).
    pub(crate) mean_error_px: f64,
}

impl VerifiedKeyframe {
    /// The landmarks of the inliers in the keyframe's camera frame (m).
    pub(crate) fn inlier_points(&self) -> impl Iterator<Item = &Vector3<f64>> {
        // Inliers are some of the matches, in the same order.
        let mut inliers = self.inliers.iter().peekable();
        let is_inlier = move |(found, _): &(&Match, &Vector3<f64>)| {
            inliers.next_if(|inlier| inlier.query == found.query).is_some()
        };
        self.matches.iter().zip(&self.points).filter(is_inlier).map(|(_, point)| point)
    }
}

/// The result of comparing an image with a keyframe.
pub(crate) enum Comparison {
    /// Fewer matches than a verification needs.
    TooFewMatches { matches: usize },
    /// Enough matches, but no pose that explains enough of them.
    NoPose { matches: usize },
    /// A pose explains enough of the matches, but many other poses would as well.
    PoseUncertain(Box<VerifiedKeyframe>),
    /// One pose explains enough of the matches and is well constrained.
    Verified(Box<VerifiedKeyframe>),
}

/// Matches an image with the landmarks that a keyframe sees and verifies the matches by the camera's pose.
///
/// The pose is solved in the keyframe's frame, where the landmarks do not carry the error of the keyframe's pose.
/// Where gravity is known in the query and in the map, RANSAC needs smaller samples; the keyframe's rotation is
/// uncertain, so a pose from pixels alone is tried if that fails.
///
/// # Arguments
/// * `matcher`: of the image's descriptors.
/// * `expected`: `global_from_camera` as estimated from another keyframe of the map. Where it explains most of the
///   matches, RANSAC is skipped; where it does not, it is ignored.
pub(crate) fn compare(
    map: &LoadedMap,
    keyframe: usize,
    image: &Image<'_>,
    matcher: &mut Matcher,
    expected: Option<&Pose>,
    options: &RecognitionOptions,
) -> Result<Comparison, DescriptorError> {
    let match_options = map.match_options();
    let matches = matcher.matches(map.descriptors_of(keyframe)?, &match_options)?;
    if matches.len() < options.min_inliers {
        return Ok(Comparison::TooFewMatches { matches: matches.len() });
    }
    let correspondence = |found: &Match| Correspondence {
        point: map.observed_point(keyframe, found.train),
        pixel: Vector2::from(image.features.pixels[found.query].map(f64::from)),
    };
    let correspondences: Vec<Correspondence> = matches.iter().map(correspondence).collect();
    let global_from_keyframe = &map.poses.keyframes[keyframe].global_from_keyframe;
    let gravity =
        map.info.gravity_in_global.zip(image.gravity_in_camera).map(|(in_global, in_camera)| Gravity {
            in_world: global_from_keyframe.pose.rotation.inverse_transform_vector(&in_global),
            in_camera,
        });
    let sigma = options.sigma_query_px.hypot(map.info.sigma_px);
    let expected = expected.map(|pose| global_from_keyframe.pose.inverse().compose(pose));
    let guided = expected.and_then(|pose| guided(image.camera, &correspondences, &pose, sigma, options));
    let solution = guided.or_else(|| solve(image.camera, &correspondences, gravity, sigma, options));
    let Some(solution) = solution else {
        return Ok(Comparison::NoPose { matches: matches.len() });
    };

    // Landmarks are not exact: where the fit is worse than the pixel noise, the pose is that much less certain.
    let excess = (solution.mean_error_px / (MEAN_OF_RAYLEIGH * sigma)).max(1.0);
    let covariance = solution.world_from_camera.covariance * excess.powi(2);
    let keyframe_from_camera = PoseWithCovariance::new(solution.world_from_camera.pose, covariance);
    let inlier_points = solution.inliers.iter().map(|&inlier| &correspondences[inlier].point);
    let well_constrained = is_well_constrained(&keyframe_from_camera, inlier_points, options);
    let comparison = if well_constrained { Comparison::Verified } else { Comparison::PoseUncertain };
    Ok(comparison(Box::new(VerifiedKeyframe {
        keyframe,
        inliers: solution.inliers.iter().map(|&inlier| matches[inlier]).collect(),
        matches,
        points: correspondences.iter().map(|correspondence| correspondence.point).collect(),
        global_from_camera: global_from_keyframe.compose(&keyframe_from_camera),
        keyframe_from_camera,
        mean_error_px: solution.mean_error_px,
    })))
}

fn solve(
    camera: &Camera,
    correspondences: &[Correspondence],
    gravity: Option<Gravity>,
    sigma: f64,
    options: &RecognitionOptions,
) -> Option<PnpSolution> {
    let focal = f64::midpoint(camera.focal[0], camera.focal[1]);
    let attempt = |gravity: Option<Gravity>| -> Result<PnpSolution, PnpError> {
        let ransac = RansacOptions {
            threshold_px: options.inlier_angle * focal,
            confidence: options.confidence,
            max_iterations: options.max_iterations,
            min_inliers: options.min_inliers,
            seed: options.seed,
            gravity,
        };
        solve_ransac(camera, correspondences, &ransac, sigma)
    };
    gravity.and_then(|gravity| attempt(Some(gravity)).ok()).or_else(|| attempt(None).ok())
}

/// The pose near an expected one, if most of the matches agree with it.
///
/// The first selection is wider by [`GUIDED_FACTOR`].
fn guided(
    camera: &Camera,
    correspondences: &[Correspondence],
    expected: &Pose,
    sigma: f64,
    options: &RecognitionOptions,
) -> Option<PnpSolution> {
    let threshold = options.inlier_angle * f64::midpoint(camera.focal[0], camera.focal[1]);
    let within = |pose: &Pose, gate: f64| -> Vec<usize> {
        let error = |at: &usize| correspondences[*at].reprojection_error(camera, pose);
        (0..correspondences.len()).filter(|at| error(at).is_some_and(|error| error <= gate)).collect()
    };
    let fewest = options.min_inliers.max(correspondences.len().div_ceil(2));
    let mut inliers = within(expected, GUIDED_FACTOR * threshold);
    let mut estimate = PoseWithCovariance::exact(*expected);
    for points in GUIDED_POINTS {
        if inliers.len() < fewest {
            return None;
        }
        let step = inliers.len().div_ceil(points);
        let chosen = inliers.iter().step_by(step).map(|&at| correspondences[at]);
        let chosen: Vec<Correspondence> = chosen.collect();
        estimate =
            refine(camera, &chosen, &estimate.pose, sigma, GUIDED_ITERATIONS, Some(HUBER_SIGMAS)).ok()?;
        inliers = within(&estimate.pose, threshold);
    }
    if inliers.len() < fewest {
        return None;
    }
    let errors =
        inliers.iter().filter_map(|&at| correspondences[at].reprojection_error(camera, &estimate.pose));
    let mean_error_px = errors.sum::<f64>() / inliers.len() as f64;
    Some(PnpSolution { world_from_camera: estimate, inliers, mean_error_px })
}

/// Whether the inliers constrain the pose: a few pixels in a corner are explained by many poses.
fn is_well_constrained<'a>(
    keyframe_from_camera: &PoseWithCovariance,
    points: impl Iterator<Item = &'a Vector3<f64>>,
    options: &RecognitionOptions,
) -> bool {
    let sigmas = keyframe_from_camera.covariance.diagonal().map(f64::sqrt);
    let distance = |point: &Vector3<f64>| (point - keyframe_from_camera.pose.translation).norm();
    // The mean would follow a few landmarks that are far away.
    let mut distances: Vec<f64> = points.map(distance).collect();
    let Some(median) = geometry::median(&mut distances) else { return false };
    // A NaN fails both comparisons.
    sigmas.fixed_rows::<3>(0).norm() <= options.max_sigma_theta
        && sigmas.fixed_rows::<3>(3).norm() <= options.max_relative_sigma_p * median
}

/// The number of distinct query features among the inliers of several keyframes.
pub(crate) fn distinct_features<'a>(verified: impl Iterator<Item = &'a VerifiedKeyframe>) -> usize {
    let mut seen: Vec<bool> = Vec::new();
    for inlier in verified.flat_map(|verified| &verified.inliers) {
        if seen.len() <= inlier.query {
            seen.resize(inlier.query + 1, false);
        }
        seen[inlier.query] = true;
    }
    seen.iter().filter(|&&seen| seen).count()
}
