//! An image in a bag, read and decoded when it is needed.

use super::messages;
use super::topics::COMPRESSED_IMAGE;
use crate::StoredImage;
use bags::{Bag, Place};
use ros_messages::RosMessage;
use ros_messages::sensor_msgs::CompressedImage;
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
        if self.bag.topics()[self.topic].type_name == COMPRESSED_IMAGE {
            let message: CompressedImage = self.message()?;
            let name = format!("{} (format \"{}\")", self.name(), message.format.trim());
            return messages::gray_of_compressed(&message, &name);
        }
        messages::gray(&self.message()?)
            .map_err(|source| ImageError::Source { name: self.name(), source: source.into() })
    }
}
