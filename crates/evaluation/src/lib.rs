//! Trajectories and their evaluation: accuracy (ATE, RPE) and consistency (NEES).
//!
//! | module | content |
//! |---|---|
//! | [`trajectory`] | TUM files, EuRoC ground truth, and `states.csv` with covariances |
//! | [`association`] | pairs of poses at the same time |
//! | [`alignment`] | the rigid transformation that aligns an estimate with the truth |
//! | [`absolute`] | absolute trajectory error (ATE) |
//! | [`relative`] | relative pose error (RPE) |
//! | [`consistency`] | normalized estimation error squared (NEES) of one pose, and its chi-square bounds |
//! | [`run`] | all of these for the three poses of a run: local pose, `G_T_L`, pose in G |
//! | [`ensemble`] | NEES of an ensemble of runs, with a verdict |
//!
//! ATE and RPE agree with `evo` to 1e-6 on the same files.
//!
//! # Example
//! The ATE of an odometry that has a frame of its own:
//! ```
//! use evaluation::trajectory::StampedPose;
//! use evaluation::{Alignment, absolute_errors, align, associate};
//! use geometry::Pose;
//! use nalgebra::{UnitQuaternion, Vector3};
//!
//! // A curve, and the same curve rotated about gravity and shifted, with stamps 2 ms late.
//! let odometry_from_world =
//!     Pose::new(UnitQuaternion::from_scaled_axis(Vector3::z() * 0.5), Vector3::new(3.0, -1.0, 0.0));
//! let truth: Vec<StampedPose> = (0..50)
//!     .map(|k| {
//!         let t = 0.1 * f64::from(k);
//!         let pose = Pose::new(UnitQuaternion::identity(), Vector3::new(t, t.sin(), 0.1 * t));
//!         StampedPose { stamp_ns: i64::from(k) * 100_000_000, pose }
//!     })
//!     .collect();
//! let estimate: Vec<StampedPose> = truth
//!     .iter()
//!     .map(|row| StampedPose { stamp_ns: row.stamp_ns + 2_000_000, pose: odometry_from_world * row.pose })
//!     .collect();
//!
//! let pairs = associate(&truth, &estimate, 10_000_000);
//! let positions: Vec<_> = pairs
//!     .iter()
//!     .map(|pair| (truth[pair.reference].pose.translation, estimate[pair.estimate].pose.translation))
//!     .collect();
//! let gravity = -Vector3::z();
//! let yaw = Alignment::Yaw { gravity_in_reference: gravity, gravity_in_estimate: gravity };
//! let world_from_odometry = align(&positions, &yaw)?;
//! let errors = absolute_errors(&truth, &estimate, &pairs, &world_from_odometry);
//! assert!(errors.translation().expect("there are pairs").rmse < 1e-9);
//! # Ok::<(), evaluation::AlignmentError>(())
//! ```
#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod absolute;
pub mod alignment;
pub mod association;
pub mod consistency;
pub mod ensemble;
mod frame_alignment;
pub mod relative;
pub mod run;
mod statistics;
pub mod trajectory;

#[cfg(test)]
mod tests;

pub use absolute::{PoseErrors, absolute_errors};
pub use alignment::{Alignment, AlignmentError, align, alignment_scale};
pub use association::{Pair, associate, interpolate_reference};
pub use consistency::{Nees, NeesSum, nees, nees_bounds};
pub use ensemble::{EnsembleNees, NeesSeries, TimePoint, Verdict};
pub use frame_alignment::MapFromTruth;
pub use relative::{Delta, relative_errors};
pub use run::{
    ErrorSample, MAX_TRUTH_GAP_NS, RunErrors, RunScore, Score, ScoreError, ScoreOptions, run_errors,
    run_errors_in, score_rows, score_run,
};
pub use statistics::Statistics;
