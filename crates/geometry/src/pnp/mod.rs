//! Perspective-n-point: the pose of a camera from known world points and their pixels.
//!
//! Minimal solvers ([`p3p`], [`gravity_two_point`]), robust estimation ([`solve_ransac`]), and refinement with covariance
//! ([`refine`]). All return `world_from_camera`.

mod gravity;
mod p3p;
mod ransac;
mod refine;

pub use gravity::{Gravity, gravity_two_point};
pub use p3p::p3p;
pub use ransac::{PnpSolution, RansacOptions, solve_ransac};
pub use refine::refine;

use crate::camera::Camera;
use crate::pose::Pose;
use nalgebra::{Vector2, Vector3};

/// A world point and its observed pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Correspondence {
    /// In the world frame, metres.
    pub point: Vector3<f64>,
    /// Distorted pixel.
    pub pixel: Vector2<f64>,
}

impl Correspondence {
    fn is_finite(&self) -> bool {
        self.point.iter().chain(self.pixel.iter()).all(|value| value.is_finite())
    }

    /// Distance (pixels) between the pixel and the projection of the point; `None` if it cannot be projected, for example
    /// behind the camera.
    #[inline]
    pub fn reprojection_error(&self, camera: &Camera, world_from_camera: &Pose) -> Option<f64> {
        let pixel = camera.project(&world_from_camera.inverse_transform(&self.point)).ok()?;
        Some((self.pixel - pixel).norm())
    }
}

/// Why a pose could not be found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum PnpError {
    /// Fewer correspondences than the method needs.
    #[error("{given} correspondences; at least {needed} are needed")]
    TooFew {
        /// Number of correspondences given.
        given: usize,
        /// Number of correspondences needed.
        needed: usize,
    },
    /// NaN or infinity in the input, or an option out of range.
    #[error("a point, pixel, pose or option is not finite or out of range")]
    InvalidInput,
    /// Degenerate configuration: collinear points, vertically aligned points (two-point), or coinciding rays.
    #[error("the points or rays are in a degenerate configuration")]
    Degenerate,
    /// No pose with the points in front of the camera explains the correspondences.
    #[error("no pose explains the correspondences")]
    NoSolution,
    /// The best pose has fewer inliers than required.
    #[error("only {found} inliers; {needed} are needed")]
    TooFewInliers {
        /// Inliers of the best pose.
        found: usize,
        /// `min_inliers` of the options.
        needed: usize,
    },
}
