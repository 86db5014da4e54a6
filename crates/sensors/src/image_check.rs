//! Whether the images of a recording have the size that the calibration states.

use super::{CameraSensor, Frame, ImageData, SequenceError};

/// Checks the first image of each camera, of files from their headers.
#[derive(Debug, Default)]
pub(crate) struct ImageCheck {
    is_checked: [bool; 2],
}

impl ImageCheck {
    /// # Errors
    /// [`SequenceError::ImageSize`]. An image that cannot be read is left to its reader.
    pub(crate) fn add(&mut self, frame: &Frame, cameras: &[CameraSensor]) -> Result<(), SequenceError> {
        for (index, sensor) in cameras.iter().enumerate().take(2) {
            let Some(image) = frame.images[index].as_ref() else { continue };
            if self.is_checked[index] {
                continue;
            }
            if let Ok(size) = image.size() {
                self.is_checked[index] = true;
                check_size(image, size, (sensor.camera.width, sensor.camera.height), index)?;
            }
        }
        Ok(())
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
