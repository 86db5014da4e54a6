//! Switches of the ROS 2 topics.

use super::ImuInBaseLink;
use crate::outputs::{BaseMount, InitialPoseTopic, RosBody, RosFrames, RosSettings, SensorFrames};
use client::SessionOptions;
use client::session::{DEFAULT_ENDPOINT, SessionMode};
use robot::initial_pose::InitialPoses;
use ros2::NodeOptions;

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
    /// Do not publish /clock while a recording is played: another node does
    #[arg(long, requires = "ros2", help_heading = ROS)]
    pub no_ros2_clock: bool,
    /// Topic on which an operator sets the robot's pose in the map, for example /initialpose (RViz's 2D Pose Estimate): where the
    /// map is searched first [default: none]
    #[arg(long, value_name = "TOPIC", requires = "ros2", help_heading = ROS)]
    pub initial_pose_topic: Option<String>,
    /// Names of the frames of map, odometry and robot, for --ros2 and --record
    #[arg(long, value_name = "MAP,ODOM,BASE", default_value = "map,odom,base_link", help_heading = ROS)]
    pub frames: RosFrames,
    /// Names of the frames of IMU and cameras, whose mounting is published on /tf_static; ... in the end: and all further cameras as
    /// camN; none: a robot description has it
    #[arg(long, value_name = "IMU,CAM0,CAM1,...", default_value = "imu,cam0,cam1,...", help_heading = ROS)]
    pub sensor_frames: SensorFrames,
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
    /// * `given`: `--imu-in-base-link`, which comes before what transforms state.
    /// * `stated`: as transforms state it.
    ///
    /// # Errors
    /// A frame of a sensor has the name of one of the robot.
    pub fn body(&self, given: Option<ImuInBaseLink>, stated: Option<BaseMount>) -> anyhow::Result<RosBody> {
        let given = given.map(|given| BaseMount::known(given.imu_from_base()));
        let body = RosBody {
            frames: self.frames.clone(),
            sensor_frames: self.sensor_frames.clone(),
            mount: given.or(stated).unwrap_or_default(),
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
    /// * `is_replay`: whether a recording is played, whose time is that of the other nodes.
    /// * `initial_poses`: where the poses of `--initial-pose-topic` go.
    pub fn settings(
        &self,
        body: &RosBody,
        robot: &str,
        map_expected: bool,
        is_replay: bool,
        initial_poses: &InitialPoses,
    ) -> Option<RosSettings> {
        self.ros2.then(|| RosSettings {
            session: self.session(),
            domain: self.ros2_domain,
            namespace: self.ros2_namespace.clone(),
            body: body.clone(),
            robot: robot.to_owned(),
            map_expected,
            has_clock: is_replay && !self.no_ros2_clock,
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
    use geometry::Pose;
    use nalgebra::{UnitQuaternion, Vector3};

    #[derive(clap::Parser)]
    struct Line {
        #[command(flatten)]
        ros: RosArguments,
    }

    fn given(line: &[&str]) -> RosArguments {
        Line::try_parse_from([&["robot"], line].concat()).unwrap().ros
    }

    #[test]
    fn the_switch_comes_before_what_transforms_state() {
        let stated = Pose::new(UnitQuaternion::identity(), Vector3::new(0.1, 0.0, -0.3));
        let mounted = |switch: Option<ImuInBaseLink>, stated: Option<Pose>| {
            let body = given(&[]).body(switch, stated.map(BaseMount::known));
            body.unwrap().mount.imu_from_base()
        };
        assert_eq!(mounted(None, None), Pose::identity());
        assert_eq!(mounted(None, Some(stated)), stated);
        let switch: ImuInBaseLink = "-1,0,0,0,0,0".parse().unwrap();
        assert_eq!(mounted(Some(switch), Some(stated)).translation, Vector3::x());
        assert!(given(&["--sensor-frames", "odom"]).body(None, None).is_err());
    }
}
