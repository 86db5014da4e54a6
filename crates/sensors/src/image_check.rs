//! Whether the images of a recording have the size that the calibration states.

use super::{CameraSensor, Frame, ImageData, SequenceError};
use std::path::Path;
use vision::GrayImage;

/// Checks the first image of each camera, from the headers of the files.
#[derive(Debug, Default)]
pub(crate) struct ImageCheck {
    is_checked: [bool; 2],
}

impl ImageCheck {
    /// # Errors
    /// [`SequenceError::ImageSize`]. An image that cannot be read is left to its reader.
    pub(crate) fn add(&mut self, frame: &Frame, cameras: &[CameraSensor]) -> Result<(), SequenceError> {
        for (index, sensor) in cameras.iter().enumerate().take(2) {
            let Some(file) = frame.images[index].as_ref().and_then(ImageData::path) else { continue };
            if self.is_checked[index] {
                continue;
            }
            if let Ok(size) = GrayImage::size_of_file(file) {
                self.is_checked[index] = true;
                check_size(file, size, (sensor.camera.width, sensor.camera.height), index)?;
            }
        }
        Ok(())
    }
}

fn check_size(
    file: &Path,
    size: (u32, u32),
    calibrated: (u32, u32),
    camera: usize,
) -> Result<(), SequenceError> {
    if size == calibrated {
        return Ok(());
    }
    Err(SequenceError::ImageSize { path: file.to_path_buf(), size, calibrated, camera })
}
