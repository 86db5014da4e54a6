//! Images that people give to the live map: features by the map's extractor, then the search of a `localize` query.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::{Arc, PoisonError, RwLock};

use calibration::lens_of_text;
use geometry::Camera;
use protocol::{LocalizeRequest, Validate as _};
use recognition::{LoadedMap, RecognitionOptions};
use viewer::{GivenImage, ImageCamera, ImageError, LocalizeImage, ViewedAnswer};
use vision::feature_set;
use vision::features::open;
use vision::{GrayImage, Pyramid};

use crate::reports::AnsweredQuery;
use crate::served_map::{MapSlot, ServedMap};
use crate::show::viewed_answer;

/// Largest width and height of an image, pixels.
pub const MAX_IMAGE_SIDE: u32 = 4096;
/// Features are extracted from at most so many pixels: larger images are halved, and their cameras. An extractor needs about 60
/// bytes a pixel.
const MAX_PIXELS: usize = 2048 * 1536;
/// Most features of an image, as of `driftless localize`.
const MAX_FEATURES: usize = 1000;

/// Localizes images in maps, as `driftless localize` does.
pub struct ImageLocalizer {
    maps: Arc<BTreeMap<String, Arc<MapSlot>>>,
    /// Of all maps, those that are served by cells among them.
    names: Arc<RwLock<BTreeSet<String>>>,
    options: RecognitionOptions,
}

impl ImageLocalizer {
    /// In maps that are not served.
    pub fn new(maps: Vec<ServedMap>) -> Self {
        let slots = maps.into_iter().map(|map| (map.name.clone(), Arc::new(MapSlot::new(map))));
        Self::of_slots(Arc::new(slots.collect()), Arc::default(), RecognitionOptions::default())
    }

    pub(crate) fn of_slots(
        maps: Arc<BTreeMap<String, Arc<MapSlot>>>,
        names: Arc<RwLock<BTreeSet<String>>>,
        options: RecognitionOptions,
    ) -> Self {
        Self { maps, names, options }
    }

    fn is_by_cells(&self, name: &str) -> bool {
        let names = self.names.read().unwrap_or_else(PoisonError::into_inner);
        names.contains(name) && !self.maps.contains_key(name)
    }

    fn search(&self, map: &LoadedMap, request: &LocalizeRequest) -> Result<ViewedAnswer, ImageError> {
        let (reply, search) =
            map.localize_with_report(request, &self.options).map_err(|error| unusable(&error))?;
        Ok(viewed_answer(&AnsweredQuery {
            outcome: reply.outcome,
            keyframes: reply.fix.iter().map(|fix| fix.keyframe).collect(),
            map_version: reply.map_version,
            stamp_ns: None,
            features: request.features.len(),
            prior_in_global: None,
            fix: reply.fix,
            search,
        }))
    }
}

impl LocalizeImage for ImageLocalizer {
    fn localize(&self, given: &GivenImage) -> Result<ViewedAnswer, ImageError> {
        if self.is_by_cells(&given.map) {
            let message = format!(
                "images are searched in maps that a server has as a whole, and {} is served by cells: ask with driftless localize",
                given.map
            );
            return Err(unusable(&message));
        }
        let slot = self.maps.get(&given.map).ok_or_else(|| ImageError::UnknownMap(given.map.clone()))?;
        let map = slot.current();
        let extractor = &map.info().extractor;
        if extractor.is_empty() {
            let message = "the map does not say which extractor its features come from, so that an image cannot be compared \
                           with it: build the map again from images";
            return Err(unusable(&message));
        }
        // Opened for each image: what it needs for a large one is not kept.
        let mut extractor = open(extractor, None).map_err(|error| unusable(&error))?;
        let camera = camera_of(&given.camera)?;
        let (image, camera) = halved(decode(&given.file, &camera)?, camera);
        let features = extractor.extract(&image, None, MAX_FEATURES).map_err(|error| unusable(&error))?;
        drop(image);
        let features = feature_set(extractor.name(), features);
        let request = LocalizeRequest { camera, features, prior: None, gravity_in_camera: None };
        request.validate().map_err(|error| unusable(&error))?;
        self.search(&map, &request)
    }
}

fn unusable(problem: &dyn std::fmt::Display) -> ImageError {
    ImageError::Unusable(problem.to_string())
}

/// Decodes an image, unless its header says that it is too large or not of this camera.
fn decode(file: &[u8], camera: &Camera) -> Result<GrayImage, ImageError> {
    let (width, height) = GrayImage::size_of_encoded(file).map_err(|error| unusable(&error))?;
    if width.max(height) > MAX_IMAGE_SIDE {
        let message = format!(
            "the image has {width} x {height} pixels, more than {MAX_IMAGE_SIDE} x {MAX_IMAGE_SIDE}: give a smaller one, with the \
             calibration of that size"
        );
        return Err(unusable(&message));
    }
    if (width, height) != (camera.width, camera.height) {
        let message = format!(
            "the image has {width} x {height} pixels, its camera {} x {}: choose or paste the calibration of the camera \
             that took it, at this size",
            camera.width, camera.height
        );
        return Err(unusable(&message));
    }
    GrayImage::decode(file).map_err(|error| unusable(&error))
}

fn camera_of(camera: &ImageCamera) -> Result<Camera, ImageError> {
    match camera {
        ImageCamera::OfMap(camera) => Ok(camera.clone()),
        ImageCamera::Calibration(text) => {
            lens_of_text(Path::new("the calibration"), text).map_err(|error| unusable(&error))
        }
    }
}

/// An image with its camera, at half the resolution as often as it is too large.
fn halved(mut image: GrayImage, mut camera: Camera) -> (GrayImage, Camera) {
    while image.width() * image.height() > MAX_PIXELS {
        image = Pyramid::new(image, 2).level(1).clone();
        // Level 1 has every second pixel, from the first one on.
        camera.focal = camera.focal.map(|focal| focal / 2.0);
        camera.centre = camera.centre.map(|centre| centre / 2.0);
        (camera.width, camera.height) = (image.width() as u32, image.height() as u32);
    }
    (image, camera)
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::Distortion;
    use nalgebra::{Vector2, Vector3};

    #[test]
    fn a_large_image_is_halved_with_its_camera() {
        let (width, height) = (3001, 2000);
        let camera = Camera {
            width,
            height,
            focal: [2000.0, 1990.0],
            centre: [1500.5, 999.0],
            distortion: Distortion::Fov(0.9),
        };
        let image =
            GrayImage::from_fn(width as usize, height as usize, |x, y| ((x / 64 + y / 64) % 2) as u8 * 200);
        let (small, of_small) = halved(image.clone(), camera.clone());
        assert_eq!((small.width(), small.height()), (1501, 1000));
        assert_eq!((of_small.width, of_small.height), (1501, 1000));
        let point = Vector3::new(0.4, -0.3, 2.0);
        let (large_pixel, small_pixel) = (camera.project(&point).unwrap(), of_small.project(&point).unwrap());
        assert!((large_pixel - small_pixel * 2.0).norm() < 1e-9);
        // The same grey is at the same place.
        for seen in [Vector2::new(32.0, 32.0), Vector2::new(96.0, 32.0), Vector2::new(160.0, 1696.0)] {
            let half = seen / 2.0;
            assert_eq!(
                image.get(seen.x as usize, seen.y as usize),
                small.get(half.x as usize, half.y as usize)
            );
        }
        let other = Camera { width: 3000, ..camera };
        let refused = decode(&image.to_png().unwrap(), &other).unwrap_err().to_string();
        assert!(refused.contains("3001 x 2000") && refused.contains("3000 x 2000"), "{refused}");
    }
}
