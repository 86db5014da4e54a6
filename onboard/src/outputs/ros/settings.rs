//! Settings of the ROS 2 topics.

use super::base_mount::BaseMount;
use client::SessionOptions;
use robot::initial_pose::InitialPoses;
use std::str::FromStr;

/// In place of the names of the sensors' frames: none is published.
const NO_FRAMES: &str = "none";
/// Stands for all further cameras.
const OTHERS: &str = "...";

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
    /// Whether `/clock` is published: a recording is played.
    pub has_clock: bool,
    /// Where an operator sets poses.
    pub initial_pose: Option<InitialPoseTopic>,
}

/// A topic of poses that an operator sets.
#[derive(Clone, Debug)]
pub struct InitialPoseTopic {
    /// Its name, below the namespace unless it begins with `/`.
    pub topic: String,
    /// Where they go.
    pub poses: InitialPoses,
}

/// The frames of a robot, and its IMU in them.
#[derive(Clone, Debug)]
pub struct RosBody {
    /// Names of the frames.
    pub frames: RosFrames,
    /// Names of the frames of the sensors.
    pub sensor_frames: SensorFrames,
    /// Where the robot's frame is on the IMU.
    pub mount: BaseMount,
}

impl Default for RosBody {
    /// `map`, `odom` and `base_link`, which is the IMU.
    fn default() -> Self {
        let names = ["map", "odom", "base_link"].map(str::to_owned);
        let [map, odom, base_link] = names;
        Self {
            frames: RosFrames { map, odom, base_link },
            sensor_frames: SensorFrames::default(),
            mount: BaseMount::default(),
        }
    }
}

impl RosBody {
    /// A frame that is both one of the robot's and one of its sensors', where there is one.
    pub fn ambiguous_frame(&self) -> Option<&str> {
        let RosFrames { map, odom, base_link } = &self.frames;
        let is_of_robot = |name: &&String| [map, odom, base_link].contains(name);
        self.sensor_frames.names.iter().find(is_of_robot).map(String::as_str)
    }
}

/// Names of the frames of the IMU and of the cameras, as far as transforms to them are to be published.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SensorFrames {
    /// IMU, camera 0, camera 1 and so on; those that are left out are not published.
    pub names: Vec<String>,
    /// Whether all further cameras are published, too, by their usual names.
    pub with_others: bool,
}

impl Default for SensorFrames {
    /// `imu`, `cam0`, `cam1`, and further cameras likewise.
    fn default() -> Self {
        Self { names: ["imu", "cam0", "cam1"].map(str::to_owned).to_vec(), with_others: true }
    }
}

impl SensorFrames {
    /// How many of some cameras are published.
    pub(crate) fn published(&self, cameras: usize) -> usize {
        if self.with_others { cameras } else { self.names.len().saturating_sub(1).min(cameras) }
    }
}

impl FromStr for SensorFrames {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == NO_FRAMES {
            return Ok(Self { names: Vec::new(), with_others: false });
        }
        let mut names: Vec<&str> = text.split(',').map(str::trim).collect();
        let with_others = names.pop_if(|last| *last == OTHERS).is_some();
        if names.is_empty() || names.contains(&OTHERS) || !distinct(&names) {
            return Err("give different names of IMU and cameras, imu,cam0,cam1, as many as are to be \
                        published, with ... in the end for all further cameras, or none"
                .to_owned());
        }
        Ok(Self { names: names.into_iter().map(str::to_owned).collect(), with_others })
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
    fn frames_of_sensors_are_named_in_order_or_not_at_all() {
        let names = |text: &str| text.parse::<SensorFrames>().map(|frames| frames.names);
        assert_eq!(names("none").unwrap(), Vec::<String>::new());
        assert_eq!(names("cart7/imu, cart7/left").unwrap(), ["cart7/imu", "cart7/left"]);
        for wrong in ["", "imu,imu", "/imu", "...", "imu,...,cam1", "imu,,cam1"] {
            assert!(names(wrong).is_err(), "{wrong}");
        }
        assert_eq!("imu,cam0,cam1,...".parse(), Ok(SensorFrames::default()));
        let published = |text: &str| text.parse::<SensorFrames>().unwrap().published(4);
        assert_eq!(["none", "imu", "imu,front,left,back", "imu,front,..."].map(published), [0, 0, 3, 4]);
        let body = RosBody { sensor_frames: "imu,base_link".parse().unwrap(), ..RosBody::default() };
        assert_eq!(body.ambiguous_frame(), Some("base_link"));
        assert_eq!(RosBody::default().ambiguous_frame(), None);
    }

    #[test]
    fn frames_are_three_different_names() {
        let frames: RosFrames = "map, cart7/odom,cart7/base_link".parse().unwrap();
        assert_eq!(frames.odom, "cart7/odom");
        for wrong in ["map,odom", "map,odom,", "map,odom,odom", "/map,odom,base_link"] {
            assert!(wrong.parse::<RosFrames>().is_err(), "{wrong}");
        }
    }
}
