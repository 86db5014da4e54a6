//! ROS 2 topics of a robot, over Zenoh as `rmw_zenoh` does it.
//!
//! | topic | type | what |
//! |---|---|---|
//! | `odometry` | `nav_msgs/Odometry` | odom from base_link, smooth |
//! | `odometry_predicted` | `nav_msgs/Odometry` | the same at the rate of the IMU |
//! | `pose` | `geometry_msgs/PoseWithCovarianceStamped` | map from base_link, where localized |
//! | `/tf` | `tf2_msgs/TFMessage` | map from odom (may jump), odom from base_link (REP-105) |
//! | `/diagnostics` | `diagnostic_msgs/DiagnosticArray` | the status, every second and when it changes |

mod diagnostics;
mod messages;
mod odom_frame;
mod output;
mod serving;
mod settings;

#[cfg(test)]
mod tests;

#[cfg(feature = "bags")]
pub(crate) use diagnostics::Diagnostics;
pub use messages::Estimate;
#[cfg(feature = "bags")]
pub(crate) use messages::messages;
#[cfg(feature = "bags")]
pub(crate) use odom_frame::OdomFrame;
pub use output::{RosOutput, RosOutputTask};
pub use settings::{RosBody, RosFrames, RosSettings};
