//! Switches of the ROS 2 topics.

use crate::outputs::{InitialPoseTopic, RosBody, RosFrames, RosSettings, SensorFrames};
use client::SessionOptions;
use client::session::{DEFAULT_ENDPOINT, SessionMode};
use geometry::Pose;
use nalgebra::{UnitQuaternion, Vector3};
use robot::initial_pose::InitialPoses;
use ros2::NodeOptions;
use std::str::FromStr;

/// Heading in `--help` of the switches about ROS 2.
const ROS: &str = "ROS 2";

/// Switches of the ROS 2 topics.
#[derive(clap::Args, Clone, Debug)]
pub struct RosArguments {
    /// Publish odometry, pose, transforms and diagnostics for ROS 2 (RMW_IMPLEMENTATION=rmw_zenoh_cpp)
    #[arg(long, help_heading = ROS)]
    pub ros2: bool,
    /// Zenoh router of ROS 2 (rmw_zenohd), for --ros2 and --source ros2, in sessions of their own: --namespace and
    /// --secure do not concern it
    #[arg(long, value_name = "ENDPOINT", default_value = DEFAULT_ENDPOINT, help_heading = ROS)]
    pub ros2_connect: String,
    /// ROS_DOMAIN_ID of the other nodes
    #[arg(long, value_name = "N", default_value_t = 0, help_heading = ROS)]
    pub ros2_domain: u32,
    /// Namespace of node and topics, for example cart7 [default: none]; /tf and /diagnostics have none
    #[arg(long, value_name = "NAME", default_value = "", hide_default_value = true, help_heading = ROS)]
    pub ros2_namespace: String,
    /// Topic on which an operator sets the robot's pose in the map, for example /initialpose (RViz's 2D Pose Estimate): where the
    /// map is searched first [default: none]
    #[arg(long, value_name = "TOPIC", requires = "ros2", help_heading = ROS)]
    pub initial_pose_topic: Option<String>,
    /// Names of the frames of map, odometry and robot, for --ros2 and --record
    #[arg(long, value_name = "MAP,ODOM,BASE", default_value = "map,odom,base_link", help_heading = ROS)]
    pub frames: RosFrames,
    /// Names of the frames of IMU and cameras, whose mounting is published on /tf_static; none: a robot description has it
    #[arg(long, value_name = "IMU,CAM0,CAM1", default_value = "imu,cam0,cam1", help_heading = ROS)]
    pub sensor_frames: SensorFrames,
    /// The IMU in base_link: metres and radians (fixed-axis roll, pitch, yaw, as in URDF) [default: by /tf_static of the bag, or of ROS 2 with
    /// --source ros2; else base_link is the IMU]
    #[arg(long, value_name = "X,Y,Z,ROLL,PITCH,YAW", allow_hyphen_values = true, help_heading = ROS)]
    pub imu_in_base_link: Option<ImuInBaseLink>,
}

/// The pose of the IMU in the robot's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuInBaseLink(pub Pose);

impl FromStr for ImuInBaseLink {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Result<Vec<f64>, _> = text.split(',').map(|number| number.trim().parse()).collect();
        match numbers.as_deref() {
            Ok(&[x, y, z, roll, pitch, yaw]) if numbers.iter().flatten().all(|number| number.is_finite()) => {
                let rotation = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
                Ok(Self(Pose::new(rotation, Vector3::new(x, y, z))))
            }
            _ => Err("give six numbers: x,y,z,roll,pitch,yaw in metres and radians".to_owned()),
        }
    }
}

impl RosArguments {
    /// A session to the router of ROS 2.
    pub fn session(&self) -> SessionOptions {
        SessionOptions {
            connect: vec![self.ros2_connect.clone()],
            mode: Some(SessionMode::Client),
            ..SessionOptions::default()
        }
    }

    /// The node that subscribes to sensors.
    pub fn sensor_node(&self) -> NodeOptions {
        let (domain, namespace) = (self.ros2_domain, self.ros2_namespace.clone());
        NodeOptions { domain, namespace, name: "driftless_sensors".to_owned() }
    }

    /// The frames of the robot.
    ///
    /// # Arguments
    /// * `stated`: `imu_from_base` as transforms state it; `--imu-in-base-link` comes before.
    ///
    /// # Errors
    /// A frame of a sensor has the name of one of the robot.
    pub fn body(&self, stated: Option<Pose>) -> anyhow::Result<RosBody> {
        let given = self.imu_in_base_link.map(|ImuInBaseLink(base_from_imu)| base_from_imu.inverse());
        let body = RosBody {
            frames: self.frames.clone(),
            sensor_frames: self.sensor_frames.clone(),
            imu_from_base: given.or(stated).unwrap_or_default(),
        };
        if let Some(name) = body.ambiguous_frame() {
            anyhow::bail!("--sensor-frames and --frames both name {name}: give the sensors other names");
        }
        Ok(body)
    }

    /// The settings of the topics; `None` without `--ros2`.
    ///
    /// # Arguments
    /// * `body`: the frames of the robot.
    /// * `robot`: its name, for diagnostics.
    /// * `map_expected`: whether the robot is to be localized in a map.
    /// * `initial_poses`: where the poses of `--initial-pose-topic` go.
    pub fn settings(
        &self,
        body: &RosBody,
        robot: &str,
        map_expected: bool,
        initial_poses: &InitialPoses,
    ) -> Option<RosSettings> {
        self.ros2.then(|| RosSettings {
            session: self.session(),
            domain: self.ros2_domain,
            namespace: self.ros2_namespace.clone(),
            body: body.clone(),
            robot: robot.to_owned(),
            map_expected,
            initial_pose: self
                .initial_pose_topic
                .clone()
                .map(|topic| InitialPoseTopic { topic, poses: initial_poses.clone() }),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(clap::Parser)]
    struct Line {
        #[command(flatten)]
        ros: RosArguments,
    }

    #[test]
    fn the_switch_comes_before_what_transforms_state() {
        let given = |line: &[&str]| Line::try_parse_from([&["robot"], line].concat()).unwrap().ros;
        let stated = Pose::new(UnitQuaternion::identity(), Vector3::new(0.1, 0.0, -0.3));
        assert_eq!(given(&[]).body(None).unwrap().imu_from_base, Pose::identity());
        assert_eq!(given(&[]).body(Some(stated)).unwrap().imu_from_base, stated);
        let switched = given(&["--imu-in-base-link", "-1,0,0,0,0,0"]).body(Some(stated)).unwrap();
        assert_eq!(switched.imu_from_base.translation, Vector3::x());
        assert!(given(&["--sensor-frames", "odom"]).body(None).is_err());
    }

    #[test]
    fn the_imu_in_base_link_is_read_as_in_urdf() {
        let ImuInBaseLink(pose) = "0.1,-0.2,0.3,0,0,1.5707963267948966".parse().unwrap();
        let in_base = pose.transform(&Vector3::new(1.0, 0.0, 0.0));
        assert!((in_base - Vector3::new(0.1, 0.8, 0.3)).norm() < 1e-12, "{in_base}");
        for wrong in ["", "1,2,3", "0,0,0,0,0,x", "0,0,0,0,0,nan", "0,0,0,0,0,0,0"] {
            assert!(wrong.parse::<ImuInBaseLink>().is_err(), "{wrong}");
        }
    }
}
