//! Descriptor matching with one keyframe, and the pose that proves it.

use std::collections::HashSet;

use geometry::pnp::{Correspondence, Gravity, PnpError, PnpSolution, RansacOptions, solve_ransac};
use geometry::{Camera, PoseWithCovariance};
use nalgebra::{Vector2, Vector3};
use protocol::FeatureSet;
use vision::{DescriptorError, DescriptorView, Match, MatchOptions, match_descriptors};

use super::loaded_map::LoadedMap;
use super::options::RecognitionOptions;

/// Ratio of the mean length of a two-dimensional normal error to its standard deviation.
const MEAN_OF_RAYLEIGH: f64 = 1.2533;

/// An image to be recognized.
pub(crate) struct Image<'a> {
    pub(crate) camera: &'a Camera,
    pub(crate) features: &'a FeatureSet,
    pub(crate) descriptors: DescriptorView<'a>,
    /// Unit vector downwards.
    pub(crate) gravity_in_camera: Option<Vector3<f64>>,
}

/// A keyframe whose landmarks explain part of an image by one camera pose.
pub(crate) struct Verified {
    /// Index into [`LoadedMap::keyframes`].
    pub(crate) keyframe: usize,
    /// Matches that agree with the pose; `train` counts [`super::loaded_map::LoadedKeyframe::seen`].
    pub(crate) inliers: Vec<Match>,
    /// Number of matches before verification.
    pub(crate) matches: usize,
    /// The camera in G, as uncertain as keyframe and pixels leave it.
    pub(crate) global_from_camera: PoseWithCovariance,
    /// Mean reprojection error of the inliers (px).
    pub(crate) mean_error_px: f64,
}

/// What came of comparing an image with a keyframe.
pub(crate) enum Comparison {
    /// Fewer matches than a verification needs.
    Unlike,
    /// Enough matches, but no pose that explains enough of them.
    NotVerified,
    /// A pose explains enough of the matches, but many other poses would as well.
    Uncertain(Box<Verified>),
    Verified(Box<Verified>),
}

/// Matches an image with the landmarks that a keyframe sees and verifies the matches by the camera's pose.
///
/// The pose is solved in the keyframe's frame, where the landmarks do not carry the error of the keyframe's pose.
/// Where gravity is known on both sides, it halves the sample; the keyframe's rotation is uncertain, so a pose from
/// pixels alone is tried if that fails.
pub(crate) fn compare(
    map: &LoadedMap,
    keyframe: usize,
    image: &Image<'_>,
    options: &RecognitionOptions,
) -> Result<Comparison, DescriptorError> {
    let match_options = MatchOptions::for_metric(map.metric());
    let matches = match_descriptors(image.descriptors, map.descriptors_of(keyframe)?, &match_options)?;
    if matches.len() < options.min_inliers {
        return Ok(Comparison::Unlike);
    }
    let loaded = &map.keyframes[keyframe];
    let correspondence = |found: &Match| Correspondence {
        point: loaded.seen[found.train].point,
        pixel: Vector2::from(image.features.pixels[found.query].map(f64::from)),
    };
    let correspondences: Vec<Correspondence> = matches.iter().map(correspondence).collect();
    let global_from_keyframe = &loaded.keyframe.global_from_keyframe;
    let gravity =
        map.info.gravity_in_global.zip(image.gravity_in_camera).map(|(in_global, in_camera)| Gravity {
            in_world: global_from_keyframe.pose.rotation.inverse_transform_vector(&in_global),
            in_camera,
        });
    let sigma = options.query_pixel_sigma.hypot(map.info.pixel_sigma);
    let Some(solution) = solve(image.camera, &correspondences, gravity, sigma, options) else {
        return Ok(Comparison::NotVerified);
    };

    // Landmarks are not exact: where the fit is worse than the pixel noise, the pose is that much less certain.
    let excess = (solution.mean_error_px / (MEAN_OF_RAYLEIGH * sigma)).max(1.0);
    let covariance = solution.world_from_camera.covariance * excess.powi(2);
    let keyframe_from_camera = PoseWithCovariance::new(solution.world_from_camera.pose, covariance);
    let inlier_points = solution.inliers.iter().map(|&inlier| &correspondences[inlier].point);
    let well_known = is_well_known(&keyframe_from_camera, inlier_points, options);
    let verdict = if well_known { Comparison::Verified } else { Comparison::Uncertain };
    Ok(verdict(Box::new(Verified {
        keyframe,
        inliers: solution.inliers.iter().map(|&inlier| matches[inlier]).collect(),
        matches: matches.len(),
        global_from_camera: global_from_keyframe.compose(&keyframe_from_camera),
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

/// Whether the inliers fix the pose: a few pixels in a corner are explained by many poses.
fn is_well_known<'a>(
    keyframe_from_camera: &PoseWithCovariance,
    points: impl Iterator<Item = &'a Vector3<f64>>,
    options: &RecognitionOptions,
) -> bool {
    let sigmas = keyframe_from_camera.covariance.diagonal().map(f64::sqrt);
    let (mut sum, mut count) = (0.0, 0.0);
    for point in points {
        sum += (point - keyframe_from_camera.pose.translation).norm();
        count += 1.0;
    }
    // A NaN fails both comparisons.
    sigmas.fixed_rows::<3>(0).norm() <= options.max_sigma_theta
        && sigmas.fixed_rows::<3>(3).norm() <= options.max_relative_sigma_p * sum / count
}

/// The distinct query features among the inliers of several keyframes.
pub(crate) fn distinct_features<'a>(verified: impl Iterator<Item = &'a Verified>) -> usize {
    let features = verified.flat_map(|verified| &verified.inliers).map(|inlier| inlier.query);
    features.collect::<HashSet<_>>().len()
}
