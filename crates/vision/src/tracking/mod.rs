//! Feature tracking from image to image and between stereo cameras: the front end of visual odometry.
//!
//! | module | what |
//! |---|---|
//! | [`lucas_kanade`] | alignment of a patch with another image |
//! | [`relative_pose`] | relative pose of two images from bearings |
//! | [`outliers`] | outlier rejection by RANSAC on the epipolar geometry |
//! | [`stereo`] | stereo matching in the second camera |
//! | [`frames`] | input and output of the tracker |
//! | [`options`] | settings of the tracker |
//! | [`tracker`] | the tracker: images in, tracks out |

mod block;
mod first_patch;
pub mod frames;
mod inverse;
pub mod lucas_kanade;
pub mod options;
pub mod outliers;
mod patch;
mod prediction;
pub mod relative_pose;
mod search;
pub mod stereo;
mod template;
pub mod tracker;

pub use frames::{TrackedPixel, TrackerError, TrackerFrame, TrackerReport};
pub use lucas_kanade::{Alignment, AlignmentError, AlignmentOptions, Warp, align, align_with_backward_check};
pub use options::TrackerOptions;
pub use outliers::{Consensus, OutlierOptions, find_outliers};
pub use relative_pose::{BearingPair, RefinementOptions, RelativePose, rotation_between};
pub use stereo::{StereoMatch, StereoOptions, StereoPair};
pub use tracker::Tracker;
