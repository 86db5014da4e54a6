//! Writing a COLMAP model in text.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::path::Path;

use geometry::camera::Camera;
use nalgebra::Vector2;
use protocol::{KeyframeId, LandmarkId};

use super::error::ColmapError;
use super::{BINARY_FILES, PIXEL_OFFSET, TEXT_FILES, camera_model};
use map::contents::MapContents;
use map::model::{Keyframe, Landmark};

/// Writes a map as a COLMAP model into a folder, which is made if needed.
///
/// Landmarks that one image sees are left out: COLMAP's bundle adjustment ends with an error at a point of one image.
///
/// # Arguments
/// * `image_name`: of the image of a keyframe, as COLMAP is to find it; see [`super::image_names`].
///
/// # Errors
/// [`ColmapError`], also where two keyframes have one name. No part of a model is left then.
pub fn write_model(
    folder: &Path,
    contents: &MapContents,
    image_name: impl Fn(&Keyframe) -> String,
) -> Result<WrittenModel, ColmapError> {
    contents.validate()?;
    let mut names = BTreeSet::new();
    if let Some(name) = contents.keyframes.iter().map(&image_name).find(|name| !names.insert(name.clone())) {
        return Err(ColmapError::SameName { name });
    }
    if TEXT_FILES.iter().chain(&BINARY_FILES).any(|name| folder.join(name).exists()) {
        return Err(ColmapError::Occupied { path: folder.to_owned() });
    }
    let model = Model::new(contents);
    let cameras = model.cameras_text()?;
    write_texts(folder, &[cameras, model.images_text(&image_name), model.points_text()])?;
    let points = model.landmarks.len();
    Ok(WrittenModel {
        images: contents.keyframes.len(),
        points,
        seen_once: contents.landmarks.len() - points,
    })
}

/// Writes all files, none of which is there, or none of them.
fn write_texts(folder: &Path, texts: &[String; 3]) -> Result<(), ColmapError> {
    std::fs::create_dir_all(folder)
        .map_err(|reason| ColmapError::Write { path: folder.to_owned(), reason })?;
    let mut all = TEXT_FILES.iter().map(|name| folder.join(name)).zip(texts);
    let written = all.try_for_each(|(path, text)| {
        files::write_whole(&path, text.as_bytes()).map_err(|reason| ColmapError::Write { path, reason })
    });
    written.inspect_err(|_| {
        for name in TEXT_FILES {
            let _ = std::fs::remove_file(folder.join(name));
        }
    })
}

/// What a model holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WrittenModel {
    /// Number of images.
    pub images: usize,
    /// Number of points.
    pub points: usize,
    /// Landmarks that one image sees, which were left out.
    pub seen_once: usize,
}

struct Model<'a> {
    contents: &'a MapContents,
    /// Those that two images see.
    landmarks: Vec<&'a Landmark>,
    cameras: Vec<&'a Camera>,
    keyframes: BTreeMap<KeyframeId, &'a Keyframe>,
    /// Of each keyframe: the landmark and pixel of its points.
    points: BTreeMap<KeyframeId, Vec<(LandmarkId, [f32; 2])>>,
}

impl<'a> Model<'a> {
    fn new(contents: &'a MapContents) -> Model<'a> {
        let mut cameras: Vec<&Camera> = Vec::new();
        for keyframe in &contents.keyframes {
            if !cameras.contains(&&keyframe.camera) {
                cameras.push(&keyframe.camera);
            }
        }
        let mut points: BTreeMap<KeyframeId, Vec<(LandmarkId, [f32; 2])>> = BTreeMap::new();
        let landmarks: Vec<&Landmark> =
            contents.landmarks.iter().filter(|landmark| landmark.observations.len() > 1).collect();
        for landmark in &landmarks {
            for observation in &landmark.observations {
                points.entry(observation.keyframe).or_default().push((landmark.id, observation.pixel));
            }
        }
        let keyframes = contents.keyframes.iter().map(|keyframe| (keyframe.id, keyframe)).collect();
        Model { contents, landmarks, cameras, keyframes, points }
    }

    fn cameras_text(&self) -> Result<String, ColmapError> {
        let mut text = String::from("# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n");
        for (id, camera) in (1..).zip(&self.cameras) {
            let Some((model, parameters)) = camera_model::parameters(camera) else {
                return Err(ColmapError::CameraModel { model: camera.distortion.name() });
            };
            let _ = write!(text, "{id} {model} {} {}", camera.width, camera.height);
            for parameter in parameters {
                let _ = write!(text, " {parameter}");
            }
            text.push('\n');
        }
        Ok(text)
    }

    fn images_text(&self, image_name: &impl Fn(&Keyframe) -> String) -> String {
        let mut text = String::from(
            "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n# POINTS2D[] as (X, Y, POINT3D_ID)\n",
        );
        for keyframe in &self.contents.keyframes {
            let camera = self.cameras.iter().position(|camera| **camera == keyframe.camera).unwrap_or(0) + 1;
            let camera_from_global = keyframe.global_from_keyframe.pose.inverse();
            let (q, t) = (camera_from_global.rotation, camera_from_global.translation);
            let name = image_name(keyframe);
            let _ = writeln!(
                text,
                "{} {} {} {} {} {} {} {} {camera} {name}",
                keyframe.id, q.w, q.i, q.j, q.k, t.x, t.y, t.z
            );
            let mut separator = "";
            for (landmark, pixel) in self.points.get(&keyframe.id).into_iter().flatten() {
                let [u, v] = pixel.map(|coordinate| f64::from(coordinate) + PIXEL_OFFSET);
                let _ = write!(text, "{separator}{u} {v} {landmark}");
                separator = " ";
            }
            text.push('\n');
        }
        text
    }

    fn points_text(&self) -> String {
        let mut text =
            String::from("# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n");
        // The position of each point in the list of its keyframe, counted as the lists were filled.
        let mut counted: BTreeMap<KeyframeId, usize> = BTreeMap::new();
        for landmark in &self.landmarks {
            let Some(anchor) = self.keyframes.get(&landmark.anchor) else { continue };
            let p = anchor.global_from_keyframe.pose.transform(&landmark.position_in_anchor);
            let error = self.mean_error(landmark, &p);
            let _ = write!(text, "{} {} {} {} 128 128 128 {error}", landmark.id, p.x, p.y, p.z);
            for observation in &landmark.observations {
                let index = counted.entry(observation.keyframe).or_default();
                let _ = write!(text, " {} {index}", observation.keyframe);
                *index += 1;
            }
            text.push('\n');
        }
        text
    }

    /// Mean reprojection error of a landmark at a position in G (px), of the observations that see it.
    fn mean_error(&self, landmark: &Landmark, position: &nalgebra::Vector3<f64>) -> f64 {
        let errors = landmark.observations.iter().filter_map(|observation| {
            let keyframe = self.keyframes.get(&observation.keyframe)?;
            let in_camera = keyframe.global_from_keyframe.pose.inverse_transform(position);
            let seen = Vector2::from(observation.pixel.map(f64::from));
            Some((keyframe.camera.project(&in_camera).ok()? - seen).norm())
        });
        let (sum, count) = errors.fold((0.0, 0_u32), |(sum, count), error| (sum + error, count + 1));
        sum / f64::from(count.max(1))
    }
}
