//! Features of images: read from the recording where it has them, extracted where it has images.

use std::borrow::Cow;

use geometry::camera::Camera;
use nalgebra::Vector2;
use protocol::FeatureSet;
use sensors::{Frame, ImageData, Sequence};
use vision::{FeatureExtractor, GrayImage, ImageFeatures};

use super::camera::MappingCamera;
use super::error::BuildError;
use super::stereo_matching::match_stereo;
use sensors::feature_set;

/// How features are extracted from images.
pub struct Extraction<'a> {
    /// Detects and describes features.
    pub extractor: &'a mut dyn FeatureExtractor,
    /// Most features an image.
    pub max_features: usize,
    /// Zero where images of camera 0 show the robot itself: no features there.
    pub mask: Option<&'a GrayImage>,
    /// Whether camera 1 is used too.
    pub stereo: bool,
}

/// Where the features of frames come from.
pub(super) struct FeatureSource<'e, 'r> {
    extraction: Option<Extraction<'e>>,
    cameras: &'r [MappingCamera],
    /// Images that could not be read, with the reason.
    pub(super) unreadable: Vec<String>,
}

/// The features of a frame.
pub(super) struct FrameFeatures<'a> {
    /// Camera 0.
    pub(super) features: Cow<'a, FeatureSet>,
    /// Pixel of each of them in camera 1, where it is matched there; empty without stereo.
    pub(super) stereo: Vec<Option<Vector2<f64>>>,
}

impl<'e, 'r> FeatureSource<'e, 'r> {
    /// Features from the recording, or with `extraction` from its images.
    pub(super) fn new(
        extraction: Option<Extraction<'e>>,
        cameras: &'r [MappingCamera],
    ) -> FeatureSource<'e, 'r> {
        FeatureSource { extraction, cameras, unreadable: Vec::new() }
    }

    /// Whether a frame can have features.
    pub(super) fn has_features(&self, frame: &Frame) -> bool {
        match &self.extraction {
            Some(_) => frame.images[0].is_some(),
            None => frame.features.as_ref().is_some_and(|features| !features.is_empty()),
        }
    }

    /// The error for a recording without features.
    pub(super) fn no_features(&self, sequence: &Sequence) -> BuildError {
        let sequence = sequence.root.display().to_string();
        match self.extraction {
            Some(_) => BuildError::NoImages { sequence },
            None => BuildError::NoFeatures { sequence },
        }
    }

    /// The features of camera 0; `None` where its image cannot be read, which is recorded in `unreadable`.
    ///
    /// # Errors
    /// [`BuildError::Extraction`], [`BuildError::ImageSize`].
    pub(super) fn features_of<'f>(
        &mut self,
        frame: &'f Frame,
    ) -> Result<Option<Cow<'f, FeatureSet>>, BuildError> {
        if self.extraction.is_none() {
            return Ok(frame.features.as_ref().map(Cow::Borrowed));
        }
        Ok(self.extract(frame, 0)?.map(|features| Cow::Owned(self.named(features))))
    }

    /// The features of camera 0 and where camera 1 sees them; `None` as in [`FeatureSource::features_of`].
    ///
    /// # Errors
    /// [`BuildError::Extraction`], [`BuildError::ImageSize`].
    pub(super) fn stereo_features_of<'f>(
        &mut self,
        frame: &'f Frame,
    ) -> Result<Option<FrameFeatures<'f>>, BuildError> {
        let is_stereo = self.extraction.as_ref().is_some_and(|extraction| extraction.stereo);
        if !is_stereo || self.cameras.len() < 2 {
            let features = self.features_of(frame)?;
            return Ok(features.map(|features| FrameFeatures { features, stereo: Vec::new() }));
        }
        let Some(first) = self.extract(frame, 0)? else { return Ok(None) };
        let stereo = self
            .extract(frame, 1)?
            .map_or_else(Vec::new, |second| match_stereo(self.cameras, &first, &second));
        Ok(Some(FrameFeatures { features: Cow::Owned(self.named(first)), stereo }))
    }

    fn named(&self, features: ImageFeatures) -> FeatureSet {
        let name = self.extraction.as_ref().map_or("", |extraction| extraction.extractor.name());
        feature_set(name, features)
    }

    /// Extracts the features of one camera; `None` without an image that can be read.
    fn extract(&mut self, frame: &Frame, camera: usize) -> Result<Option<ImageFeatures>, BuildError> {
        let (Some(extraction), Some(file)) = (&mut self.extraction, &frame.images[camera]) else {
            return Ok(None);
        };
        let image = match file.read() {
            Ok(image) => image,
            Err(error) => {
                self.unreadable.push(error.to_string());
                return Ok(None);
            }
        };
        check_size(camera, file, &image, &self.cameras[camera].camera)?;
        let mask = extraction.mask.filter(|_| camera == 0);
        extraction
            .extractor
            .extract(&image, mask, extraction.max_features)
            .map(Some)
            .map_err(|source| BuildError::Extraction { image: file.to_string(), source })
    }
}

/// Checks that an image has the size of its camera.
fn check_size(index: usize, file: &ImageData, image: &GrayImage, camera: &Camera) -> Result<(), BuildError> {
    let size = (image.width(), image.height());
    let calibrated = (camera.width as usize, camera.height as usize);
    if size == calibrated {
        return Ok(());
    }
    Err(BuildError::ImageSize { image: file.to_string(), size, calibrated, camera: index })
}
