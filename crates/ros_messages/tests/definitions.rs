//! The definitions are those of ROS: their hash (REP-2016) is the type hash that ROS states.

use ros_messages::diagnostic_msgs::DiagnosticArray;
use ros_messages::geometry_msgs::PoseWithCovarianceStamped;
use ros_messages::nav_msgs::{OccupancyGrid, Odometry, Path};
use ros_messages::rosgraph_msgs::Clock;
use ros_messages::sensor_msgs::{
    CameraInfo, CompressedImage, Image, Imu, JointState, NavSatFix, PointCloud2,
};
use ros_messages::tf2_msgs::TFMessage;
use ros_messages::{RosMessage, definition};
use sha2::{Digest as _, Sha256};
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// `type_description_interfaces/FieldType`: numbers of plain types, of arrays and of sequences.
const PLAIN: [(&str, u32); 10] = [
    ("int8", 2),
    ("uint8", 3),
    ("uint16", 5),
    ("int32", 6),
    ("uint32", 7),
    ("float32", 10),
    ("float64", 11),
    ("bool", 15),
    ("byte", 16),
    ("string", 17),
];
const NESTED: u32 = 1;
const ARRAY: u32 = 48;
const SEQUENCE: u32 = 144;

fn full(name: &str) -> String {
    name.replace('/', "/msg/")
}

/// The description of a type as REP-2016 writes it.
fn description(name: &str, fields: &str) -> String {
    let mut all = Vec::new();
    for line in fields.lines().filter(|line| !line.contains('=')) {
        let (kind, rest) = line.split_once(' ').unwrap();
        let name = rest.split(' ').next().unwrap();
        let (plain, capacity, offset) = match kind.split_once('[') {
            None => (kind, 0, 0),
            Some((plain, "]")) => (plain, 0, SEQUENCE),
            Some((plain, count)) => (plain, count.trim_end_matches(']').parse::<u32>().unwrap(), ARRAY),
        };
        let known = PLAIN.iter().find(|(known, _)| *known == plain);
        let (id, nested) = known.map_or((NESTED, full(plain)), |(_, id)| (*id, String::new()));
        all.push(format!(
            "{{\"name\": \"{name}\", \"type\": {{\"type_id\": {}, \"capacity\": {capacity}, \"string_capacity\": 0, \
             \"nested_type_name\": \"{nested}\"}}}}",
            id + offset
        ));
    }
    format!("{{\"type_name\": \"{name}\", \"fields\": [{}]}}", all.join(", "))
}

fn hash(name: &str, definition: &str) -> String {
    let separator = format!("{}\nMSG: ", "=".repeat(80));
    let mut parts = definition.split(&separator);
    let own = description(name, parts.next().unwrap());
    let referenced: BTreeMap<String, String> = parts
        .map(|part| part.split_once('\n').unwrap())
        .map(|(name, fields)| (full(name), description(&full(name), fields)))
        .collect();
    let referenced: Vec<String> = referenced.into_values().collect();
    let text = format!(
        "{{\"type_description\": {own}, \"referenced_type_descriptions\": [{}]}}",
        referenced.join(", ")
    );
    Sha256::digest(text).iter().fold("RIHS01_".to_owned(), |mut text, byte| {
        let _ = write!(text, "{byte:02x}");
        text
    })
}

fn is_of_ros<M: RosMessage>() {
    let definition = definition::<M>();
    assert_eq!(hash(M::TYPE_NAME, &definition), M::TYPE_HASH, "{}:\n{definition}", M::TYPE_NAME);
}

#[test]
fn every_definition_has_the_hash_of_its_type() {
    is_of_ros::<Imu>();
    is_of_ros::<JointState>();
    is_of_ros::<NavSatFix>();
    is_of_ros::<Image>();
    is_of_ros::<CompressedImage>();
    is_of_ros::<CameraInfo>();
    is_of_ros::<PoseWithCovarianceStamped>();
    is_of_ros::<Odometry>();
    is_of_ros::<TFMessage>();
    is_of_ros::<DiagnosticArray>();
    is_of_ros::<Clock>();
    is_of_ros::<Path>();
    is_of_ros::<OccupancyGrid>();
    is_of_ros::<PointCloud2>();
}
