//! Settings of the ROS 2 topics.

use client::SessionOptions;
use geometry::Pose;
use std::str::FromStr;

/// What a robot publishes for ROS 2, and where.
#[derive(Clone, Debug)]
pub struct RosSettings {
    /// The session, which is not the one to the map: ROS 2 knows no namespace and no certificates of a fleet.
    pub session: SessionOptions,
    /// `ROS_DOMAIN_ID`.
    pub domain: u32,
    /// Namespace of node and topics; empty for none.
    pub namespace: String,
    /// The robot's frames.
    pub body: RosBody,
    /// Name of the robot, the hardware of the diagnostics.
    pub robot: String,
    /// Whether odometry without a pose in the map is worth a warning.
    pub map_expected: bool,
}

/// The frames of a robot, and its IMU in them.
#[derive(Clone, Debug)]
pub struct RosBody {
    /// Names of the frames.
    pub frames: RosFrames,
    /// Pose of the robot's frame in the IMU's.
    pub imu_from_base: Pose,
}

impl Default for RosBody {
    /// `map`, `odom` and `base_link`, which is the IMU.
    fn default() -> Self {
        let names = ["map", "odom", "base_link"].map(str::to_owned);
        let [map, odom, base_link] = names;
        Self { frames: RosFrames { map, odom, base_link }, imu_from_base: Pose::identity() }
    }
}

/// Names of the frames of REP-105.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RosFrames {
    /// The map, G.
    pub map: String,
    /// The odometry frame, L.
    pub odom: String,
    /// The robot.
    pub base_link: String,
}

impl FromStr for RosFrames {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let names: Vec<&str> = text.split(',').map(str::trim).collect();
        match names[..] {
            [map, odom, base_link] if distinct(&names) => {
                Ok(Self { map: map.to_owned(), odom: odom.to_owned(), base_link: base_link.to_owned() })
            }
            _ => {
                Err("give the three different names of map, odometry and robot: map,odom,base_link"
                    .to_owned())
            }
        }
    }
}

/// tf2 knows no frame whose name begins with `/`.
fn distinct(names: &[&str]) -> bool {
    let valid = |name: &&str| !name.is_empty() && !name.starts_with('/');
    names.iter().all(valid) && names.iter().enumerate().all(|(at, name)| !names[..at].contains(name))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_three_different_names() {
        let frames: RosFrames = "map, cart7/odom,cart7/base_link".parse().unwrap();
        assert_eq!(frames.odom, "cart7/odom");
        for wrong in ["map,odom", "map,odom,", "map,odom,odom", "/map,odom,base_link"] {
            assert!(wrong.parse::<RosFrames>().is_err(), "{wrong}");
        }
    }
}
