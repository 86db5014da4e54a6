//! An image in a bag, read and decoded when it is needed.

use super::messages;
use super::topics::COMPRESSED_IMAGE;
use crate::{OriginalImage, RawPixels, StoredImage};
use bags::{Bag, Place};
use ros_messages::RosMessage;
use ros_messages::sensor_msgs::{CompressedImage, Image};
use std::sync::Arc;
use vision::{GrayImage, ImageError};

#[derive(Clone, Debug)]
pub(super) struct BagImage {
    pub(super) bag: Arc<Bag>,
    pub(super) topic: usize,
    pub(super) stamp_ns: i64,
    pub(super) place: Place,
}

impl BagImage {
    fn is_compressed(&self) -> bool {
        self.bag.topics()[self.topic].type_name == COMPRESSED_IMAGE
    }

    fn message<M: RosMessage>(&self) -> Result<M, ImageError> {
        messages::read(&self.bag, self.topic, self.place)
            .map_err(|source| ImageError::Source { name: self.name(), source: source.into() })
    }
}

impl StoredImage for BagImage {
    fn name(&self) -> String {
        format!("{}, {}, {} ns", self.bag.path().display(), self.bag.topics()[self.topic].name, self.stamp_ns)
    }

    fn read(&self) -> Result<GrayImage, ImageError> {
        if self.is_compressed() {
            let message: CompressedImage = self.message()?;
            let name = format!("{} (format \"{}\")", self.name(), message.format.trim());
            return messages::gray_of_compressed(&message, &name);
        }
        messages::gray(&self.message()?)
            .map_err(|source| ImageError::Source { name: self.name(), source: source.into() })
    }

    fn original(&self) -> Result<Option<OriginalImage>, ImageError> {
        if self.is_compressed() {
            let CompressedImage { data, .. } = self.message()?;
            return Ok(Some(OriginalImage::Encoded(data)));
        }
        let Image { width, height, step, encoding, is_bigendian, data: bytes, .. } = self.message()?;
        let big_endian = is_bigendian != 0;
        let raw = RawPixels { width, height, step, encoding, big_endian, bytes };
        Ok(Some(OriginalImage::Raw(raw)))
    }
}
