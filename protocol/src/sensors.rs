//! Live sensors: what drivers send to a robot.
//!
//! | key | payload | attachment |
//! |---|---|---|
//! | `robot/{robot}/sensors/imu` | JSON: one [`ImuMessage`] or a list of them | none |
//! | `robot/{robot}/sensors/cam0`, `cam1` | the bytes of the image | JSON: [`ImageHeader`] |
//! | `robot/{robot}/sensors/tracks` | JSON: [`TracksMessage`] | none |
//! | `robot/{robot}/sensors/wheels` | JSON: one [`WheelMessage`] or a list of them | none |
//! | `robot/{robot}/sensors/gnss` | JSON: one [`GnssMessage`] or a list of them | none |
//!
//! Unknown fields are ignored. Lengths are checked before anything is parsed; whether stamps and values make sense is the
//! reader's to judge.
//!
//! ```
//! use protocol::sensors::{ImageHeader, decode_imu};
//!
//! let one = br#"{"stamp_ns": 5000000, "gyroscope": [0, 0, 0.1], "accelerometer": [0, 0, 9.81]}"#;
//! assert_eq!(decode_imu(one)?[0].gyroscope[2], 0.1);
//! let header = ImageHeader::decode(Some(br#"{"stamp_ns": 7, "encoding": "mono8", "width": 752, "height": 480}"#))?;
//! assert_eq!((header.stamp_ns, header.width), (7, 752));
//! # Ok::<(), protocol::sensors::SensorMessageError>(())
//! ```

use crate::features::FeatureSet;
use crate::limits::MAX_MESSAGE_BYTES;
use crate::validate::{InvalidField, Validate};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// Longest payload of a message of the IMU, of wheels or of GNSS: several thousand readings.
pub const MAX_IMU_BYTES: usize = 1 << 20;
/// Longest header of an image.
pub const MAX_HEADER_BYTES: usize = 4096;
/// Longest image: 5 megapixels in colour. Sessions drop longer messages.
pub const MAX_IMAGE_BYTES: usize = MAX_MESSAGE_BYTES;
/// Most tracks of one instant.
pub const MAX_TRACKS: usize = 20_000;

/// Why a message of a sensor cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SensorMessageError {
    /// The message is too long.
    #[error("{what} of {bytes} bytes is too long: at most {most}")]
    TooLong {
        /// What is too long.
        what: &'static str,
        /// Its bytes.
        bytes: usize,
        /// Most bytes.
        most: usize,
    },
    /// An image without a header.
    #[error(
        "the header is missing: send {{\"stamp_ns\": .., \"encoding\": ..}} as the attachment of the image"
    )]
    NoHeader,
    /// Not the JSON that is expected.
    #[error("{what} is not as documented: {source}")]
    Json {
        /// What is wrong.
        what: &'static str,
        /// Where, and how.
        source: serde_json::Error,
    },
    /// A field contradicts another, or exceeds a limit.
    #[error(transparent)]
    Field(#[from] InvalidField),
}

/// A reading of the IMU.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ImuMessage {
    /// Time on the IMU's clock, nanoseconds.
    pub stamp_ns: i64,
    /// Angular velocity in the IMU's frame, rad/s.
    pub gyroscope: [f64; 3],
    /// Specific force in the IMU's frame, m/s^2; at rest it points up.
    pub accelerometer: [f64; 3],
}

/// A reading of the wheels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct WheelMessage {
    /// Time on the IMU's clock, nanoseconds.
    pub stamp_ns: i64,
    /// Of the wheels as the base has them: rad/s, or what their encoders counted; of a steering its angle, rad.
    pub wheels: Vec<f64>,
}

/// A position by satellites.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct GnssMessage {
    /// Time on the IMU's clock, nanoseconds.
    pub stamp_ns: i64,
    /// x, y, z in the frame of the map, metres; or latitude, longitude (deg) and altitude (m), where the robot has an origin.
    pub position: [f64; 3],
    /// Its standard deviations along the axes, metres, where the receiver states them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigma: Option<[f64; 3]>,
}

/// What the bytes of an image are.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ImageHeader {
    /// Time of exposure on the camera's clock, nanoseconds.
    pub stamp_ns: i64,
    /// `jpeg`, `png`, or the format of raw pixels: `mono8`, `rgb8`, `bgr8` ...
    pub encoding: String,
    /// Columns; not needed for `jpeg` and `png`.
    #[serde(default)]
    pub width: u32,
    /// Rows; not needed for `jpeg` and `png`.
    #[serde(default)]
    pub height: u32,
    /// Bytes from the begin of a row to that of the next; without gaps where it is not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub step: Option<u32>,
}

/// What a front end that runs elsewhere made of the images of one instant.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TracksMessage {
    /// Time of exposure on the camera's clock, nanoseconds.
    pub stamp_ns: i64,
    /// Tracked points `[camera, feature, u, v]`, those of camera 0 first; pixels are distorted, as measured.
    pub tracks: Vec<(u8, u64, f64, f64)>,
    /// Features of the image of camera 0 for place recognition.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub features: Option<FeatureSet>,
}

/// Reads the payload of an IMU message.
///
/// # Errors
/// [`SensorMessageError`]: too long, or not as documented (NaN is not JSON).
pub fn decode_imu(payload: &[u8]) -> Result<Vec<ImuMessage>, SensorMessageError> {
    one_or_more("the message of the IMU", payload)
}

/// Reads the payload of a message of the wheels.
///
/// # Errors
/// [`SensorMessageError`]: too long, or not as documented (NaN is not JSON).
///
/// ```
/// use protocol::sensors::decode_wheels;
/// let both = br#"[{"stamp_ns": 5000000, "wheels": [7.5, 7.6]}, {"stamp_ns": 25000000, "wheels": [7.4, 7.6]}]"#;
/// assert_eq!(decode_wheels(both)?[1].wheels, [7.4, 7.6]);
/// # Ok::<(), protocol::sensors::SensorMessageError>(())
/// ```
pub fn decode_wheels(payload: &[u8]) -> Result<Vec<WheelMessage>, SensorMessageError> {
    one_or_more("the message of the wheels", payload)
}

/// Reads the payload of a message of GNSS.
///
/// # Errors
/// [`SensorMessageError`]: too long, or not as documented (NaN is not JSON).
///
/// ```
/// use protocol::sensors::decode_gnss;
/// let one = br#"{"stamp_ns": 5000000, "position": [48.26, 11.67, 520.0], "sigma": [0.5, 0.5, 1.0]}"#;
/// assert_eq!(decode_gnss(one)?[0].sigma, Some([0.5, 0.5, 1.0]));
/// # Ok::<(), protocol::sensors::SensorMessageError>(())
/// ```
pub fn decode_gnss(payload: &[u8]) -> Result<Vec<GnssMessage>, SensorMessageError> {
    one_or_more("the message of GNSS", payload)
}

/// A reading, or a list of them.
fn one_or_more<T: DeserializeOwned>(
    what: &'static str,
    payload: &[u8],
) -> Result<Vec<T>, SensorMessageError> {
    let is_list = payload.iter().find(|byte| !byte.is_ascii_whitespace()) == Some(&b'[');
    if is_list {
        json(what, payload, MAX_IMU_BYTES)
    } else {
        json(what, payload, MAX_IMU_BYTES).map(|reading| vec![reading])
    }
}

impl ImageHeader {
    /// Reads the attachment of an image.
    ///
    /// # Errors
    /// [`SensorMessageError`]: none, too long, or not as documented.
    pub fn decode(attachment: Option<&[u8]>) -> Result<Self, SensorMessageError> {
        json("the header of an image", attachment.ok_or(SensorMessageError::NoHeader)?, MAX_HEADER_BYTES)
    }
}

impl TracksMessage {
    /// Reads the payload of a message of tracks.
    ///
    /// # Errors
    /// [`SensorMessageError`]: too long, not as documented, too many tracks, pixels that are not finite, features that
    /// contradict themselves.
    pub fn decode(payload: &[u8]) -> Result<Self, SensorMessageError> {
        let message: Self = json("the message of tracks", payload, MAX_MESSAGE_BYTES)?;
        if message.tracks.len() > MAX_TRACKS {
            return Err(InvalidField::new("tracks", format!("holds more than {MAX_TRACKS}")).into());
        }
        if !message.tracks.iter().all(|(_, _, u, v)| u.is_finite() && v.is_finite()) {
            return Err(InvalidField::new("tracks", "holds a pixel that is not finite").into());
        }
        if let Some(features) = &message.features {
            features.validate()?;
        }
        Ok(message)
    }
}

/// Checks the length of the bytes of an image.
///
/// # Errors
/// [`SensorMessageError::TooLong`].
pub fn check_image_length(bytes: usize) -> Result<(), SensorMessageError> {
    check_length("an image", bytes, MAX_IMAGE_BYTES)
}

fn check_length(what: &'static str, bytes: usize, most: usize) -> Result<(), SensorMessageError> {
    if bytes > most { Err(SensorMessageError::TooLong { what, bytes, most }) } else { Ok(()) }
}

fn json<T: DeserializeOwned>(what: &'static str, bytes: &[u8], most: usize) -> Result<T, SensorMessageError> {
    check_length(what, bytes.len(), most)?;
    serde_json::from_slice(bytes).map_err(|source| SensorMessageError::Json { what, source })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{DescriptorKind, Descriptors};
    use proptest::prelude::*;

    fn imu() -> impl Strategy<Value = ImuMessage> {
        let vector = || prop::array::uniform3(-1e3..1e3);
        (any::<i64>(), vector(), vector()).prop_map(|(stamp_ns, gyroscope, accelerometer)| ImuMessage {
            stamp_ns,
            gyroscope,
            accelerometer,
        })
    }

    proptest! {
        #[test]
        fn what_is_written_is_read_to_the_last_bit(readings in prop::collection::vec(imu(), 0..20)) {
            prop_assert_eq!(&decode_imu(&serde_json::to_vec(&readings)?)?, &readings);
            for reading in readings {
                prop_assert_eq!(decode_imu(&serde_json::to_vec(&reading)?)?, vec![reading]);
            }
        }

        #[test]
        fn any_bytes_are_a_message_or_an_error(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let _ = decode_imu(&bytes);
            let _ = decode_wheels(&bytes);
            let _ = decode_gnss(&bytes);
            let _ = ImageHeader::decode(Some(&bytes));
            let _ = TracksMessage::decode(&bytes);
        }

        #[test]
        fn a_damaged_message_is_a_message_or_an_error(at in 0usize..1000, byte: u8, length in 0usize..1000) {
            let mut bytes = serde_json::to_vec(&tracks())?;
            let (at, length) = (at % bytes.len(), length % bytes.len());
            prop_assert!(TracksMessage::decode(&bytes[..length]).is_err());
            bytes[at] = byte;
            let _ = TracksMessage::decode(&bytes);
        }
    }

    fn tracks() -> TracksMessage {
        TracksMessage {
            stamp_ns: 7,
            tracks: vec![(0, 1, 2.5, 3.5), (1, u64::MAX, 0.0, 479.0)],
            features: Some(FeatureSet {
                pixels: vec![[1.0, 2.0]],
                descriptors: Descriptors { kind: DescriptorKind::Binary, width: 2, bytes: vec![1, 255] },
                extractor: String::new(),
            }),
        }
    }

    #[test]
    fn tracks_are_read_as_written_and_checked() {
        let bytes = serde_json::to_vec(&tracks()).unwrap();
        assert_eq!(TracksMessage::decode(&bytes).unwrap(), tracks());
        let mut lame = tracks();
        lame.features.as_mut().unwrap().pixels.clear();
        assert!(TracksMessage::decode(&serde_json::to_vec(&lame).unwrap()).is_err());
    }

    #[test]
    fn errors_name_what_is_missing_or_too_long() {
        let text = |error: SensorMessageError| error.to_string();
        assert!(text(ImageHeader::decode(None).unwrap_err()).contains("attachment"));
        assert!(
            text(ImageHeader::decode(Some(b"{\"encoding\": \"jpeg\"}")).unwrap_err()).contains("stamp_ns")
        );
        assert!(text(decode_imu(&vec![b' '; MAX_IMU_BYTES + 1]).unwrap_err()).contains("too long"));
        assert!(
            text(decode_imu(b"{\"stamp_ns\": 1, \"gyroscope\": [0, 0, NaN]}").unwrap_err()).contains("IMU")
        );
        assert!(check_image_length(MAX_IMAGE_BYTES + 1).is_err() && check_image_length(1).is_ok());
    }
}
