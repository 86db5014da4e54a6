//! Features of images: read from the recording where it has them, extracted where it has images.

use std::borrow::Cow;
use std::collections::HashMap;

use geometry::CameraGroup;
use geometry::camera::Camera;
use nalgebra::Vector2;
use protocol::FeatureSet;
use sensors::{Frame, ImageData, Sequence};
use vision::{FeatureExtractor, GrayImage, ImageFeatures};

use super::camera::Rig;
use super::error::BuildError;
use super::stereo_matching::match_stereo;
use vision::feature_set;

/// How features are extracted from images.
pub struct Extraction<'a> {
    /// Detects and describes features.
    pub extractor: &'a mut dyn FeatureExtractor,
    /// More extractors of the same kind: as many images more are extracted at the same time.
    pub others: &'a mut [Box<dyn FeatureExtractor>],
    /// Most features an image.
    pub max_features: usize,
    /// Of the cameras in their order, zero where images show the robot itself: no features there. Cameras that are missing have none.
    pub masks: &'a [Option<GrayImage>],
    /// How many cameras are used, the first ones, at most all: each stereo pair or single camera makes keyframes of its own.
    pub cameras: usize,
}

/// Where the features of frames come from.
pub(super) struct FeatureSource<'e, 'r> {
    extraction: Option<Extraction<'e>>,
    rig: &'r Rig,
    /// What was extracted ahead, by time (ns) and camera.
    ready: HashMap<(i64, usize), Extracted>,
    /// Images that could not be read, with the reason.
    pub(super) unreadable: Vec<String>,
}

/// The features of an image, or why there are none.
enum Extracted {
    Features(ImageFeatures),
    Unreadable(String),
    Failed(BuildError),
}

/// The features of the image of a stereo pair's first camera or of a single camera.
pub(super) struct ImageWithFeatures<'a> {
    /// With descriptors.
    pub(super) features: Cow<'a, FeatureSet>,
    /// Pixel of each of them in the second camera, where it is matched there; empty without stereo.
    pub(super) stereo: Vec<Option<Vector2<f64>>>,
}

impl<'e, 'r> FeatureSource<'e, 'r> {
    /// Features from the recording, or with `extraction` from its images.
    pub(super) fn new(extraction: Option<Extraction<'e>>, rig: &'r Rig) -> FeatureSource<'e, 'r> {
        FeatureSource { extraction, rig, ready: HashMap::new(), unreadable: Vec::new() }
    }

    /// The stereo pairs and single cameras of which a frame can have features.
    pub(super) fn groups_of(&self, frame: &Frame) -> impl Iterator<Item = usize> {
        let has_features = |group: &CameraGroup| match &self.extraction {
            Some(_) => frame.images.contains_key(&group.first),
            None => frame.features.get(&group.first).is_some_and(|features| !features.is_empty()),
        };
        let groups = self.rig.groups.iter().enumerate();
        groups.filter(move |(_, group)| has_features(group)).map(|(index, _)| index)
    }

    /// Whether a frame can have features.
    pub(super) fn has_features(&self, frame: &Frame) -> bool {
        self.groups_of(frame).next().is_some()
    }

    /// The cameras of which a keyframe needs the images.
    pub(super) fn cameras_of(&self, frame: &Frame) -> impl Iterator<Item = usize> {
        self.groups_of(frame).flat_map(|group| self.rig.groups[group].cameras())
    }

    /// The camera in whose image the features of a group are.
    pub(super) fn camera_of(&self, group: usize) -> usize {
        self.rig.groups[group].first
    }

    /// Its projection.
    pub(super) fn projection_of(&self, group: usize) -> &'r Camera {
        self.rig.camera(group)
    }

    /// The error for a recording without features.
    pub(super) fn no_features(&self, sequence: &Sequence) -> BuildError {
        let sequence = sequence.root.display().to_string();
        match self.extraction {
            Some(_) => BuildError::NoImages { sequence },
            None => BuildError::NoFeatures { sequence },
        }
    }

    /// Number of images that are extracted at the same time.
    pub(super) fn at_once(&self) -> usize {
        self.extraction.as_ref().map_or(0, |extraction| 1 + extraction.others.len())
    }

    /// The features of a group's first camera; `None` where its image cannot be read, which is recorded in `unreadable`.
    ///
    /// # Errors
    /// [`BuildError::Extraction`], [`BuildError::ImageSize`].
    pub(super) fn features_of<'f>(
        &mut self,
        frame: &'f Frame,
        group: usize,
    ) -> Result<Option<Cow<'f, FeatureSet>>, BuildError> {
        let camera = self.camera_of(group);
        if self.extraction.is_none() {
            return Ok(frame.features.get(&camera).map(Cow::Borrowed));
        }
        Ok(self.extract(frame, camera)?.map(|features| Cow::Owned(self.named(features))))
    }

    /// The features of a group's first camera and where the second one sees them; `None` as in [`FeatureSource::features_of`].
    ///
    /// # Errors
    /// [`BuildError::Extraction`], [`BuildError::ImageSize`].
    pub(super) fn stereo_features_of<'f>(
        &mut self,
        frame: &'f Frame,
        group: usize,
    ) -> Result<Option<ImageWithFeatures<'f>>, BuildError> {
        let pair = self.rig.groups[group].second.zip(self.rig.second_camera(group));
        let Some((second, mounted)) = pair.filter(|_| self.extraction.is_some()) else {
            let features = self.features_of(frame, group)?;
            return Ok(features.map(|features| ImageWithFeatures { features, stereo: Vec::new() }));
        };
        let first = self.camera_of(group);
        self.prepare(&[(frame, first), (frame, second)]);
        let Some(of_first) = self.extract(frame, first)? else { return Ok(None) };
        let camera = self.projection_of(group);
        let stereo = self
            .extract(frame, second)?
            .map_or_else(Vec::new, |of_second| match_stereo(camera, mounted, &of_first, &of_second));
        Ok(Some(ImageWithFeatures { features: Cow::Owned(self.named(of_first)), stereo }))
    }

    /// Whether an image was extracted already.
    pub(super) fn is_ready(&self, frame: &Frame, camera: usize) -> bool {
        self.ready.contains_key(&(frame.stamp_ns, camera))
    }

    /// Extracts images ahead, all at the same time: as many of those that are not ready as there are extractors.
    pub(super) fn prepare(&mut self, images: &[(&Frame, usize)]) {
        let missing: Vec<(&Frame, usize)> = images
            .iter()
            .filter(|(frame, camera)| !self.is_ready(frame, *camera))
            .take(self.at_once())
            .copied()
            .collect();
        let Some(extraction) = &mut self.extraction else { return };
        let (cameras, max_features) = (&self.rig.cameras, extraction.max_features);
        let masks = extraction.masks;
        let extract = move |extractor: &mut dyn FeatureExtractor, (frame, index): (&Frame, usize)| {
            let mask = masks.get(index).and_then(Option::as_ref);
            let file = frame.images.get(&index)?;
            let camera = (index, &cameras[index].camera);
            Some(((frame.stamp_ns, index), extracted(extractor, file, camera, mask, max_features)))
        };
        let Some((first, others)) = missing.split_first() else { return };
        let done: Vec<_> = std::thread::scope(|scope| {
            let threads: Vec<_> = others
                .iter()
                .zip(extraction.others.iter_mut())
                .map(|(&image, extractor)| scope.spawn(move || extract(extractor.as_mut(), image)))
                .collect();
            let of_first = extract(extraction.extractor, *first);
            let of_others = threads
                .into_iter()
                .filter_map(|thread| thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)));
            of_first.into_iter().chain(of_others).collect()
        });
        self.ready.extend(done);
    }

    /// Forgets what was extracted of images before a time.
    pub(super) fn forget_before(&mut self, stamp_ns: i64) {
        self.ready.retain(|(ready_ns, _), _| *ready_ns >= stamp_ns);
    }

    fn named(&self, features: ImageFeatures) -> FeatureSet {
        let name = self.extraction.as_ref().map_or("", |extraction| extraction.extractor.name());
        feature_set(name, features)
    }

    /// The features of one camera; `None` without an image that can be read.
    fn extract(&mut self, frame: &Frame, camera: usize) -> Result<Option<ImageFeatures>, BuildError> {
        self.prepare(&[(frame, camera)]);
        match self.ready.get(&(frame.stamp_ns, camera)) {
            None => Ok(None),
            Some(Extracted::Features(features)) => Ok(Some(features.clone())),
            Some(Extracted::Unreadable(reason)) => {
                self.unreadable.push(reason.clone());
                Ok(None)
            }
            Some(Extracted::Failed(_)) => match self.ready.remove(&(frame.stamp_ns, camera)) {
                Some(Extracted::Failed(error)) => Err(error),
                _ => Ok(None),
            },
        }
    }
}

/// Reads an image of a camera and extracts its features.
fn extracted(
    extractor: &mut dyn FeatureExtractor,
    file: &ImageData,
    (index, camera): (usize, &Camera),
    mask: Option<&GrayImage>,
    max_features: usize,
) -> Extracted {
    let image = match file.read() {
        Ok(image) => image,
        Err(error) => return Extracted::Unreadable(error.to_string()),
    };
    if let Err(error) = check_size(index, file, &image, camera) {
        return Extracted::Failed(error);
    }
    match extractor.extract(&image, mask, max_features) {
        Ok(features) => Extracted::Features(features),
        Err(source) => Extracted::Failed(BuildError::Extraction { image: file.to_string(), source }),
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
