//! Whether the images of a recording have the size that the calibration states.

use super::{CameraSensor, Frame, ImageData, SequenceError};
use std::collections::{BTreeMap, BTreeSet};
use vision::ImageError;

/// So many first images of a camera in a bag that are all of no use are no accident.
const UNUSABLE: usize = 5;

/// Checks the first image of each camera, of files from their headers.
#[derive(Debug, Default)]
pub(crate) struct ImageCheck {
    /// Cameras whose size is known to be right.
    checked: BTreeSet<usize>,
    /// Images of each camera so far that are of an unknown encoding.
    unusable: BTreeMap<usize, usize>,
}

impl ImageCheck {
    /// # Errors
    /// [`SequenceError::ImageSize`]; [`SequenceError::UnusableImages`] where the first ones of a bag are of an unknown encoding.
    /// A single image that cannot be read is left to its reader.
    pub(crate) fn add(&mut self, frame: &Frame, cameras: &[CameraSensor]) -> Result<(), SequenceError> {
        for (&index, image) in &frame.images {
            let Some(sensor) = cameras.get(index).filter(|_| !self.checked.contains(&index)) else {
                continue;
            };
            match image.size() {
                Ok(size) => {
                    self.checked.insert(index);
                    check_size(image, size, (sensor.camera.width, sensor.camera.height), index)?;
                }
                Err(source) if matches!(image, ImageData::Stored(_)) && is_of_unknown_format(&source) => {
                    let unusable = self.unusable.entry(index).or_default();
                    *unusable += 1;
                    if *unusable == UNUSABLE {
                        return Err(SequenceError::UnusableImages { camera: index, source });
                    }
                }
                Err(_) => {}
            }
        }
        Ok(())
    }
}

/// Whether the pixels are the cause, and not a file that is damaged there.
fn is_of_unknown_format(error: &ImageError) -> bool {
    match error {
        ImageError::Format { .. }
        | ImageError::ByteOrder { .. }
        | ImageError::Raw { .. }
        | ImageError::Unreadable { .. } => true,
        ImageError::Source { source, .. } => {
            source.downcast_ref::<ImageError>().is_some_and(is_of_unknown_format)
        }
        _ => false,
    }
}

fn check_size(
    image: &ImageData,
    size: (u32, u32),
    calibrated: (u32, u32),
    camera: usize,
) -> Result<(), SequenceError> {
    if size == calibrated {
        return Ok(());
    }
    Err(SequenceError::ImageSize { path: image.to_string().into(), size, calibrated, camera })
}
