//! Visual odometry from feature tracks: MSCKF update, SLAM features, zero-velocity update.

pub mod delayed_initialization;
pub mod feature_measurement;
mod landmark_basis;
pub mod msckf_update;
pub mod pixel_measurement;
pub mod second_order;
pub mod slam_update;
mod track_triangulation;
pub mod tracks;
pub mod zero_velocity;
