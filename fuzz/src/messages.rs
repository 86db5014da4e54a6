//! Payloads of the network, in both formats.

use protocol::{Format, Message, decode, encode};

/// Calls a macro-like function for every message type.
macro_rules! for_each_message {
    ($apply:ident, $($argument:expr),*) => {
        $apply::<protocol::MatchRequest>($($argument),*);
        $apply::<protocol::MatchReply>($($argument),*);
        $apply::<protocol::LocalizeRequest>($($argument),*);
        $apply::<protocol::LocalizeReply>($($argument),*);
        $apply::<protocol::MapInfoReply>($($argument),*);
        $apply::<protocol::KeyframeReply>($($argument),*);
        $apply::<protocol::MapChangeNotice>($($argument),*);
        $apply::<protocol::RobotPose>($($argument),*);
        $apply::<protocol::RobotOdometry>($($argument),*);
        $apply::<protocol::RobotStatus>($($argument),*);
        $apply::<protocol::ErrorReply>($($argument),*);
    };
}

/// Bincode payloads: the bytes as they are, and as the body of an intact envelope, so that mutations get past the checksum.
pub fn protocol_bincode(data: &[u8]) {
    for_each_message!(round_trip, Format::Bincode, data);
    for_each_message!(sealed_round_trip, data);
}

/// JSON payloads.
pub fn protocol_json(data: &[u8]) {
    for_each_message!(round_trip, Format::Json, data);
}

/// What decodes is valid: it encodes, and decodes to the same again.
fn round_trip<M: Message>(format: Format, data: &[u8]) {
    let Ok(message) = decode::<M>(format, data) else { return };
    let bytes = encode(format, &message).expect("a decoded message is valid");
    let again = decode::<M>(format, &bytes).expect("what was encoded can be decoded");
    let repeated = encode(format, &again).expect("a decoded message is valid");
    assert_eq!(bytes, repeated, "encoding and decoding is stable");
}

fn sealed_round_trip<M: Message>(payload: &[u8]) {
    let mut fields = Vec::with_capacity(8);
    fields.extend_from_slice(&protocol::SCHEMA_VERSION.to_le_bytes());
    fields.extend_from_slice(&M::TAG.to_le_bytes());
    fields.extend_from_slice(&(payload.len() as u32).to_le_bytes());
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&fields);
    hasher.update(payload);
    let mut bytes = b"DRFT".to_vec();
    bytes.extend_from_slice(&fields);
    bytes.extend_from_slice(&hasher.finalize().to_le_bytes());
    bytes.extend_from_slice(payload);
    round_trip::<M>(Format::Bincode, &bytes);
}

/// The bincode payloads of a JSON message, without their envelope: seeds for [`protocol_bincode`].
pub fn bincode_payloads(json: &[u8]) -> Vec<Vec<u8>> {
    let mut payloads = Vec::new();
    for_each_message!(transcode, json, &mut payloads);
    payloads
}

fn transcode<M: Message>(json: &[u8], payloads: &mut Vec<Vec<u8>>) {
    let bytes = decode::<M>(Format::Json, json).and_then(|message| encode(Format::Bincode, &message));
    payloads.extend(bytes.ok().and_then(|bytes| bytes.get(16..).map(<[u8]>::to_vec)));
}
