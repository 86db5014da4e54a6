//! Trajectories on disk: TUM files, EuRoC ground truth, and `states.csv` with covariances.
//!
//! | file | content | module |
//! |---|---|---|
//! | `*.tum` | `t x y z qx qy qz qw`, seconds with 9 decimals | [`tum`] |
//! | `states.csv` | each output of a run with its 6x6 covariance | [`states`] |
//! | EuRoC `data.csv`, `reference_poses.csv`, tables of other programs | ground truth, poses with sigmas | [`read_any`], which reads all of them |

mod any;
mod decimal;
mod layout;
mod rows;
pub mod states;
pub mod tum;

pub use any::{PoseFormat, TrajectoryFile, read_any, read_any_with};
pub use states::{StateKind, StateRow};

use geometry::pose::Pose;

/// A pose at an instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StampedPose {
    /// Time, nanoseconds.
    pub stamp_ns: i64,
    /// The pose; which frames it relates, its context says.
    pub pose: Pose,
}
