//! An image in a bag, read and decoded when it is needed.

use super::messages::{self, RecordedImage};
use crate::{OriginalImage, RawPixels, StoredImage};
use bags::{Bag, Place};
use ros_messages::sensor_msgs::Image;
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
    fn message(&self) -> Result<RecordedImage, ImageError> {
        messages::read_image(&self.bag, self.topic, self.place)
            .map_err(|source| ImageError::Source { name: self.name(), source: source.into() })
    }
}

impl StoredImage for BagImage {
    fn name(&self) -> String {
        format!("{}, {}, {} ns", self.bag.path().display(), self.bag.topics()[self.topic].name, self.stamp_ns)
    }

    fn read(&self) -> Result<GrayImage, ImageError> {
        match self.message()? {
            RecordedImage::Raw(image) => messages::gray(&image)
                .map_err(|source| ImageError::Source { name: self.name(), source: source.into() }),
            RecordedImage::Compressed(image) => {
                let name = format!("{} (format \"{}\")", self.name(), image.format.trim());
                messages::gray_of_compressed(&image, &name)
            }
        }
    }

    fn original(&self) -> Result<Option<OriginalImage>, ImageError> {
        Ok(Some(match self.message()? {
            RecordedImage::Compressed(image) => OriginalImage::Encoded(image.data),
            RecordedImage::Raw(Image {
                width, height, step, encoding, is_bigendian, data: bytes, ..
            }) => {
                let big_endian = is_bigendian != 0;
                OriginalImage::Raw(RawPixels { width, height, step, encoding, big_endian, bytes })
            }
        }))
    }
}
