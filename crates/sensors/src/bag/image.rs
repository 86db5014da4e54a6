//! An image in a bag, read and decoded when it is needed.

use super::messages::{self, RecordedImage};
use crate::StoredImage;
use bags::{Bag, Place};
use std::sync::Arc;
use vision::{GrayImage, ImageError};

#[derive(Clone, Debug)]
pub(super) struct BagImage {
    pub(super) bag: Arc<Bag>,
    pub(super) topic: usize,
    pub(super) stamp_ns: i64,
    pub(super) place: Place,
}

impl StoredImage for BagImage {
    fn name(&self) -> String {
        format!("{}, {}, {} ns", self.bag.path().display(), self.bag.topics()[self.topic].name, self.stamp_ns)
    }

    fn read(&self) -> Result<GrayImage, ImageError> {
        let of_source = |source| ImageError::Source { name: self.name(), source };
        match messages::read_image(&self.bag, self.topic, self.place)
            .map_err(|error| of_source(error.into()))?
        {
            RecordedImage::Raw(image) => messages::gray(&image).map_err(|error| of_source(error.into())),
            RecordedImage::Compressed(image) => {
                let name = format!("{} (format \"{}\")", self.name(), image.format.trim());
                messages::gray_of_compressed(&image, &name)
            }
        }
    }
}
