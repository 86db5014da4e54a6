//! A map from a COLMAP model and its images.

use super::covariance::{Point, View, covariance};
use super::descriptors::describe;
use super::frame::{ColmapFrame, stamp_ns};
use crate::aliasing::find_aliases;
use crate::error::BuildError;
use crate::feature_source::Extraction;
use crate::joint_covariance::{JointCovariance, StatedKeyframe};
use crate::progress::{Progress, Stage};
use crate::refinement::{REPROJECTION_GATE, median_sigma_px};
use geometry::uncertain_pose::PoseWithCovariance;
use map::contents::MapContents;
use map::model::{Keyframe, Landmark, MapMetadata, Observation};
use map_io::colmap::{ColmapImage, ColmapModel};
use nalgebra::Vector2;
use protocol::KeyframeId;
use serde::Serialize;
use std::collections::BTreeMap;
use vision::GrayImage;
use vision::kind_of;

/// What became of a model.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ColmapImport {
    /// Images of the model that became keyframes.
    pub keyframes: usize,
    /// Images that could not be read and were left out, with the reason.
    pub unreadable_images: Vec<String>,
    /// Points of the model that became landmarks.
    pub landmarks: usize,
    /// Points that were left out: seen by fewer than two images, too far off their pixels, or without a descriptor in two.
    pub dropped_points: usize,
    /// Observations over all landmarks.
    pub observations: usize,
    /// Observations that were left out because no feature of the extractor is near them.
    pub undescribed_observations: usize,
    /// Metres in the model's unit of length.
    pub scale: f64,
    /// Relative standard deviation of the scale.
    pub sigma_scale: f64,
    /// Standard deviation of a pixel, from the model's reprojection errors (px).
    pub sigma_px: f64,
}

/// The model with its images as views, in G.
struct Scene<'a> {
    images: Vec<(KeyframeId, &'a ColmapImage)>,
    views: Vec<View>,
    points: Vec<Point>,
}

/// Makes a map of a model: its poses, points and pixels as they are, in metres, with descriptors from the images and the
/// joint covariance that its reprojection errors say.
///
/// # Arguments
/// * `frame`: scale and gravity.
/// * `read`: reads the image of a name.
/// * `extraction`: how features are extracted; masks and stereo are not used.
/// * `info`: name and origin of the map; kind of descriptors, gravity and pixel noise are filled in.
///
/// # Errors
/// [`BuildError`], with what to do.
pub fn import_colmap(
    model: &ColmapModel,
    frame: &ColmapFrame,
    mut read: impl FnMut(&str) -> Result<GrayImage, vision::ImageError>,
    extraction: &mut Extraction<'_>,
    [name, created_by]: [&str; 2],
    progress: Progress<'_>,
) -> Result<(MapContents, ColmapImport), BuildError> {
    let mut report =
        ColmapImport { scale: frame.scale, sigma_scale: frame.sigma_scale, ..ColmapImport::default() };
    let scene = Scene::new(model, frame);
    let (points, sigma_px) = scene.inliers();
    report.sigma_px = sigma_px;
    let show = |done, all| progress(Stage::Covariance, done, all);
    let joint = covariance(&scene.views, &points, frame, sigma_px, show)
        .ok_or_else(|| scene.undetermined(&points))?;
    let mut info = MapMetadata::new(
        name,
        created_by,
        kind_of(extraction.extractor.metric()),
        extraction.extractor.width() as u16,
    );
    info.gravity_in_global = frame.gravity.as_ref().map(|gravity| gravity.in_global);
    info.own_frame = true;
    info.sigma_px = sigma_px;
    extraction.extractor.name().clone_into(&mut info.extractor);
    let mut descriptors: Vec<Vec<Option<Vec<u8>>>> = Vec::new();
    for (done, (_, image)) in scene.images.iter().enumerate() {
        progress(Stage::KeyframeSelection, done, scene.images.len());
        let pixels = match read(&image.name) {
            Ok(pixels) => pixels,
            Err(error) => {
                report.unreadable_images.push(format!("{}: {error}", image.name));
                descriptors.push(Vec::new());
                continue;
            }
        };
        check_size(model, image, &pixels)?;
        descriptors.push(describe(image, &pixels, extraction.extractor, extraction.max_features)?);
    }
    let mut contents = MapContents::empty(info);
    contents.landmarks = scene.landmarks(&points, &descriptors);
    if contents.landmarks.is_empty() {
        return Err(BuildError::NoDescribedPoints { unreadable: report.unreadable_images.len() });
    }
    scene.add_keyframes(&mut contents, &joint);
    contents.sort();
    contents.ensure_sessions(name);
    contents.validate()?;
    find_aliases(&mut contents, progress)?;
    report.keyframes = contents.keyframes.len();
    report.landmarks = contents.landmarks.len();
    report.dropped_points = model.points.len() - report.landmarks;
    report.observations = contents.observation_count();
    report.undescribed_observations =
        descriptors.iter().flatten().filter(|descriptor| descriptor.is_none()).count();
    Ok((contents, report))
}

impl<'a> Scene<'a> {
    fn new(model: &'a ColmapModel, frame: &ColmapFrame) -> Scene<'a> {
        let images: Vec<(KeyframeId, &ColmapImage)> =
            model.images.iter().map(|(id, image)| (KeyframeId::from(*id), image)).collect();
        let view = |(_, image): &(KeyframeId, &ColmapImage)| View {
            camera: model.cameras[&image.camera].clone(),
            pose: frame.pose(&image.world_from_camera),
        };
        let views = images.iter().map(view).collect();
        let mut seen: BTreeMap<u64, Vec<(usize, usize, Vector2<f64>)>> = BTreeMap::new();
        for (view, (_, image)) in images.iter().enumerate() {
            for (index, pixel) in image.pixels.iter().enumerate() {
                let sightings = seen.entry(pixel.point).or_default();
                // A point that an image sees twice is no point; the first one is kept.
                if sightings.last().is_none_or(|(last, ..)| *last != view) {
                    sightings.push((view, index, Vector2::from(pixel.pixel)));
                }
            }
        }
        let point = |(id, seen)| Point { id, position: frame.point(&model.points[&id]), seen };
        Scene { images, views, points: seen.into_iter().map(point).collect() }
    }

    /// The points that fit their pixels, with the observations that do, and the standard deviation of a pixel (px).
    fn inliers(&self) -> (Vec<Point>, f64) {
        let errors = |point: &Point| -> Vec<f64> {
            point
                .seen
                .iter()
                .map(|(view, _, pixel)| self.views[*view].error(&point.position, pixel))
                .collect()
        };
        let several = self.points.iter().filter(|point| point.seen.len() > 1);
        let sigma_px = median_sigma_px(several.map(errors)).unwrap_or(1.0);
        let fitting = |point: &Point| {
            let fits = |(view, _, pixel): &&(usize, usize, Vector2<f64>)| {
                self.views[*view].error(&point.position, pixel) <= REPROJECTION_GATE * sigma_px
            };
            let seen: Vec<_> = point.seen.iter().filter(fits).copied().collect();
            (seen.len() > 1).then_some(Point { id: point.id, position: point.position, seen })
        };
        (self.points.iter().filter_map(fitting).collect(), sigma_px)
    }

    /// The error that names the image which sees the fewest points.
    fn undetermined(&self, points: &[Point]) -> BuildError {
        let mut counts = vec![0; self.views.len()];
        for (view, ..) in points.iter().flat_map(|point| &point.seen) {
            counts[*view] += 1;
        }
        let fewest = (0..counts.len()).min_by_key(|view| counts[*view]);
        let (image, points) = fewest.map_or_else(
            || ("no image".to_owned(), 0),
            |view| (self.images[view].1.name.clone(), counts[view]),
        );
        BuildError::ColmapUndetermined { image, points }
    }

    /// The points with descriptors in at least two images.
    fn landmarks(&self, points: &[Point], descriptors: &[Vec<Option<Vec<u8>>>]) -> Vec<Landmark> {
        let landmark = |point: &Point| {
            let observation = |(view, index, pixel): &(usize, usize, Vector2<f64>)| {
                let descriptor = descriptors[*view].get(*index)?.clone()?;
                let keyframe = self.images[*view].0;
                Some((*view, Observation { keyframe, pixel: [pixel.x as f32, pixel.y as f32], descriptor }))
            };
            let (views, observations): (Vec<usize>, Vec<Observation>) =
                point.seen.iter().filter_map(observation).unzip();
            let anchor = *views.get(views.len() / 2)?;
            let position_in_anchor = self.views[anchor].pose.inverse_transform(&point.position);
            let landmark =
                Landmark { id: point.id, anchor: self.images[anchor].0, position_in_anchor, observations };
            (views.len() > 1).then_some(landmark)
        };
        points.iter().filter_map(landmark).collect()
    }

    /// Adds the images that see landmarks, with their covariances.
    fn add_keyframes(&self, contents: &mut MapContents, joint: &JointCovariance) {
        let mut used: Vec<KeyframeId> = contents
            .landmarks
            .iter()
            .flat_map(|landmark| landmark.observations.iter().map(|observation| observation.keyframe))
            .collect();
        used.sort_unstable();
        used.dedup();
        let is_used = |view: &usize| used.binary_search(&self.images[*view].0).is_ok();
        let keyframe = |view: usize| {
            let (id, image) = self.images[view];
            let View { camera, pose } = &self.views[view];
            Keyframe {
                id,
                stamp_ns: stamp_ns(image).unwrap_or(0),
                global_from_keyframe: PoseWithCovariance::new(*pose, joint.own[&view]),
                camera: camera.clone(),
                features: None,
            }
        };
        contents.keyframes = (0..self.views.len()).filter(is_used).map(keyframe).collect();
        (contents.cross_covariances, contents.common_errors) = joint.of_keyframes(|view| {
            if is_used(&view) { StatedKeyframe::alone(self.images[view].0) } else { Vec::new() }
        });
    }
}

fn check_size(model: &ColmapModel, image: &ColmapImage, pixels: &GrayImage) -> Result<(), BuildError> {
    let camera = &model.cameras[&image.camera];
    let (size, calibrated) =
        ((pixels.width(), pixels.height()), (camera.width as usize, camera.height as usize));
    if size == calibrated {
        return Ok(());
    }
    Err(BuildError::ColmapImageSize { image: image.name.clone(), size, calibrated })
}
