//! Geometric verification of an answer: which of its matches one camera pose explains.
//!
//! The matches of each keyframe are explained in that keyframe's own frame, so that the map's pose
//! errors do not matter here.

use crate::KeyframeId;
use crate::calibration::CalibratedCamera;
use crate::map_update::map_answer::MapAnswer;
use geometry::pnp::{Correspondence, Gravity, PnpSolution, RansacOptions, solve_ransac};
use geometry::{Camera, PoseWithCovariance};
use nalgebra::Vector3;

/// The outcome for a whole answer.
#[derive(Clone, Debug)]
pub struct Verified {
    /// The keyframe that explains most.
    pub best: KeyframeId,
    /// Camera pose in that keyframe; its covariance takes the landmarks for exact and their pixels for one px off.
    pub best_from_camera: PoseWithCovariance,
    /// Mean reprojection error there, px.
    pub mean_error_px: f64,
    /// Indices into the answer's landmarks that are explained.
    pub inliers: Vec<usize>,
}

/// Why an answer is not verified.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NotVerified {
    /// Too few matches to begin with.
    #[error("{have} matches with one keyframe, {need} are needed")]
    TooFewMatches {
        /// Most matches of one keyframe.
        have: usize,
        /// The configured minimum.
        need: usize,
    },
    /// No pose explains enough of them.
    #[error("no camera pose explains {need} of the {have} matches")]
    NoPose {
        /// Most matches of one keyframe.
        have: usize,
        /// The configured minimum.
        need: usize,
    },
}

/// What the verification needs to know beside the answer.
#[derive(Clone, Copy, Debug)]
pub struct VerificationSettings {
    /// Reprojection error that counts as explained, rad.
    pub angle: f64,
    /// Fewest matches that the best keyframe must explain.
    pub min_inliers: usize,
    /// Unit vector along gravity in the current camera, where known.
    pub gravity_in_camera: Option<Vector3<f64>>,
}

/// Verifies every keyframe of an answer.
///
/// # Errors
/// [`NotVerified`] when not even the best keyframe is explained.
pub fn verify(
    answer: &MapAnswer,
    eye: &CalibratedCamera,
    settings: &VerificationSettings,
) -> Result<Verified, NotVerified> {
    let mut best: Option<(KeyframeId, PnpSolution)> = None;
    let mut inliers = Vec::new();
    let mut most = 0;
    for keyframe in &answer.keyframes {
        let members: Vec<usize> =
            (0..answer.landmarks.len()).filter(|&k| answer.landmarks[k].anchor == keyframe.id).collect();
        most = most.max(members.len());
        // Further keyframes may bring fewer matches than the best one must have.
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
            threshold_px: settings.angle * mean_focal(&eye.camera),
            min_inliers: need,
            seed: keyframe.id,
            gravity,
            ..RansacOptions::default()
        };
        let Ok(solution) = solve_ransac(&eye.camera, &correspondences, &options, 1.0) else { continue };
        inliers.extend(solution.inliers.iter().map(|&k| members[k]));
        if best.as_ref().is_none_or(|(_, before)| solution.inliers.len() > before.inliers.len()) {
            best = Some((keyframe.id, solution));
        }
    }
    inliers.sort_unstable();
    inliers.dedup();
    match best {
        Some((best, PnpSolution { world_from_camera: best_from_camera, mean_error_px, .. })) => {
            Ok(Verified { best, best_from_camera, mean_error_px, inliers })
        }
        None if most < settings.min_inliers => {
            Err(NotVerified::TooFewMatches { have: most, need: settings.min_inliers })
        }
        None => Err(NotVerified::NoPose { have: most, need: settings.min_inliers }),
    }
}

fn mean_focal(camera: &Camera) -> f64 {
    0.5 * (camera.focal[0] + camera.focal[1])
}
