//! Geometric verification of an answer by PnP with RANSAC.
//!
//! The camera pose is solved in the frame of each keyframe separately, so that the pose errors of the map have no effect.

use crate::KeyframeId;
use crate::calibration::CalibratedCamera;
use crate::map_update::map_answer::MapAnswer;
use geometry::pnp::{Correspondence, Gravity, PnpSolution, RansacOptions, solve_ransac};
use geometry::{Camera, PoseWithCovariance};
use nalgebra::Vector3;

/// The verified matches of an answer.
#[derive(Clone, Debug)]
pub struct VerifiedAnswer {
    /// The keyframe with the most inliers.
    pub best: KeyframeId,
    /// Camera pose in that keyframe, with its covariance for exact landmarks and a pixel noise of 1 px.
    pub best_from_camera: PoseWithCovariance,
    /// Mean reprojection error of its inliers, px.
    pub mean_error_px: f64,
    /// Indices of the inliers of all keyframes into the answer's landmarks, ascending.
    pub inliers: Vec<usize>,
}

/// Why the geometric verification of an answer failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum NotVerified {
    /// Too few matches.
    #[error("{have} matches with one keyframe, {need} are needed")]
    TooFewMatches {
        /// Largest number of matches with one keyframe.
        have: usize,
        /// The configured minimum.
        need: usize,
    },
    /// No camera pose has enough inliers.
    #[error("no camera pose has {need} inliers among the {have} matches")]
    NoPose {
        /// Largest number of matches with one keyframe.
        have: usize,
        /// The configured minimum.
        need: usize,
    },
}

/// Settings of the verification.
#[derive(Clone, Copy, Debug)]
pub struct VerificationSettings {
    /// Inlier threshold: reprojection error as an angle, rad.
    pub angle: f64,
    /// Minimum number of inliers of the best keyframe.
    pub min_inliers: usize,
    /// Unit vector along gravity in the frame of the current camera, where known.
    pub gravity_in_camera: Option<Vector3<f64>>,
}

/// Verifies the matches with every keyframe of an answer.
///
/// # Errors
/// [`NotVerified`] when no keyframe has enough inliers.
pub fn verify(
    answer: &MapAnswer,
    calibrated: &CalibratedCamera,
    settings: &VerificationSettings,
) -> Result<VerifiedAnswer, NotVerified> {
    let mut best: Option<(KeyframeId, PnpSolution)> = None;
    let mut inliers = Vec::new();
    let mut most = 0;
    for keyframe in &answer.keyframes {
        let members: Vec<usize> =
            (0..answer.landmarks.len()).filter(|&k| answer.landmarks[k].anchor == keyframe.id).collect();
        most = most.max(members.len());
        // Further keyframes need fewer matches than the best one.
        let need =
            if best.is_some() { settings.min_inliers.div_ceil(2).max(5) } else { settings.min_inliers };
        if members.len() < need {
            continue;
        }
        let correspondences: Vec<Correspondence> = members
            .iter()
            .map(|&k| Correspondence {
                point: answer.landmarks[k].position_in_anchor,
                pixel: answer.landmarks[k].pixel,
            })
            .collect();
        let gravity = match (answer.gravity_in_global, settings.gravity_in_camera) {
            (Some(in_global), Some(in_camera)) => {
                let in_world = keyframe.global_from_keyframe.pose.rotation.inverse() * in_global;
                Some(Gravity { in_world, in_camera })
            }
            _ => None,
        };
        let options = RansacOptions {
            threshold_px: settings.angle * mean_focal(&calibrated.camera),
            min_inliers: need,
            seed: keyframe.id,
            gravity,
            ..RansacOptions::default()
        };
        let Some(solution) = solve(&calibrated.camera, &correspondences, &options) else { continue };
        inliers.extend(solution.inliers.iter().map(|&k| members[k]));
        if best.as_ref().is_none_or(|(_, before)| solution.inliers.len() > before.inliers.len()) {
            best = Some((keyframe.id, solution));
        }
    }
    inliers.sort_unstable();
    inliers.dedup();
    match best {
        Some((best, PnpSolution { world_from_camera: best_from_camera, mean_error_px, .. })) => {
            Ok(VerifiedAnswer { best, best_from_camera, mean_error_px, inliers })
        }
        None if most < settings.min_inliers => {
            Err(NotVerified::TooFewMatches { have: most, need: settings.min_inliers })
        }
        None => Err(NotVerified::NoPose { have: most, need: settings.min_inliers }),
    }
}

/// The pose with the most inliers. The direction of gravity guides the search; where it finds less than half of the matches,
/// the tilt of the state may be wrong, and a pose without it that has more than half of them is better.
fn solve(
    camera: &Camera,
    correspondences: &[Correspondence],
    options: &RansacOptions,
) -> Option<PnpSolution> {
    let guided = solve_ransac(camera, correspondences, options, 1.0).ok();
    let half = correspondences.len().div_ceil(2);
    if options.gravity.is_none() || guided.as_ref().is_some_and(|found| found.inliers.len() >= half) {
        return guided;
    }
    let unguided = RansacOptions { gravity: None, min_inliers: half.max(options.min_inliers), ..*options };
    solve_ransac(camera, correspondences, &unguided, 1.0).ok().or(guided)
}

fn mean_focal(camera: &Camera) -> f64 {
    0.5 * (camera.focal[0] + camera.focal[1])
}
