//! Following points from image to image and from camera to camera: the front end of visual odometry.
//!
//! | module | what |
//! |---|---|
//! | [`lucas_kanade`] | finds a patch of one image in another |
//! | [`relative_pose`] | motion between two views from bearings |
//! | [`outliers`] | which tracks do not follow the scene |
//! | [`stereo`] | finds a point in the second camera |
//! | [`frame`] | what goes into the tracker and what comes out |
//! | [`tracker`] | puts all together: images in, tracks out |

mod block;
pub mod frame;
pub mod lucas_kanade;
pub mod options;
pub mod outliers;
mod prediction;
pub mod relative_pose;
pub mod stereo;
mod template;
pub mod tracker;

pub use frame::{TrackedPixel, TrackerError, TrackerFrame, TrackerReport};
pub use lucas_kanade::{AlignmentOptions, Found, Lost, Warp, align, align_mutually};
pub use options::TrackerOptions;
pub use outliers::{Consensus, OutlierOptions, find_outliers};
pub use relative_pose::{BearingPair, Refinement, RelativePose, rotation_between};
pub use stereo::{StereoMatch, StereoOptions, StereoPair};
pub use tracker::Tracker;

pub(crate) use template::smaller_eigenvalue;
