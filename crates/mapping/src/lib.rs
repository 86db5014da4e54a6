//! Building a map offline from a reference sequence: images or their features, and poses that are known imperfectly.
//!
//! | step | module |
//! |---|---|
//! | images become keyframes as the view changes | `views`, `references` |
//! | features are read, or extracted, and found again by the stereo partner | `images`, `stereo` |
//! | neighbouring keyframes are matched, and checked by the epipolar constraint | `matching` |
//! | matches are chained into tracks | `tracks` |
//! | each track is located with the given poses, whose uncertainty weighs in | `locate` |
//! | all landmarks are refined together with the poses, within what these are known to | `adjustment` |
//! | the joint covariance of the refined poses | `joint_covariance` |
//! | a map is made of it | `assemble` |
//!
//! The map states the refined poses, each with its covariance and its cross-covariances with other keyframes, so that a
//! robot knows that neighbouring keyframes err alike. With [`StoredPoses::Given`] it states the given ones instead,
//! whose errors are independent. Landmarks come from the refinement either way, told in their anchors' camera frames;
//! the estimator uses them as linearization points only, beside the raw pixels.
#![cfg_attr(test, allow(clippy::unwrap_used))]

mod adjustment;
mod assemble;
mod images;
mod joint_covariance;
mod locate;
mod matching;
mod normal_equations;
mod options;
mod point;
mod references;
mod report;
mod stereo;
#[cfg(test)]
mod tests;
mod tracks;
mod views;

use std::collections::HashSet;
use std::time::Instant;

use geometry::uncertain_pose::PoseWithCovariance;
use map::contents::MapContents;
use sensors::{ReferencePose, Sequence};

pub use images::Extraction;
pub use options::{BuildError, BuildOptions, Progress, Stage, StoredPoses};
pub use report::{BuildReport, Spread};

use adjustment::{Bundle, Problem};
use images::FeatureSource;
use joint_covariance::{JointCovariance, joint_covariance};
use locate::{Scene, locate};
use matching::FeatureMatch;
use point::{CameraPose, Lens, Point};
use tracks::Feature;
use views::View;

/// A sighting is dropped when it is further than this from its landmark after refinement (sigmas of a pixel).
const REPROJECTION_GATE: f64 = 4.0;
/// The refinement is repeated so often after outliers were dropped.
const REFINEMENTS: usize = 3;
/// Pixel noise (px) that is assumed until it is measured.
const FIRST_PIXEL_SIGMA: f64 = 1.0;
/// Limits of the measured pixel noise (px). The images of a map agree better with each other than with a robot's: with
/// the 0.36 px that are left on V1_01, a filter flown through that map gates four of ten right matches; more than 5 px is
/// no feature.
const PIXEL_SIGMAS: [f64; 2] = [1.0, 5.0];

/// Landmarks that pixel noise can be measured with.
const ENOUGH_LANDMARKS: usize = 50;

/// Builds a map.
///
/// # Arguments
/// * `sequence`: its camera 0, with stereo also camera 1, and the features or images of its frames are used.
/// * `references`: poses of the IMU in G with sigmas; those of images between two of them are interpolated.
/// * `extraction`: how features are extracted from images; `None` takes those that the recording has.
/// * `progress`: told how far it is.
///
/// # Errors
/// [`BuildError`], with what to do.
pub fn build_map(
    sequence: &Sequence,
    references: &[ReferencePose],
    extraction: Option<Extraction<'_>>,
    options: &BuildOptions,
    progress: Progress<'_>,
) -> Result<(MapContents, BuildReport), BuildError> {
    check(options)?;
    let start = Instant::now();
    let rig = Lens::of_rig(&sequence.cameras);
    let mut source = FeatureSource::new(extraction, &rig);
    let views = views::select_views(sequence, references, &mut source, options, progress)?;
    let mut report = BuildReport {
        keyframes: views.len(),
        stereo_features: views.iter().map(View::stereo_count).sum(),
        unreadable_images: source.unreadable,
        ..BuildReport::default()
    };
    let matches = match_all(&rig, &views, options, &mut report, progress)?;
    let points = locate_all(&rig, &views, matches, options, &mut report, progress);
    let (bundle, joint) = refine_all(&rig, &views, points, options, &mut report, progress)?;
    let contents = assemble::map_contents(&rig[0].camera, &views, &bundle, joint, report.sigma_px, options)?;
    assemble::fill_report(&mut report, &rig, &views, &bundle, &contents);
    report.seconds = start.elapsed().as_secs_f64();
    Ok((contents, report))
}

fn check(options: &BuildOptions) -> Result<(), BuildError> {
    let sigmas = [options.sigma_theta_rad, options.sigma_p_m].into_iter().flatten();
    if !sigmas.into_iter().all(|sigma| sigma.is_finite() && sigma >= 0.0) {
        return Err(BuildError::Options("the sigmas of the poses must be zero or positive".to_owned()));
    }
    if !options.sigma_px.is_none_or(|sigma| sigma.is_finite() && sigma > 0.0) {
        return Err(BuildError::Options("the sigma of a pixel must be positive".to_owned()));
    }
    if options.min_observations < 2 {
        return Err(BuildError::Options("a landmark needs at least two observations".to_owned()));
    }
    Ok(())
}

fn match_all(
    rig: &[Lens],
    views: &[View<'_>],
    options: &BuildOptions,
    report: &mut BuildReport,
    progress: Progress<'_>,
) -> Result<Vec<FeatureMatch>, BuildError> {
    let sigma_px = options.sigma_px.unwrap_or(FIRST_PIXEL_SIGMA);
    let pairs = matching::pairs(views, options);
    report.pairs = pairs.len();
    let mut matches = Vec::new();
    for (done, &pair) in pairs.iter().enumerate() {
        progress(Stage::Matching, done, pairs.len());
        matches.extend(matching::match_pair(&rig[0].camera, views, pair, sigma_px, options)?);
    }
    progress(Stage::Matching, pairs.len(), pairs.len());
    report.matches = matches.len();
    Ok(matches)
}

/// Chains matches into tracks and locates each. What does not fit a track may be a landmark of its own, so it gets a
/// second chance.
fn locate_all(
    rig: &[Lens],
    views: &[View<'_>],
    matches: Vec<FeatureMatch>,
    options: &BuildOptions,
    report: &mut BuildReport,
    progress: Progress<'_>,
) -> Vec<Point> {
    let counts: Vec<usize> = views.iter().map(|view| view.rays.len()).collect();
    let poses: Vec<CameraPose> = views.iter().map(|view| CameraPose::from(&view.prior.pose)).collect();
    let scene = Scene { rig, views, poses: &poses, sigma_px: options.sigma_px.unwrap_or(FIRST_PIXEL_SIGMA) };
    let mut tracks = tracks::chain(&counts, matches.clone());
    tracks.extend(tracks::stereo_singles(views, &tracks));
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
    let kept: usize = points.iter().map(Point::view_count).sum();
    report.dropped_observations = tracks.iter().map(Vec::len).sum::<usize>().saturating_sub(kept);
    points
}

/// Refines poses and landmarks, measures the pixel noise, and works out what is then known of the poses.
fn refine_all(
    rig: &[Lens],
    views: &[View<'_>],
    points: Vec<Point>,
    options: &BuildOptions,
    report: &mut BuildReport,
    progress: Progress<'_>,
) -> Result<(Bundle, Option<JointCovariance>), BuildError> {
    let priors: Vec<PoseWithCovariance> = views.iter().map(|view| view.prior).collect();
    let mut bundle = Bundle { poses: priors.iter().map(|prior| prior.pose).collect(), points };
    let mut sigma_px = options.sigma_px.unwrap_or(FIRST_PIXEL_SIGMA);
    let rounds = if options.refine_poses { REFINEMENTS } else { 0 };
    for round in 0..rounds {
        let problem = Problem::new(rig, &priors, sigma_px);
        bundle = problem.refine(bundle, round == 0, |done, steps| {
            progress(Stage::Refining, round * steps + done, rounds * steps);
        });
        if options.sigma_px.is_none() {
            sigma_px = measured_sigma_px(&bundle, rig).unwrap_or(sigma_px);
        }
        let before: usize = bundle.points.iter().map(Point::view_count).sum();
        let poses = bundle.camera_poses();
        let gate = REPROJECTION_GATE * sigma_px;
        let pruned = |point: &Point| prune(point, rig, &poses, gate, options.min_observations);
        bundle.points = bundle.points.iter().filter_map(pruned).collect();
        let after: usize = bundle.points.iter().map(Point::view_count).sum();
        report.dropped_observations += before - after;
    }
    report.sigma_px = sigma_px;
    if !options.refine_poses || options.stored_poses == StoredPoses::Given {
        return Ok((bundle, None));
    }
    let equations = Problem::new(rig, &priors, sigma_px).reduced_equations(&bundle);
    let positions: Vec<_> = bundle.poses.iter().map(|pose| pose.translation).collect();
    let joint = joint_covariance(&equations, &positions, |done, all| progress(Stage::Weighing, done, all));
    Ok((bundle, Some(joint.ok_or(BuildError::Indefinite)?)))
}

/// The pixel noise that the residuals of a refined bundle show (px): that of the median landmark, so that outliers do not
/// count. The squared residuals of a landmark with `n` sightings, over the noise's variance, are chi-square distributed
/// with `2n - 3` degrees of freedom, whose median Wilson and Hilferty approximate. `None` without landmarks.
fn measured_sigma_px(bundle: &Bundle, rig: &[Lens]) -> Option<f64> {
    let poses = bundle.camera_poses();
    let variance = |point: &Point| {
        let freedom = (2 * point.sightings.len() - 3) as f64;
        let median = freedom * (1.0 - 2.0 / (9.0 * freedom)).powi(3);
        point.errors(rig, &poses).iter().map(|error| error * error).sum::<f64>() / median
    };
    let variances = |least_views: usize| -> Vec<f64> {
        let seen = bundle.points.iter().filter(|point| point.view_count() >= least_views);
        seen.map(variance).filter(|value| value.is_finite()).collect()
    };
    // A stereo pair at one instant agrees better than views from different places, as a robot's will be.
    let mut variances =
        Some(variances(2)).filter(|all| all.len() >= ENOUGH_LANDMARKS).unwrap_or_else(|| variances(1));
    if variances.is_empty() {
        return None;
    }
    let middle = variances.len() / 2;
    let (_, median, _) = variances.select_nth_unstable_by(middle, f64::total_cmp);
    Some(median.sqrt().clamp(PIXEL_SIGMAS[0], PIXEL_SIGMAS[1]))
}

/// Drops sightings beyond `gate` (px), and moves the anchor where it is one of them.
fn prune(point: &Point, rig: &[Lens], poses: &[CameraPose], gate: f64, least: usize) -> Option<Point> {
    let errors = point.errors(rig, poses);
    let keep: Vec<bool> = errors.iter().map(|&error| error <= gate).collect();
    if keep[point.anchor] {
        return point.retained(&keep, least);
    }
    let middle = keep.len() / 2;
    let can_anchor = |&index: &usize| keep[index] && point.sightings[index].lens == 0;
    let anchor = (0..keep.len()).filter(can_anchor).min_by_key(|index| index.abs_diff(middle))?;
    point.anchored_at(anchor, poses)?.retained(&keep, least)
}
