//! Features of images: read from the recording where it has them, extracted where it has images.

use std::borrow::Cow;

use nalgebra::Vector2;
use protocol::FeatureSet;
use sensors::{Frame, ImageData, Sequence};
use vision::{FeatureExtractor, GrayImage};

use super::options::BuildError;
use super::point::Lens;
use super::stereo::match_stereo;
use sensors::feature_set;

/// How images are looked at.
pub struct Extraction<'a> {
    /// Finds and describes features.
    pub extractor: &'a mut dyn FeatureExtractor,
    /// Most features an image.
    pub max_features: usize,
    /// Zero where nothing is to be seen in images of camera 0 (the robot itself).
    pub mask: Option<&'a GrayImage>,
    /// Whether camera 1 is used too.
    pub stereo: bool,
}

/// Where the features of frames come from.
pub(super) struct FeatureSource<'e, 'r> {
    extraction: Option<Extraction<'e>>,
    rig: &'r [Lens],
    /// Images that could not be read, with the reason.
    pub(super) unreadable: Vec<String>,
}

/// What is seen in a frame.
pub(super) struct Seen<'a> {
    /// Camera 0.
    pub(super) features: Cow<'a, FeatureSet>,
    /// Where camera 1 sees each of them; empty without stereo.
    pub(super) stereo: Vec<Option<Vector2<f64>>>,
}

impl<'e, 'r> FeatureSource<'e, 'r> {
    /// Features from the recording, or from its images where there is something to extract them with.
    pub(super) fn new(extraction: Option<Extraction<'e>>, rig: &'r [Lens]) -> FeatureSource<'e, 'r> {
        FeatureSource { extraction, rig, unreadable: Vec::new() }
    }

    /// Whether a frame can have features.
    pub(super) fn can_see(&self, frame: &Frame) -> bool {
        match &self.extraction {
            Some(_) => frame.images[0].is_some(),
            None => frame.features.as_ref().is_some_and(|features| !features.is_empty()),
        }
    }

    /// The error of a recording without any.
    pub(super) fn no_features(&self, sequence: &Sequence) -> BuildError {
        let sequence = sequence.root.display().to_string();
        match self.extraction {
            Some(_) => BuildError::NoImages { sequence },
            None => BuildError::NoFeatures { sequence },
        }
    }

    /// The features of a frame; `None` where its image cannot be read, which is noted.
    ///
    /// # Errors
    /// [`BuildError::Extraction`].
    pub(super) fn look<'f>(&mut self, frame: &'f Frame) -> Result<Option<Seen<'f>>, BuildError> {
        let Some(extraction) = &mut self.extraction else {
            let seen = |features| Seen { features: Cow::Borrowed(features), stereo: Vec::new() };
            return Ok(frame.features.as_ref().map(seen));
        };
        let mut extract = |file: &ImageData, mask: Option<&GrayImage>| match file.read() {
            Ok(image) => extraction
                .extractor
                .extract(&image, mask, extraction.max_features)
                .map(Some)
                .map_err(|source| BuildError::Extraction { image: file.to_string(), source }),
            Err(error) => {
                self.unreadable.push(error.to_string());
                Ok(None)
            }
        };
        let Some(file) = &frame.images[0] else { return Ok(None) };
        let Some(first) = extract(file, extraction.mask)? else { return Ok(None) };
        let stereo = match (&frame.images[1], self.rig.get(1)) {
            (Some(file), Some(_)) if extraction.stereo => {
                extract(file, None)?.map_or_else(Vec::new, |second| match_stereo(self.rig, &first, &second))
            }
            _ => Vec::new(),
        };
        let features = Cow::Owned(feature_set(extraction.extractor.name(), first));
        Ok(Some(Seen { features, stereo }))
    }
}
