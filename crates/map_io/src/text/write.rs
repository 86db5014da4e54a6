//! Writing a plain-text map.

use std::fmt::Write as _;
use std::path::Path;

use calibration::numbers::shortest;
use geometry::camera::Camera;
use geometry::uncertain_pose::isotropic_covariance;
use map::contents::MapContents;
use map::model::Keyframe;
use nalgebra::Matrix6;
use types::hexadecimal;

use super::camera_yaml::camera_text;
use super::error::MapFileError;
use super::info_yaml::info_text;
use super::sessions::sessions_text;
use super::table::shortest_single;
use super::{columns, names};

/// Writes a map as text files into a folder, which is made if needed.
///
/// Numbers are written in the shortest form that reads back as the same number. What two sigmas a keyframe cannot
/// express goes into further files, which are written only when needed.
///
/// # Errors
/// [`MapFileError::Contents`] for a map that violates an invariant, [`MapFileError::Occupied`] where the folder already holds
/// a file of a map, [`MapFileError::Write`].
pub fn write_map(folder: &Path, contents: &MapContents) -> Result<(), MapFileError> {
    contents.validate().map_err(|reason| MapFileError::Contents { path: folder.to_owned(), reason })?;
    let mut sorted = contents.clone();
    sorted.sort();
    check_free(folder)?;
    std::fs::create_dir_all(folder)
        .map_err(|reason| MapFileError::Write { path: folder.to_owned(), reason })?;
    let mut texts = texts(&sorted);
    // No map can be read without its keyframes: what a killed program leaves cannot be read, and is not taken for a map without covariances.
    texts.sort_by_key(|(name, _)| name == names::KEYFRAMES);
    for (name, text) in texts {
        let path = folder.join(name);
        files::write_whole(&path, text.as_bytes()).map_err(|reason| MapFileError::Write { path, reason })?;
    }
    Ok(())
}

/// Leftovers of another map would be read as part of this one.
fn check_free(folder: &Path) -> Result<(), MapFileError> {
    match names::ALL.iter().find(|name| folder.join(name).exists()) {
        Some(name) => Err(MapFileError::Occupied { path: folder.to_owned(), file: (*name).to_owned() }),
        None => Ok(()),
    }
}

/// All files of a sorted map: name and text.
fn texts(contents: &MapContents) -> Vec<(String, String)> {
    let cameras = distinct_cameras(&contents.keyframes);
    let observed = contents.landmarks.iter().flat_map(|landmark| &landmark.observations).next();
    let width = observed.and_then(|observation| u16::try_from(observation.descriptor.len()).ok());
    let mut files = vec![
        (names::KEYFRAMES.to_owned(), keyframes_text(contents, &cameras)),
        (names::LANDMARKS.to_owned(), landmarks_text(contents)),
        (names::OBSERVATIONS.to_owned(), observations_text(contents)),
    ];
    for (index, camera) in (0..).zip(&cameras) {
        files.push((names::camera(index), camera_text(camera)));
    }
    let optional = [
        (names::INFO, info_text(&contents.info, width)),
        (names::COVARIANCES, covariances_text(contents)),
        (names::CROSS_COVARIANCES, cross_covariances_text(contents)),
        (names::COMMON_ERRORS, common_errors_text(contents)),
        (names::ALIASES, aliases_text(contents)),
        (names::EXISTENCE, existence_text(contents)),
        (names::FEATURES, features_text(contents)),
        (names::SESSIONS, sessions_text(&contents.info.sessions)),
    ];
    files.extend(optional.into_iter().filter_map(|(name, text)| Some((name.to_owned(), text?))));
    files
}

/// The map's cameras in the order of the keyframes.
fn distinct_cameras(keyframes: &[Keyframe]) -> Vec<&Camera> {
    let mut cameras: Vec<&Camera> = Vec::new();
    for keyframe in keyframes {
        if !cameras.contains(&&keyframe.camera) {
            cameras.push(&keyframe.camera);
        }
    }
    cameras
}

/// The sigmas (rad, m) that give exactly the covariance; `None` where two sigmas cannot.
fn sigmas(covariance: &Matrix6<f64>) -> Option<[f64; 2]> {
    let [theta, position] = [covariance[(0, 0)].sqrt(), covariance[(3, 3)].sqrt()];
    (isotropic_covariance(theta, position) == *covariance).then_some([theta, position])
}

/// The sigmas nearest to a covariance.
fn mean_sigmas(covariance: &Matrix6<f64>) -> [f64; 2] {
    let diagonal = covariance.diagonal();
    let mean = |first: usize| (diagonal.rows(first, 3).sum() / 3.0).max(0.0).sqrt();
    [mean(0), mean(3)]
}

// Writing to a String cannot fail, so the results of `write!` are dropped below.

fn keyframes_text(contents: &MapContents, cameras: &[&Camera]) -> String {
    let several = cameras.len() > 1;
    let mut text = format!("#{}", columns::KEYFRAMES);
    text.push_str(if several { ",camera\n" } else { "\n" });
    for keyframe in &contents.keyframes {
        let pose = &keyframe.global_from_keyframe.pose;
        let covariance = &keyframe.global_from_keyframe.covariance;
        let [theta, position] = sigmas(covariance).unwrap_or_else(|| mean_sigmas(covariance));
        let q = pose.rotation.quaternion();
        let p = &pose.translation;
        let values = [p.x, p.y, p.z, q.w, q.i, q.j, q.k, theta, position];
        let _ = write!(text, "{},{}", keyframe.id, keyframe.stamp_ns);
        push_numbers(&mut text, values);
        if several {
            let index = cameras.iter().position(|camera| **camera == keyframe.camera).unwrap_or_default();
            let _ = write!(text, ",{index}");
        }
        text.push('\n');
    }
    text
}

fn landmarks_text(contents: &MapContents) -> String {
    let mut text = format!("#{}\n", columns::LANDMARKS);
    for landmark in &contents.landmarks {
        let _ = write!(text, "{},{}", landmark.id, landmark.anchor);
        push_numbers(&mut text, landmark.position_in_anchor.iter().copied());
        text.push('\n');
    }
    text
}

fn observations_text(contents: &MapContents) -> String {
    let mut text = format!("#{}\n", columns::OBSERVATIONS);
    for landmark in &contents.landmarks {
        for observation in &landmark.observations {
            let [u, v] = observation.pixel.map(shortest_single);
            let descriptor = hexadecimal::encode(&observation.descriptor);
            let _ = writeln!(text, "{},{},{u},{v},{descriptor}", landmark.id, observation.keyframe);
        }
    }
    text
}

fn covariances_text(contents: &MapContents) -> Option<String> {
    let mut text = format!("#{}\n", columns::COVARIANCES);
    let mut any = false;
    for keyframe in &contents.keyframes {
        let covariance = &keyframe.global_from_keyframe.covariance;
        if sigmas(covariance).is_none() {
            any = true;
            let _ = write!(text, "{}", keyframe.id);
            push_numbers(&mut text, covariance.transpose().iter().copied());
            text.push('\n');
        }
    }
    any.then_some(text)
}

fn cross_covariances_text(contents: &MapContents) -> Option<String> {
    let mut text = format!("#{}\n", columns::CROSS_COVARIANCES);
    for cross in &contents.cross_covariances {
        let _ = write!(text, "{},{}", cross.a, cross.b);
        push_numbers(&mut text, cross.block.transpose().iter().copied());
        text.push('\n');
    }
    (!contents.cross_covariances.is_empty()).then_some(text)
}

fn common_errors_text(contents: &MapContents) -> Option<String> {
    let mut text = format!("#{}\n", columns::COMMON_ERRORS);
    for common in &contents.common_errors {
        let _ = write!(text, "{}", common.keyframe);
        push_numbers(&mut text, common.factor.iter().copied());
        text.push('\n');
    }
    (!contents.common_errors.is_empty()).then_some(text)
}

fn aliases_text(contents: &MapContents) -> Option<String> {
    let mut text = format!("#{}\n", columns::ALIASES);
    for aliases in &contents.aliases {
        if aliases.places.is_empty() {
            let _ = writeln!(text, "{}", aliases.keyframe);
        }
        for place in &aliases.places {
            let _ = writeln!(text, "{},{},{}", aliases.keyframe, place.keyframe, place.log_odds);
        }
    }
    (!contents.aliases.is_empty()).then_some(text)
}

fn existence_text(contents: &MapContents) -> Option<String> {
    let mut text = format!("#{}\n", columns::EXISTENCE);
    for of in &contents.existence {
        let _ = writeln!(text, "{},{},{},{}", of.landmark, of.log_odds, of.stamp_ns, of.seen_ns);
    }
    (!contents.existence.is_empty()).then_some(text)
}

fn features_text(contents: &MapContents) -> Option<String> {
    let mut text = format!("#{}\n", columns::FEATURES);
    let mut any = false;
    for keyframe in &contents.keyframes {
        let Some(features) = &keyframe.features else { continue };
        any = true;
        if features.pixels.is_empty() {
            let _ = writeln!(text, "{}", keyframe.id);
        }
        let descriptors = features.descriptors.bytes.chunks(usize::from(features.descriptors.width));
        for (pixel, descriptor) in features.pixels.iter().zip(descriptors) {
            let [u, v] = pixel.map(shortest_single);
            let _ = writeln!(text, "{},{u},{v},{}", keyframe.id, hexadecimal::encode(descriptor));
        }
    }
    any.then_some(text)
}

fn push_numbers(text: &mut String, values: impl IntoIterator<Item = f64>) {
    for value in values {
        text.push(',');
        text.push_str(&shortest(value));
    }
}
