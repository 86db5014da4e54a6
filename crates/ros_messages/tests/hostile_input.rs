//! Bytes from a network or a file may be anything: no panic, and no memory beyond a small multiple of them.

use proptest::prelude::*;
use ros_messages::diagnostic_msgs::{DiagnosticArray, DiagnosticStatus, KeyValue};
use ros_messages::geometry_msgs::{PoseWithCovarianceStamped, TransformStamped};
use ros_messages::nav_msgs::Odometry;
use ros_messages::sensor_msgs::{CameraInfo, CompressedImage, Image, Imu, JointState, NavSatFix};
use ros_messages::tf2_msgs::TFMessage;
use ros_messages::{CdrError, RosMessage, decode, encode};

/// An empty string or sequence takes 4 bytes here and 24 in memory, a `KeyValue` 8 and 48; vectors double.
const MEMORY_PER_BYTE: u64 = 16;
/// Error texts.
const MEMORY_FIXED: u64 = 1024;

fn decode_within_bounds<M: RosMessage>(bytes: &[u8]) -> Result<M, CdrError> {
    let mut result = None;
    let used = allocation_counter::measure(|| result = Some(decode::<M>(bytes)));
    let bound = MEMORY_FIXED + MEMORY_PER_BYTE * bytes.len() as u64;
    assert!(
        used.bytes_max <= bound,
        "{}: {} bytes for an input of {}",
        M::TYPE_NAME,
        used.bytes_max,
        bytes.len()
    );
    result.expect("decoded")
}

fn decode_as_everything(bytes: &[u8]) {
    let _ = decode_within_bounds::<Imu>(bytes);
    let _ = decode_within_bounds::<JointState>(bytes);
    let _ = decode_within_bounds::<NavSatFix>(bytes);
    let _ = decode_within_bounds::<Image>(bytes);
    let _ = decode_within_bounds::<CompressedImage>(bytes);
    let _ = decode_within_bounds::<CameraInfo>(bytes);
    let _ = decode_within_bounds::<PoseWithCovarianceStamped>(bytes);
    let _ = decode_within_bounds::<TFMessage>(bytes);
    let _ = decode_within_bounds::<Odometry>(bytes);
    let _ = decode_within_bounds::<DiagnosticArray>(bytes);
}

proptest! {
    #[test]
    fn any_bytes_are_a_message_or_an_error(
        big_endian in any::<bool>(), body in prop::collection::vec(prop_oneof![Just(0_u8), any::<u8>()], 0..600),
    ) {
        let mut bytes = vec![0, u8::from(!big_endian), 0, 0];
        bytes.extend(body);
        decode_as_everything(&bytes);
    }

    #[test]
    fn every_changed_byte_is_a_message_or_an_error(at in 0..400_usize, value in any::<u8>()) {
        let mut bytes = encode(&diagnostics()).unwrap();
        let at = at % bytes.len();
        bytes[at] = value;
        decode_as_everything(&bytes);
    }
}

fn diagnostics() -> DiagnosticArray {
    let values = vec![KeyValue { key: "rate".into(), value: "200".into() }; 5];
    let status =
        DiagnosticStatus { name: "imu".into(), message: "works".into(), values, ..Default::default() };
    DiagnosticArray { status: vec![status; 3], ..Default::default() }
}

fn every_truncation_is_an_error<M: RosMessage>(message: &M) {
    let bytes = encode(message).unwrap();
    for length in 0..bytes.len() {
        let error = decode_within_bounds::<M>(&bytes[..length]).err().expect("a part is no message");
        let expected = if length < 4 { "too few" } else { "truncated" };
        assert!(error.to_string().contains(expected), "{length} of {}: {error}", bytes.len());
    }
}

#[test]
fn truncated_messages_are_errors() {
    every_truncation_is_an_error(&diagnostics());
    every_truncation_is_an_error(&Imu::default());
    every_truncation_is_an_error(&NavSatFix::default());
    let (name, velocity) = (vec!["left_wheel".into(), "right_wheel".into()], vec![1.0, 2.0]);
    every_truncation_is_an_error(&JointState { name, velocity, ..Default::default() });
    every_truncation_is_an_error(&Odometry { child_frame_id: "base_link".into(), ..Default::default() });
    every_truncation_is_an_error(&TFMessage { transforms: vec![TransformStamped::default(); 2] });
    every_truncation_is_an_error(&CameraInfo { d: vec![0.1; 5], ..Default::default() });
    every_truncation_is_an_error(&Image { data: vec![7; 64], ..Default::default() });
}

#[test]
fn a_length_beyond_the_input_is_an_error_without_allocation() {
    let bytes = encode(&Image { data: vec![7; 64], ..Default::default() }).unwrap();
    let length_at = bytes.len() - 64 - 4;
    for length in [65, 1_000_000, u32::MAX] {
        let mut hostile = bytes.clone();
        hostile[length_at..length_at + 4].copy_from_slice(&length.to_le_bytes());
        assert!(matches!(decode_within_bounds::<Image>(&hostile), Err(CdrError::Malformed { .. })));
    }
    let mut sequence = vec![0, 1, 0, 0];
    sequence.extend(u32::MAX.to_le_bytes());
    assert!(matches!(decode_within_bounds::<TFMessage>(&sequence), Err(CdrError::Malformed { .. })));
}

#[test]
fn other_representations_and_other_types_are_named() {
    let mut bytes = encode(&Imu::default()).unwrap();
    let error = decode::<CompressedImage>(&bytes).unwrap_err();
    assert!(matches!(error, CdrError::TrailingBytes { count: 1.., .. }), "{error}");
    bytes[1] = 7;
    let error = decode::<Imu>(&bytes).unwrap_err();
    assert!(matches!(error, CdrError::Representation { representation: 7, .. }), "{error}");
}

#[test]
fn what_is_not_a_number_arrives_as_such() {
    let reading = Imu { linear_acceleration: [f64::NAN, f64::INFINITY, -0.0].into(), ..Default::default() };
    let decoded: Imu = decode(&encode(&reading).unwrap()).unwrap();
    assert!(decoded.linear_acceleration.x.is_nan());
    assert!(decoded.linear_acceleration.y.is_infinite() && decoded.linear_acceleration.z.is_sign_negative());
}
