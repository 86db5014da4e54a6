//! Visual odometry from feature tracks: MSCKF update, SLAM features, zero-velocity update.

pub mod feature_measurement;
pub mod msckf_update;
pub mod pixel_measurement;
pub mod slam_update;
pub mod tracks;
pub mod zero_velocity;
