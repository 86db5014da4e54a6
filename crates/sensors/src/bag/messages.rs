//! Messages of a bag: of ROS 1, ROS 2, and Foxglove's images.

use super::foxglove::{self, FoxgloveError};
use super::topics::{COMPRESSED_IMAGE, IMAGES, JOINT_STATE, NAV_SAT_FIX, ODOMETRY};
use bags::{Bag, BagError, Encoding, Place};
use ros_messages::nav_msgs::Odometry;
use ros_messages::sensor_msgs::{CompressedImage, Image, Imu, JointState, NavSatFix};
use ros_messages::{CdrError, RosMessage, decode, ros1};
use std::path::Path;
use vision::{GrayImage, ImageError, RawImage};

/// Bytes that hold the stamp of a header, in either encoding.
const STAMP_BYTES: usize = 12;

/// A topic whose first messages are all of no use is of none.
const TRIED: usize = 5;

/// Why a message is of no use.
#[derive(Debug, thiserror::Error)]
pub(super) enum MessageError {
    #[error(transparent)]
    Bag(#[from] BagError),
    #[error(transparent)]
    Cdr(#[from] CdrError),
    #[error(transparent)]
    Ros1(#[from] ros1::Ros1Error),
    #[error(transparent)]
    Foxglove(#[from] FoxgloveError),
    #[error("encoding \"{0}\" is unknown: ROS 1 and CDR are read; convert the recording with its own tools")]
    Encoding(String),
}

/// Reads a message.
pub(super) fn read<M: RosMessage>(bag: &Bag, topic: usize, place: Place) -> Result<M, MessageError> {
    let bytes = bag.read(place)?;
    Ok(match &bag.topics()[topic].encoding {
        Encoding::Ros1 => ros1::decode(&bytes)?,
        Encoding::Cdr => decode(&bytes)?,
        other => return Err(MessageError::Encoding(other.to_string())),
    })
}

/// An image as it is recorded.
pub(super) enum RecordedImage {
    Raw(Image),
    Compressed(CompressedImage),
}

/// Reads an image of any type.
pub(super) fn read_image(bag: &Bag, topic: usize, place: Place) -> Result<RecordedImage, MessageError> {
    let of = &bag.topics()[topic];
    Ok(match of.type_name.as_str() {
        foxglove::RAW_IMAGE => RecordedImage::Raw(foxglove::raw_image(&bag.read(place)?, &of.encoding)?),
        foxglove::COMPRESSED_IMAGE => {
            RecordedImage::Compressed(foxglove::compressed_image(&bag.read(place)?, &of.encoding)?)
        }
        COMPRESSED_IMAGE => RecordedImage::Compressed(read(bag, topic, place)?),
        _ => RecordedImage::Raw(read(bag, topic, place)?),
    })
}

/// Why a topic cannot be read: what is wrong with each of its first messages.
pub(super) fn unreadable(bag: &Bag, topic: usize) -> Option<MessageError> {
    let mut why = None;
    for message in bag.topics()[topic].messages.iter().take(TRIED) {
        let place = message.place;
        let read = match bag.topics()[topic].type_name.as_str() {
            image if IMAGES.contains(&image) => read_image(bag, topic, place).map(drop),
            ODOMETRY => read::<Odometry>(bag, topic, place).map(drop),
            JOINT_STATE => read::<JointState>(bag, topic, place).map(drop),
            NAV_SAT_FIX => read::<NavSatFix>(bag, topic, place).map(drop),
            _ => read::<Imu>(bag, topic, place).map(drop),
        };
        match read {
            Ok(()) => return None,
            Err(error) => why = why.or(Some(error)),
        }
    }
    why
}

/// The first sound message of a topic.
pub(super) fn first<M: RosMessage>(bag: &Bag, topic: usize) -> Option<M> {
    let mut messages = bag.topics()[topic].messages.iter();
    messages.find_map(|message| read(bag, topic, message.place).ok())
}

/// Time stamp of a reading or an image, nanoseconds: of messages of ROS that of the header with which they begin, without
/// reading the rest.
pub(super) fn read_stamp(bag: &Bag, topic: usize, place: Place) -> Option<i64> {
    let of = &bag.topics()[topic];
    if foxglove::is_image(&of.type_name) {
        return foxglove::stamp_ns(&bag.read(place).ok()?, &of.encoding).ok();
    }
    let start: [u8; STAMP_BYTES] = bag.read_start(place, STAMP_BYTES).ok()?.try_into().ok()?;
    // ROS 1: sequence number, seconds, nanoseconds. CDR: its own header, the second byte of which is the byte order.
    let [_, order, .., s0, s1, s2, s3, n0, n1, n2, n3] = start;
    let (seconds, nanoseconds) = ([s0, s1, s2, s3], [n0, n1, n2, n3]);
    let is_big_endian = match &of.encoding {
        Encoding::Ros1 => false,
        Encoding::Cdr => order == 0,
        _ => return None,
    };
    let (seconds, nanoseconds) = if is_big_endian {
        (i32::from_be_bytes(seconds), u32::from_be_bytes(nanoseconds))
    } else {
        (i32::from_le_bytes(seconds), u32::from_le_bytes(nanoseconds))
    };
    Some(i64::from(seconds) * 1_000_000_000 + i64::from(nanoseconds))
}

/// The grey image of a `sensor_msgs/Image`.
pub(super) fn gray(image: &Image) -> Result<GrayImage, ImageError> {
    let raw = RawImage {
        encoding: &image.encoding,
        width: image.width,
        height: image.height,
        step: image.step,
        big_endian: image.is_bigendian != 0,
        data: &image.data,
    };
    raw.to_gray()
}

/// The grey image of a `sensor_msgs/CompressedImage`. `name`: what it is called in errors.
pub(super) fn gray_of_compressed(image: &CompressedImage, name: &str) -> Result<GrayImage, ImageError> {
    GrayImage::decode(&image.data).map_err(|error| error.of(Path::new(name)))
}
