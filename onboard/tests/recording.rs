//! The recording of a run, read back.

use bags::Bag;
use nalgebra::Vector3;
use onboard::arguments::Mode;
use onboard::{Outcome, RobotArguments, run_robot};
use ros_messages::diagnostic_msgs::DiagnosticArray;
use ros_messages::nav_msgs::Odometry;
use ros_messages::sensor_msgs::{CompressedImage, Imu};
use ros_messages::tf2_msgs::TFMessage;
use ros_messages::{RosMessage, decode};
use sensors::Recording;
use simulation::{SimulationOptions, simulate};
use std::path::Path;

/// All messages of a topic.
fn messages<M: RosMessage>(bag: &Bag, name: &str) -> Vec<M> {
    let topic = bag.topics().iter().find(|topic| topic.name == name).expect(name);
    assert!(topic.schema.is_some(), "{name}");
    topic.messages.iter().map(|message| decode(&bag.read(message.place).unwrap()).unwrap()).collect()
}

fn run<'a>(recording: impl Into<Recording<'a>>, folder: &Path) -> Outcome {
    let mut arguments = RobotArguments::with_defaults(&folder.join("out")).unwrap();
    arguments.mode = Some(Mode::Odometry);
    arguments.record = Some(folder.join("run.mcap"));
    arguments.record_sensors = true;
    run_robot(recording, &arguments, None, |_| {}).unwrap()
}

#[test]
fn a_recording_holds_what_the_files_of_the_run_hold() {
    let options = SimulationOptions { duration_s: Some(5.0), ..SimulationOptions::default() };
    let recording = simulate(&options).unwrap().live;
    let folder = tempfile::tempdir().unwrap();
    let outcome = run(&recording, folder.path());
    let bag = Bag::open(&folder.path().join("run.mcap")).unwrap();
    assert!(bag.damage().is_empty(), "{:?}", bag.damage());
    let (states, odometry) = (outcome.states().unwrap(), messages::<Odometry>(&bag, "/odometry"));
    assert_eq!(odometry.len(), states.len());
    for (message, state) in odometry.iter().zip(&states) {
        assert_eq!(message.header.stamp.to_nanoseconds(), state.stamp_ns);
        let position = Vector3::from(<[f64; 3]>::from(message.pose.pose.position));
        // The table has nine decimals.
        assert!((position - state.local_from_imu.pose.translation).amax() < 1e-8);
        assert!(message.twist.covariance[0] > 0.0);
    }
    assert_eq!(messages::<TFMessage>(&bag, "/tf").len(), states.len());
    let mounting = messages::<TFMessage>(&bag, "/tf_static");
    let children: Vec<_> =
        mounting[0].transforms.iter().map(|transform| transform.child_frame_id.as_str()).collect();
    assert_eq!((mounting.len(), children), (1, vec!["imu", "cam0", "cam1"]));
    assert!(messages::<DiagnosticArray>(&bag, "/diagnostics").len() >= states.len());
    let readings = messages::<Imu>(&bag, "/imu");
    let first = &recording.imu_samples[0];
    assert_eq!(Vector3::from(<[f64; 3]>::from(readings[0].angular_velocity)), first.gyroscope);
    assert!(readings.len() > 900, "{}", readings.len());
}

#[test]
fn images_are_recorded_as_they_are_and_an_older_recording_stays() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../crates/bags/tests/data/euroc");
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("run.mcap"), "older").unwrap();
    run(Recording::open(&data).unwrap(), folder.path());
    assert_eq!(std::fs::read_to_string(folder.path().join("run.mcap")).unwrap(), "older");
    let bag = Bag::open(&folder.path().join("run_2.mcap")).unwrap();
    let images = messages::<CompressedImage>(&bag, "/cam0/image_raw/compressed");
    let recording = Recording::open(&data).unwrap();
    let frames: Vec<_> = recording.frames().unwrap().map(Result::unwrap).collect();
    assert_eq!(images.len(), frames.len());
    for (image, frame) in images.iter().zip(&frames) {
        assert_eq!(image.header.stamp.to_nanoseconds(), frame.stamp_ns);
        assert_eq!(image.data, std::fs::read(frame.images[&0].path().unwrap()).unwrap());
    }
}
