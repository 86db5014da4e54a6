//! Building a map offline from a reference sequence: features of images, and poses that are known imperfectly.
//!
//! | step | module |
//! |---|---|
//! | images become keyframes as the view changes | `views` |
//! | neighbouring keyframes are matched, and checked by the epipolar constraint | `matching` |
//! | matches are chained into tracks | `tracks` |
//! | each track is located with the given poses, whose uncertainty weighs in | `locate` |
//! | all landmarks are refined together with the poses | `adjustment` |
//! | a map is made of it | `assemble` |
//!
//! The map states the *given* poses with their covariances, never the refined ones: the errors of given poses are
//! independent, which the estimator relies on; those of refined ones are correlated with each other and with every
//! pixel. The landmarks come from the refinement, each told in its anchor's camera frame. The estimator uses them as
//! linearization points only, beside the raw pixels.

mod adjustment;
mod assemble;
mod locate;
mod matching;
mod normal_equations;
mod options;
mod point;
mod report;
#[cfg(test)]
mod tests;
mod tracks;
mod views;

use std::collections::HashSet;
use std::time::Instant;

use geometry::camera::Camera;
use geometry::uncertain_pose::PoseWithCovariance;
use map_server::contents::MapContents;
use onboard::sequence::{ReferencePose, Sequence};

pub use options::{BuildError, BuildOptions, Progress, Stage};
pub use report::{BuildReport, Spread};

use adjustment::{Bundle, Problem};
use locate::{Scene, locate};
use matching::FeatureMatch;
use point::{CameraPose, Point};
use tracks::Feature;
use views::View;

/// A sighting is dropped when it is further than this from its landmark after refinement (sigmas of a pixel).
const REPROJECTION_GATE: f64 = 4.0;
/// The refinement is repeated so often after outliers were dropped.
const REFINEMENTS: usize = 2;

/// Builds a map.
///
/// # Arguments
/// * `sequence`: its camera 0 and the features of its frames are used.
/// * `references`: poses of the IMU in G with sigmas; only those at the very stamp of a frame with features count.
/// * `progress`: told how far it is.
///
/// # Errors
/// [`BuildError`], with what to do.
pub fn build_map(
    sequence: &Sequence,
    references: &[ReferencePose],
    options: &BuildOptions,
    progress: Progress<'_>,
) -> Result<(MapContents, BuildReport), BuildError> {
    check(options)?;
    let start = Instant::now();
    let views = views::select_views(sequence, references, options)?;
    let camera = &sequence.cameras[0].camera;
    let mut report = BuildReport { keyframes: views.len(), ..BuildReport::default() };
    let matches = match_all(camera, &views, options, &mut report, progress)?;
    let points = locate_all(camera, &views, matches, options, &mut report, progress);
    let bundle = refine_all(camera, &views, points, options, &mut report, progress);
    let contents = assemble::map_contents(camera, &views, &bundle, options)?;
    assemble::fill_report(&mut report, camera, &views, &bundle, &contents);
    report.seconds = start.elapsed().as_secs_f64();
    Ok((contents, report))
}

fn check(options: &BuildOptions) -> Result<(), BuildError> {
    let sigmas = [options.sigma_theta, options.sigma_p].into_iter().flatten();
    if !sigmas.into_iter().all(|sigma| sigma.is_finite() && sigma >= 0.0) {
        return Err(BuildError::Options("the sigmas of the poses must be zero or positive".to_owned()));
    }
    if !(options.pixel_sigma.is_finite() && options.pixel_sigma > 0.0) {
        return Err(BuildError::Options("the sigma of a pixel must be positive".to_owned()));
    }
    if options.min_observations < 2 {
        return Err(BuildError::Options("a landmark needs at least two observations".to_owned()));
    }
    Ok(())
}

fn match_all(
    camera: &Camera,
    views: &[View<'_>],
    options: &BuildOptions,
    report: &mut BuildReport,
    progress: Progress<'_>,
) -> Result<Vec<FeatureMatch>, BuildError> {
    let pairs = matching::pairs(views, options);
    report.pairs = pairs.len();
    let mut matches = Vec::new();
    for (done, &pair) in pairs.iter().enumerate() {
        progress(Stage::Matching, done, pairs.len());
        matches.extend(matching::match_pair(camera, views, pair, options)?);
    }
    progress(Stage::Matching, pairs.len(), pairs.len());
    report.matches = matches.len();
    Ok(matches)
}

/// Chains matches into tracks and locates each. What does not fit a track may be a landmark of its own, so it gets a
/// second chance.
fn locate_all(
    camera: &Camera,
    views: &[View<'_>],
    matches: Vec<FeatureMatch>,
    options: &BuildOptions,
    report: &mut BuildReport,
    progress: Progress<'_>,
) -> Vec<Point> {
    let counts: Vec<usize> = views.iter().map(|view| view.rays.len()).collect();
    let poses: Vec<CameraPose> = views.iter().map(|view| CameraPose::from(&view.prior.pose)).collect();
    let scene = Scene { camera, views, poses: &poses, pixel_sigma: options.pixel_sigma };
    let tracks = tracks::chain(&counts, matches.clone());
    let mut points = Vec::new();
    let mut dropped: HashSet<Feature> = HashSet::new();
    for (done, track) in tracks.iter().enumerate() {
        progress(Stage::Locating, done, tracks.len());
        let (point, outliers) = locate(&scene, track, options.min_observations);
        points.extend(point);
        dropped.extend(outliers);
    }
    let among_dropped =
        |found: &FeatureMatch| dropped.contains(&found.first) && dropped.contains(&found.second);
    let leftovers = matches.into_iter().filter(among_dropped).collect();
    for track in tracks::chain(&counts, leftovers) {
        let (point, _) = locate(&scene, &track, options.min_observations);
        points.extend(point);
    }
    progress(Stage::Locating, tracks.len(), tracks.len());
    let kept: usize = points.iter().map(|point| point.sightings.len()).sum();
    report.dropped_observations = tracks.iter().map(Vec::len).sum::<usize>().saturating_sub(kept);
    points
}

fn refine_all(
    camera: &Camera,
    views: &[View<'_>],
    points: Vec<Point>,
    options: &BuildOptions,
    report: &mut BuildReport,
    progress: Progress<'_>,
) -> Bundle {
    let priors: Vec<PoseWithCovariance> = views.iter().map(|view| view.prior).collect();
    let mut bundle = Bundle { poses: priors.iter().map(|prior| prior.pose).collect(), points };
    if !options.refine_poses {
        return bundle;
    }
    let problem = Problem::new(camera, &priors, options.pixel_sigma);
    for round in 0..REFINEMENTS {
        bundle = problem.refine(bundle, round == 0, |done, steps| {
            progress(Stage::Refining, round * steps + done, REFINEMENTS * steps);
        });
        let before: usize = bundle.points.iter().map(|point| point.sightings.len()).sum();
        let poses = bundle.camera_poses();
        let gate = REPROJECTION_GATE * options.pixel_sigma;
        let pruned = |point: &Point| prune(point, camera, &poses, gate, options.min_observations);
        bundle.points = bundle.points.iter().filter_map(pruned).collect();
        let after: usize = bundle.points.iter().map(|point| point.sightings.len()).sum();
        report.dropped_observations += before - after;
    }
    bundle
}

/// Drops sightings beyond `gate` (px), and moves the anchor where it is one of them.
fn prune(point: &Point, camera: &Camera, poses: &[CameraPose], gate: f64, least: usize) -> Option<Point> {
    let errors = point.errors(camera, poses);
    let keep: Vec<bool> = errors.iter().map(|&error| error <= gate).collect();
    if keep[point.anchor] {
        return point.retained(&keep, least);
    }
    let middle = keep.len() / 2;
    let anchor = (0..keep.len()).filter(|&index| keep[index]).min_by_key(|index| index.abs_diff(middle))?;
    point.anchored_at(anchor, poses)?.retained(&keep, least)
}
