//! Rotations, poses with covariance, cameras, triangulation, PnP and RANSAC. No internal dependencies.
//!
//! | module | what |
//! |---|---|
//! | [`rotation`] | exponential map of SO(3) and its Jacobians |
//! | [`pose`], [`uncertain_pose`] | rigid poses, their covariance and its propagation |
//! | [`camera`] | cameras with the models of OpenCV, COLMAP and Kalibr for rays to the front, and their Jacobians |
//! | `camera_groups` | [`camera_groups()`]: which cameras of a rig are stereo pairs |
//! | [`triangulation`] | landmarks from several views, with covariance |
//! | [`pnp`] | camera poses from known landmarks: P3P, gravity two-point, RANSAC, refinement |
//! | [`robust`] | Huber's loss |
//! | `median` | [`median()`] |
//! | `geodetic` | [`Geodetic`], [`EnuFrame`]: positions on the earth, east, north and up of one of them |
//! | `level` | [`tilt_beyond_limit_deg`]: whether the z axis of a map is vertical |
//! | `viewpoint` | [`Viewpoint`]: where a camera is and where it looks |
//! | [`numeric`] | numeric Jacobians for tests |
//!
//! # Conventions
//! * A pose is named by what it maps: `global_from_camera` takes camera coordinates to global ones.
//! * A pose error is `[dtheta, dp]` in the parent frame: `R = Exp(dtheta) R^`, `p = p^ + dp`; covariances are of it.
//! * Camera frames: x right, y down, z forward. Pixel (0, 0) is the centre of the top-left pixel.
//! * Metres, radians, pixels. Everything is `f64`; invalid input is an error, never a panic.

#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod camera;
mod camera_groups;
pub mod coordinate;
pub mod covariance_check;
mod geodetic;
mod level;
mod median;
pub mod numeric;
pub mod pnp;
pub mod pose;
pub mod robust;
pub mod rotation;
pub mod triangulation;
pub mod uncertain_pose;
mod viewpoint;

pub use camera::{
    Camera, CameraError, Distortion, IntrinsicsJacobian, MAX_INTRINSICS, ProjectionError, check_mount,
};
pub use camera_groups::{CameraGroup, camera_groups};
pub use coordinate::{MAX_COORDINATE_M, is_coordinate};
pub use geodetic::{EnuFrame, Geodetic};
pub use level::{MAX_TILT_DEG, tilt_beyond_limit_deg};
pub use median::median;
pub use pnp::{Correspondence, Gravity, PnpError, PnpSolution, RansacOptions};
pub use pose::Pose;
pub use rotation::Rotation;
pub use triangulation::{
    Triangulated, TriangulationError, TriangulationOptions, View, reprojection_error, triangulate,
};
pub use uncertain_pose::{PoseWithCovariance, compose_jacobians, inverse_jacobian};
pub use viewpoint::Viewpoint;
