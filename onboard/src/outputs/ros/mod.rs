//! ROS 2 topics of a robot, over Zenoh as `rmw_zenoh` does it.
//!
//! | topic | type | what |
//! |---|---|---|
//! | `odometry` | `nav_msgs/Odometry` | odom from base_link, smooth |
//! | `odometry_predicted` | `nav_msgs/Odometry` | the same at the rate of the IMU |
//! | `pose` | `geometry_msgs/PoseWithCovarianceStamped` | map from base_link, where localized |
//! | `path` | `nav_msgs/Path` | where the robot was in the map; latched |
//! | `/clock` | `rosgraph_msgs/Clock` | the time of the sensors, where a recording is played |
//! | `/tf` | `tf2_msgs/TFMessage` | map from odom (may jump), odom from base_link (REP-105) |
//! | `/initialpose` | `geometry_msgs/PoseWithCovarianceStamped` | received, where that is wanted: a pose by an operator |
//! | `/tf_static` | `tf2_msgs/TFMessage` | base_link from IMU, IMU from cameras; latched |
//! | `/diagnostics` | `diagnostic_msgs/DiagnosticArray` | the status, every second and when it changes |

mod base_mount;
#[cfg(feature = "ros")]
mod diagnostics;
#[cfg(feature = "ros")]
mod initial_pose;
#[cfg(feature = "ros")]
mod messages;
#[cfg(feature = "ros")]
mod odom_frame;
#[cfg_attr(not(feature = "ros"), path = "no_output.rs")]
mod output;
#[cfg(feature = "ros")]
mod path;
#[cfg(feature = "ros")]
mod serving;
mod settings;
#[cfg(feature = "ros")]
mod static_transforms;

#[cfg(all(test, feature = "ros"))]
mod tests;

pub use base_mount::BaseMount;
#[cfg(feature = "bags")]
pub(crate) use diagnostics::Diagnostics;
#[cfg(feature = "bags")]
pub(crate) use messages::{map_tilt_deg, messages};
#[cfg(feature = "bags")]
pub(crate) use odom_frame::OdomFrame;
pub use output::RosOutput;
#[cfg(feature = "ros")]
pub use output::RosOutputTask;
pub use settings::{InitialPoseTopic, RosBody, RosFrames, RosSettings, SensorFrames};
#[cfg(feature = "bags")]
pub(crate) use static_transforms::{complete_transforms, static_transforms};
