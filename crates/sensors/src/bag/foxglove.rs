//! Images of Foxglove's own types, in protobuf and in JSON, as the messages of ROS that hold the same.
//!
//! The fields are those of the schemas at <https://docs.foxglove.dev/docs/sdk/schemas>.

use bags::Encoding;
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use prost::Message;
use ros_messages::builtin_interfaces::Time;
use ros_messages::sensor_msgs::{CompressedImage, Image};
use ros_messages::std_msgs::Header;
use serde::{Deserialize, Deserializer};

/// Type of images as pixels by rows.
pub(super) const RAW_IMAGE: &str = "foxglove.RawImage";
/// Type of images as files.
pub(super) const COMPRESSED_IMAGE: &str = "foxglove.CompressedImage";

/// Why bytes are not a message of one of these types.
#[derive(Debug, thiserror::Error)]
pub(super) enum FoxgloveError {
    #[error("not the protobuf message that its type names: {0}")]
    Protobuf(#[from] prost::DecodeError),
    #[error("not the JSON that its type names: {0}")]
    Json(#[from] serde_json::Error),
    #[error("encoding \"{0}\" is not read for this type: protobuf and JSON are")]
    Encoding(String),
    #[error("its timestamp is out of range")]
    Timestamp,
}

/// `google.protobuf.Timestamp`; in JSON `sec` and `nsec`.
#[derive(Clone, Copy, PartialEq, Message, Deserialize)]
struct Timestamp {
    #[prost(int64, tag = "1")]
    #[serde(rename = "sec")]
    seconds: i64,
    #[prost(int32, tag = "2")]
    #[serde(rename = "nsec")]
    nanoseconds: i32,
}

/// What both types begin with.
#[derive(Clone, PartialEq, Message, Deserialize)]
struct Stamped {
    #[prost(message, optional, tag = "1")]
    timestamp: Option<Timestamp>,
}

#[derive(Clone, PartialEq, Message, Deserialize)]
struct Raw {
    #[prost(message, optional, tag = "1")]
    timestamp: Option<Timestamp>,
    #[prost(fixed32, tag = "2")]
    width: u32,
    #[prost(fixed32, tag = "3")]
    height: u32,
    #[prost(string, tag = "4")]
    encoding: String,
    #[prost(fixed32, tag = "5")]
    step: u32,
    #[prost(bytes = "vec", tag = "6")]
    #[serde(deserialize_with = "base64_bytes")]
    data: Vec<u8>,
    #[prost(string, tag = "7")]
    #[serde(default)]
    frame_id: String,
}

#[derive(Clone, PartialEq, Message, Deserialize)]
struct Compressed {
    #[prost(message, optional, tag = "1")]
    timestamp: Option<Timestamp>,
    #[prost(bytes = "vec", tag = "2")]
    #[serde(deserialize_with = "base64_bytes")]
    data: Vec<u8>,
    #[prost(string, tag = "3")]
    format: String,
    #[prost(string, tag = "4")]
    #[serde(default)]
    frame_id: String,
}

/// Whether a type is one of these.
pub(super) fn is_image(type_name: &str) -> bool {
    matches!(type_name, RAW_IMAGE | COMPRESSED_IMAGE)
}

/// Time of an image, nanoseconds.
pub(super) fn stamp_ns(bytes: &[u8], encoding: &Encoding) -> Result<i64, FoxgloveError> {
    let stamp = decode::<Stamped>(bytes, encoding)?.timestamp.unwrap_or_default();
    let whole_ns = stamp.seconds.checked_mul(1_000_000_000).ok_or(FoxgloveError::Timestamp)?;
    whole_ns.checked_add(stamp.nanoseconds.into()).ok_or(FoxgloveError::Timestamp)
}

/// An image of type [`RAW_IMAGE`]. Channels of more than a byte are little endian.
pub(super) fn raw_image(bytes: &[u8], encoding: &Encoding) -> Result<Image, FoxgloveError> {
    let Raw { timestamp, width, height, encoding, step, data, frame_id } = decode(bytes, encoding)?;
    let header = header(timestamp, frame_id)?;
    Ok(Image { header, height, width, encoding, is_bigendian: 0, step, data })
}

/// An image of type [`COMPRESSED_IMAGE`].
pub(super) fn compressed_image(bytes: &[u8], encoding: &Encoding) -> Result<CompressedImage, FoxgloveError> {
    let Compressed { timestamp, data, format, frame_id } = decode(bytes, encoding)?;
    Ok(CompressedImage { header: header(timestamp, frame_id)?, format, data })
}

fn header(timestamp: Option<Timestamp>, frame_id: String) -> Result<Header, FoxgloveError> {
    let Timestamp { seconds, nanoseconds } = timestamp.unwrap_or_default();
    let sec = seconds.try_into().map_err(|_| FoxgloveError::Timestamp)?;
    let nanosec = nanoseconds.try_into().map_err(|_| FoxgloveError::Timestamp)?;
    Ok(Header { stamp: Time { sec, nanosec }, frame_id })
}

fn decode<M>(bytes: &[u8], encoding: &Encoding) -> Result<M, FoxgloveError>
where
    M: Message + Default + for<'de> Deserialize<'de>,
{
    match encoding.to_string().as_str() {
        "protobuf" => Ok(M::decode(bytes)?),
        "json" => Ok(serde_json::from_slice(bytes)?),
        other => Err(FoxgloveError::Encoding(other.to_owned())),
    }
}

/// Bytes as JSON has them: text in base64.
fn base64_bytes<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<u8>, D::Error> {
    let text = std::borrow::Cow::<str>::deserialize(deserializer)?;
    BASE64_STANDARD.decode(text.as_bytes()).map_err(serde::de::Error::custom)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_encodings_say_the_same() {
        let timestamp = Some(Timestamp { seconds: 1_700_000_000, nanoseconds: 5 });
        let data = vec![1, 2, 3, 4, 5, 6];
        let raw = Raw {
            timestamp,
            width: 3,
            height: 2,
            encoding: "mono8".into(),
            step: 3,
            data: data.clone(),
            frame_id: "cam0".into(),
        };
        let of_protobuf = raw_image(&raw.encode_to_vec(), &Encoding::Other("protobuf".into())).unwrap();
        let text =
            br#"{"timestamp": {"sec": 1700000000, "nsec": 5}, "frame_id": "cam0", "width": 3, "height": 2,
            "encoding": "mono8", "step": 3, "data": "AQIDBAUG"}"#;
        let json = Encoding::Other("json".into());
        assert_eq!(of_protobuf, raw_image(text, &json).unwrap());
        assert_eq!((of_protobuf.width, of_protobuf.height, of_protobuf.data), (3, 2, data));
        assert_eq!(stamp_ns(text, &json).unwrap(), 1_700_000_000_000_000_005);
        assert_eq!(of_protobuf.header.stamp.to_nanoseconds(), 1_700_000_000_000_000_005);
    }

    #[test]
    fn bytes_that_protobuf_prescribes_are_read() {
        // Field 1, two bytes long: seconds 1; field 2: data; field 3: format.
        let bytes = [0x0a, 2, 0x08, 1, 0x12, 2, 0xff, 0xd8, 0x1a, 4, b'j', b'p', b'e', b'g'];
        let image = compressed_image(&bytes, &Encoding::Other("protobuf".into())).unwrap();
        assert_eq!((image.format.as_str(), image.data.as_slice()), ("jpeg", &[0xff, 0xd8][..]));
        assert_eq!(image.header.stamp.to_nanoseconds(), 1_000_000_000);
    }

    #[test]
    fn what_is_cut_off_or_of_another_encoding_is_refused() {
        let protobuf = Encoding::Other("protobuf".into());
        assert!(compressed_image(&[0x12, 9, 0], &protobuf).is_err());
        assert!(compressed_image(b"{}", &Encoding::Other("json".into())).is_err());
        let error = raw_image(&[], &Encoding::Other("flatbuffer".into())).unwrap_err().to_string();
        assert!(error.contains("flatbuffer"), "{error}");
    }
}
