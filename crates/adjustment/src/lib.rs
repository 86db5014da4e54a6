//! Sparse nonlinear least squares over poses, velocities, biases of an IMU and landmarks.
//!
//! One adjuster for all: maps are built, extended and merged with it, and the filter starts in motion with it.
//!
//! | step | module |
//! |---|---|
//! | unknowns: a pose a view, a motion where an IMU measures, landmarks | `bundle`, `layout`, `landmark` |
//! | terms of the cost besides pixels | `factor`, `pose_prior`, `joint_prior`, `measured_pose`, `relative_pose`, `landmark_tie` |
//! | what a stored map knows of a landmark | `landmark_prior` |
//! | the cost with the pixels and their robust loss, and its equations | `problem`, `loss`, `camera` |
//! | landmarks are eliminated (Schur complement) | `landmark_equations`, `normal_equations` |
//! | the equations of the states are solved | `sparse_system`, `dense_inverse` |
//! | steps to the minimum | `levenberg_marquardt`, and without damping `gauss_newton` |
//! | covariance at the minimum | `covariance` |
//! | work on all processors, with results that do not depend on their number | [`parallel`] |
//!
//! # Coordinate systems
//! A view is a body at one time: poses are `global_from_body`, and cameras are mounted on the body ([`MountedCamera`]). In a map the body
//! is camera 0, at the start of the filter the IMU. Errors of poses are `[δθ, δp]` in G, see `geometry`. Metres, radians,
//! seconds, pixels.
#![cfg_attr(test, allow(clippy::unwrap_used))]

mod bundle;
mod camera;
mod covariance;
mod dense_inverse;
mod factor;
mod gauss_newton;
mod joint_prior;
mod landmark;
mod landmark_equations;
mod landmark_prior;
mod landmark_tie;
mod layout;
mod levenberg_marquardt;
mod loss;
mod measured_pose;
mod normal_equations;
pub mod parallel;
mod pose_prior;
mod problem;
mod relative_pose;
mod sparse_system;

pub use bundle::{Bundle, ViewMotion};
pub use camera::{MAX_DEPTH, MIN_DEPTH, MountedCamera, ViewPose};
pub use covariance::StateCovariance;
pub use dense_inverse::inverse_of;
pub use factor::{Factor, information_times};
pub use joint_prior::{JointPrior, pose_errors};
pub use landmark::{FeatureId, InverseDepthLandmark, LandmarkObservation, MAPPED_INVERSE_DEPTHS, Prediction};
pub use landmark_equations::{LandmarkBlocks, LandmarkEquations};
pub use landmark_prior::{LandmarkPrior, StoredObserver};
pub use landmark_tie::LandmarkTie;
pub use layout::{MOTION, POSE, StateLayout};
pub use loss::Loss;
pub use measured_pose::{MeasuredPose, MeasuredPoses, remove_wrong};
pub use normal_equations::{NormalEquations, Step};
pub use pose_prior::{PosePrior, gauge_information, pose_error};
pub use problem::{PixelModel, Problem};
pub use relative_pose::RelativePose;
pub use sparse_system::{SparseFactor, SparseSystem};
