//! Odometry of stereo images that are too far apart to track points: each pair of images is located by the landmarks of
//! earlier ones, and the IMU gives gravity, velocities and biases to the trajectory.

use adjustment::ViewPose;
use estimator::EstimatorConfig;
use geometry::pnp::{Correspondence, PnpSolution, RansacOptions, solve_ransac};
use geometry::pose::Pose;
use geometry::uncertain_pose::PoseWithCovariance;
use nalgebra::Vector3;
use sensors::Sequence;
use vision::{MatchOptions, match_descriptors};

use super::camera::Rig;
use super::correlations::Correlations;
use super::error::BuildError;
use super::feature_source::{Extraction, FeatureSource, ImageWithFeatures};
use super::imu_alignment::ImuAlignment;
use super::keyframe_selection::rays;
use super::keyframe_view::{KeyframeImage, KeyframeView};
use super::odometry::Odometry;
use super::options::FIRST_SIGMA_PX;
use super::progress::{Progress, Stage};
use super::triangulation::{Scene, triangulate};

/// A pair of images is compared with this many before it first; with all others only where these are not enough.
const RECENT: usize = 4;
/// Fewest matches that agree with a pose: recognition needs as many to trust a keyframe without a second one.
const MIN_INLIERS: usize = 20;
/// With so many the search ends.
const ENOUGH_INLIERS: usize = 120;

/// A pair of images whose pose is known.
struct Located<'a> {
    view: KeyframeView<'a>,
    /// Its landmarks in its own camera frame, by feature.
    points: Vec<Option<Vector3<f64>>>,
    /// In the frame of the first pair of images.
    first_from_camera: Pose,
}

/// Odometry of stereo images at any rate, by their features and the IMU.
///
/// # Arguments
/// * `sequence`: with two cameras, their images and readings of the IMU.
/// * `extraction`: how features are extracted.
/// * `config`: noise of the IMU and magnitude of gravity.
///
/// # Errors
/// [`BuildError`]: fewer than three pairs of images show one place, or images and IMU contradict each other.
pub fn register_stereo_images(
    sequence: &Sequence,
    extraction: Extraction<'_>,
    config: &EstimatorConfig,
    progress: Progress<'_>,
) -> Result<Odometry, BuildError> {
    let rig = Rig::new(&sequence.cameras, extraction.cameras);
    let mut source = FeatureSource::new(Some(extraction), &rig);
    let mut located: Vec<Located<'_>> = Vec::new();
    for (done, frame) in sequence.frames.iter().enumerate() {
        progress(Stage::Odometry, done, sequence.frames.len());
        source.forget_before(frame.stamp_ns);
        let Some(features) = source.stereo_features_of(frame, 0)? else { continue };
        let (view, points) = landmarks(&rig, frame.stamp_ns, features);
        let pose = if located.is_empty() { Some(Pose::identity()) } else { locate(&rig, &located, &view)? };
        if let Some(first_from_camera) = pose {
            located.push(Located { view, points, first_from_camera });
        }
    }
    let poses: Vec<(i64, Pose)> =
        located.iter().map(|pair| (pair.view.stamp_ns, pair.first_from_camera)).collect();
    let states = ImuAlignment::new(sequence, &poses, Some(1.0), config)?.upright_states();
    Ok(Odometry {
        states,
        cameras: rig.cameras.len(),
        imu_noise_scale: 1.0,
        config: config.clone(),
        keyframes: None,
    })
}

/// The landmarks that one pair of images shows.
fn landmarks<'a>(
    rig: &Rig,
    stamp_ns: i64,
    ImageWithFeatures { features, stereo }: ImageWithFeatures<'a>,
) -> (KeyframeView<'a>, Vec<Option<Vector3<f64>>>) {
    let rays = rays(rig.camera(0), &features);
    let prior = PoseWithCovariance::exact(Pose::identity());
    let images = vec![KeyframeImage { group: 0, features }];
    let view = [KeyframeView { stamp_ns, images, tracked: Vec::new(), stereo, rays, prior }];
    let poses = [ViewPose::from(&Pose::identity())];
    let correlations = &Correlations::Independent;
    let scene = Scene { rig, views: &view, poses: &poses, correlations, sigma_px: FIRST_SIGMA_PX };
    let point = |feature: usize| {
        view[0].stereo_pixel(feature)?;
        let (landmark, _) = triangulate(&scene, &[(0, feature)], 2);
        landmark.map(|landmark| landmark.ray.push(1.0) / landmark.inverse_depth)
    };
    let points = (0..view[0].described()).map(point).collect();
    let [view] = view;
    (view, points)
}

/// The pose of a pair of images by the landmarks of another one; `None` where no other shows the same place.
fn locate(rig: &Rig, located: &[Located<'_>], view: &KeyframeView<'_>) -> Result<Option<Pose>, BuildError> {
    let mut best: Option<(usize, Pose)> = None;
    for (rank, other) in located.iter().rev().enumerate() {
        let inliers = best.as_ref().map_or(0, |(inliers, _)| *inliers);
        if inliers >= ENOUGH_INLIERS || (rank >= RECENT && inliers >= MIN_INLIERS) {
            break;
        }
        let Some(solution) = solve(rig, other, view)? else { continue };
        if solution.inliers.len() > inliers {
            let pose = other.first_from_camera.compose(&solution.world_from_camera.pose);
            best = Some((solution.inliers.len(), pose));
        }
    }
    Ok(best.map(|(_, pose)| pose))
}

fn solve(rig: &Rig, other: &Located<'_>, view: &KeyframeView<'_>) -> Result<Option<PnpSolution>, BuildError> {
    let (known, seen) = (other.view.images[0].descriptors()?, view.images[0].descriptors()?);
    let matches = match_descriptors(seen, known, &MatchOptions::for_metric(known.metric()))?;
    let correspondence = |found: &vision::Match| {
        let point = other.points[found.train]?;
        Some(Correspondence { point, pixel: view.pixel(found.query) })
    };
    let correspondences: Vec<Correspondence> = matches.iter().filter_map(correspondence).collect();
    let options = RansacOptions { min_inliers: MIN_INLIERS, ..RansacOptions::default() };
    Ok(solve_ransac(rig.camera(0), &correspondences, &options, FIRST_SIGMA_PX).ok())
}
