//! The bytes, the values and the type hashes of real ROS 2: `goldens/make_goldens.py` says how they were made.

use ros_messages::diagnostic_msgs::DiagnosticArray;
use ros_messages::geometry_msgs::PoseWithCovarianceStamped;
use ros_messages::nav_msgs::{OccupancyGrid, Odometry, Path as RosPath};
use ros_messages::rosgraph_msgs::Clock;
use ros_messages::sensor_msgs::{
    CameraInfo, CompressedImage, Image, Imu, JointState, NavSatFix, PointCloud2,
};
use ros_messages::tf2_msgs::TFMessage;
use ros_messages::{RosMessage, decode, encode};
use serde::Deserialize;
use std::fmt::Debug;
use std::path::Path;

#[derive(Deserialize)]
struct Golden<M> {
    r#type: String,
    hash: String,
    value: M,
}

fn equals_ros<M: RosMessage + PartialEq + Debug>() {
    let name = M::TYPE_NAME.rsplit('/').next().unwrap();
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/goldens").join(name);
    let golden: Golden<M> =
        serde_json::from_str(&std::fs::read_to_string(path.with_extension("json")).unwrap()).unwrap();
    let bytes = std::fs::read(path.with_extension("cdr")).unwrap();
    assert_eq!(golden.r#type, M::TYPE_NAME);
    assert_eq!(golden.hash, M::TYPE_HASH, "{}", M::TYPE_NAME);
    assert_eq!(decode::<M>(&bytes).unwrap(), golden.value, "{}", M::TYPE_NAME);
    assert_eq!(encode(&golden.value).unwrap(), bytes, "{}", M::TYPE_NAME);
}

#[test]
fn every_message_has_the_bytes_of_ros() {
    equals_ros::<Imu>();
    equals_ros::<Image>();
    equals_ros::<CompressedImage>();
    equals_ros::<CameraInfo>();
    equals_ros::<PoseWithCovarianceStamped>();
    equals_ros::<Odometry>();
    equals_ros::<TFMessage>();
    equals_ros::<DiagnosticArray>();
    equals_ros::<Clock>();
    equals_ros::<RosPath>();
    equals_ros::<OccupancyGrid>();
    equals_ros::<PointCloud2>();
    equals_ros::<NavSatFix>();
    equals_ros::<JointState>();
}
