//! Messages satisfy the schemas of the standard, byte by byte as they are committed, for judges that nobody here wrote.

use crate::robot::{odometry, pose, status};
use crate::schema::faults;
use protocol::RobotState;
use serde_json::{Value, json};
use std::time::{Duration, Instant, UNIX_EPOCH};
use vda5050::{Connection, ConnectionState, Header, Published, Vehicle, VehicleSettings, Visualization};

/// One message a line: the topic, a tab, JSON.
const GOLDEN: &str = include_str!("goldens/messages.txt");

fn header(number: u32) -> Header {
    let time = UNIX_EPOCH + Duration::from_millis(1_790_000_000_120 + u64::from(number) * 200);
    Header::new(number, time, "acme", "cart7")
}

/// A robot from its first status to its last, as messages.
fn messages() -> Vec<(&'static str, String)> {
    let now = Instant::now();
    let mut vehicle = Vehicle::new(VehicleSettings::default(), now);
    let mut lines = Vec::new();
    let connection = |number, connection_state| {
        let message = Connection { header: header(number), connection_state };
        ("connection", serde_json::to_string(&message).unwrap())
    };
    lines.push(connection(1, ConnectionState::Online));
    let mut visualize = |vehicle: &Vehicle, at: Instant| {
        let (agv_position, velocity) = (vehicle.position(at), vehicle.velocity(at));
        let message = Visualization { header: header(lines.len() as u32 - 1), agv_position, velocity };
        lines.push(("visualization", serde_json::to_string(&message).unwrap()));
    };
    visualize(&vehicle, now);
    vehicle.note(Published::Odometry(Box::new(odometry(1, 0.25))), now);
    vehicle.note(Published::Status(status(RobotState::OdometryOnly)), now);
    visualize(&vehicle, now);
    vehicle.note(Published::Pose(Box::new(pose(1, 3.0, 0.25))), now);
    vehicle.note(Published::Status(status(RobotState::Localized)), now);
    visualize(&vehicle, now);
    visualize(&vehicle, now + Duration::from_secs(2));
    vehicle.note(Published::Status(status(RobotState::Lost)), now);
    visualize(&vehicle, now);
    lines.push(connection(2, ConnectionState::Offline));
    lines.push(connection(0, ConnectionState::ConnectionBroken));
    lines
}

/// `UPDATE=1` writes the committed messages.
#[test]
fn messages_are_those_that_are_committed() {
    let lines: Vec<String> =
        messages().iter().map(|(topic, message)| format!("{topic}\t{message}\n")).collect();
    let text = lines.concat();
    if std::env::var_os("UPDATE").is_some() {
        std::fs::write(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/goldens/messages.txt"), &text).unwrap();
    }
    assert_eq!(text, GOLDEN, "UPDATE=1 cargo test -p driftless-vda5050 messages");
}

#[test]
fn messages_satisfy_the_schemas() {
    for (topic, message) in messages() {
        let faults = faults(topic, &serde_json::from_str(&message).unwrap());
        assert!(faults.is_empty(), "{message}\n{faults:?}");
    }
}

#[test]
fn what_does_not_satisfy_a_schema_is_found() {
    let (topic, message) = &messages()[3];
    let good: Value = serde_json::from_str(message).unwrap();
    for (pointer, wrong) in [
        ("/headerId", json!("3")),
        ("/timestamp", json!(5)),
        ("/agvPosition/x", json!(null)),
        ("/agvPosition/localizationScore", json!(1.5)),
        ("/agvPosition/localizationScore", json!(-0.1)),
        ("/agvPosition/positionInitialized", json!(1)),
        ("/velocity/vx", json!("1")),
    ] {
        let mut message = good.clone();
        *message.pointer_mut(pointer).unwrap() = wrong;
        assert_eq!(faults(topic, &message).len(), 1, "{pointer}");
    }
    let mut message = good.clone();
    message["agvPosition"].as_object_mut().unwrap().remove("mapId");
    assert_eq!(faults(topic, &message).len(), 1);
}
