//! Bundle adjustment in rounds, with outliers dropped in between, and the covariance of the result.

use geometry::uncertain_pose::PoseWithCovariance;

use super::bundle_adjustment::{Bundle, Problem};
use super::camera::{CameraPose, MappingCamera};
use super::error::BuildError;
use super::joint_covariance::{JointCovariance, joint_covariance};
use super::keyframe_view::KeyframeView;
use super::landmark::InverseDepthLandmark;
use super::options::{BuildOptions, FIRST_SIGMA_PX, StoredPoses};
use super::progress::{Progress, Stage};
use super::report::BuildReport;

/// An observation is dropped when its reprojection error after refinement exceeds this (standard deviations of a pixel).
const REPROJECTION_GATE: f64 = 4.0;
/// Rounds of bundle adjustment; outliers are dropped after each.
const ROUNDS: usize = 3;
/// Limits of the estimated pixel noise (px). The images of a map agree better with each other than with a robot's: with
/// the 0.36 px of V1_01, a filter run in that map rejects four of ten correct matches; more than 5 px is no feature.
const SIGMA_PX_LIMITS: [f64; 2] = [1.0, 5.0];

/// Number of landmarks from which pixel noise can be estimated: its median is then within 20 %.
const MIN_LANDMARKS: usize = 50;

/// Refines poses and landmarks, estimates the pixel noise, and computes the covariance of the poses.
pub(super) fn refine_all(
    cameras: &[MappingCamera],
    views: &[KeyframeView<'_>],
    landmarks: Vec<InverseDepthLandmark>,
    options: &BuildOptions,
    report: &mut BuildReport,
    progress: Progress<'_>,
) -> Result<(Bundle, Option<JointCovariance>), BuildError> {
    let priors: Vec<PoseWithCovariance> = views.iter().map(|view| view.prior).collect();
    let mut bundle = Bundle { poses: priors.iter().map(|prior| prior.pose).collect(), landmarks };
    let mut sigma_px = options.sigma_px.unwrap_or(FIRST_SIGMA_PX);
    let rounds = if options.refine_poses { ROUNDS } else { 0 };
    for round in 0..rounds {
        let problem = Problem::new(cameras, &priors, sigma_px);
        bundle = problem.refine(bundle, round == 0, |done, steps| {
            progress(Stage::BundleAdjustment, round * steps + done, rounds * steps);
        });
        if options.sigma_px.is_none() {
            sigma_px = estimated_sigma_px(&bundle, cameras).unwrap_or(sigma_px);
        }
        let before: usize = bundle.landmarks.iter().map(InverseDepthLandmark::view_count).sum();
        let poses = bundle.camera_poses();
        let gate = REPROJECTION_GATE * sigma_px;
        let pruned = |landmark: &InverseDepthLandmark| {
            prune(landmark, cameras, &poses, gate, options.min_observations)
        };
        bundle.landmarks = bundle.landmarks.iter().filter_map(pruned).collect();
        let after: usize = bundle.landmarks.iter().map(InverseDepthLandmark::view_count).sum();
        report.dropped_observations += before - after;
    }
    report.sigma_px = sigma_px;
    if !options.refine_poses || options.stored_poses == StoredPoses::Given {
        return Ok((bundle, None));
    }
    let equations = Problem::new(cameras, &priors, sigma_px).reduced_equations(&bundle);
    let positions: Vec<_> = bundle.poses.iter().map(|pose| pose.translation).collect();
    let joint = joint_covariance(&equations, &positions, |done, all| progress(Stage::Covariance, done, all));
    Ok((bundle, Some(joint.ok_or(BuildError::Indefinite)?)))
}

/// The pixel noise from the residuals of a refined bundle (px): that of the median landmark, which is robust to outliers. The squared residuals of a landmark with `n` observations, over the noise's variance, are chi-square distributed
/// with `2n - 3` degrees of freedom, whose median Wilson and Hilferty approximate. `None` without landmarks.
fn estimated_sigma_px(bundle: &Bundle, cameras: &[MappingCamera]) -> Option<f64> {
    let poses = bundle.camera_poses();
    let variance = |landmark: &InverseDepthLandmark| {
        let freedom = (2 * landmark.observations.len() - 3) as f64;
        let median = freedom * (1.0 - 2.0 / (9.0 * freedom)).powi(3);
        landmark.errors(cameras, &poses).iter().map(|error| error * error).sum::<f64>() / median
    };
    let variances = |least_views: usize| -> Vec<f64> {
        let observed = bundle.landmarks.iter().filter(|landmark| landmark.view_count() >= least_views);
        observed.map(variance).filter(|value| value.is_finite()).collect()
    };
    // A stereo pair at one instant agrees better than views from different places, as a robot's will be.
    let mut variances =
        Some(variances(2)).filter(|all| all.len() >= MIN_LANDMARKS).unwrap_or_else(|| variances(1));
    if variances.is_empty() {
        return None;
    }
    let middle = variances.len() / 2;
    let (_, median, _) = variances.select_nth_unstable_by(middle, f64::total_cmp);
    Some(median.sqrt().clamp(SIGMA_PX_LIMITS[0], SIGMA_PX_LIMITS[1]))
}

/// Drops observations beyond `gate` (px), and changes the anchor where it is one of them.
fn prune(
    landmark: &InverseDepthLandmark,
    cameras: &[MappingCamera],
    poses: &[CameraPose],
    gate: f64,
    least: usize,
) -> Option<InverseDepthLandmark> {
    let errors = landmark.errors(cameras, poses);
    let keep: Vec<bool> = errors.iter().map(|&error| error <= gate).collect();
    if keep[landmark.anchor] {
        return landmark.retained(&keep, least);
    }
    let middle = keep.len() / 2;
    let can_anchor = |&index: &usize| keep[index] && landmark.observations[index].camera == 0;
    let anchor = (0..keep.len()).filter(can_anchor).min_by_key(|index| index.abs_diff(middle))?;
    landmark.anchored_at(anchor, poses)?.retained(&keep, least)
}
