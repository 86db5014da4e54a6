//! Which topics of a bag are the cameras, and which camera of a calibration each of them is.

use super::messages::{self, RecordedImage};
use super::recorded_calibration;
use super::topics::{IMAGES, listed, named, of_types, wrong};
use crate::ros_sensors::camera_of_images;
use crate::{CalibrationFiles, SequenceError};
use bags::Bag;
use calibration::kalibr::{COMPRESSED, is_same_camera};

/// Depths, which have the type of compressed images.
const COMPRESSED_DEPTH: &str = "/compressedDepth";
/// Pixels that are depths where the topic's name says nothing else.
const DEPTH_ENCODINGS: [&str; 2] = ["16UC1", "32FC1"];
/// Drivers name topics of depths so.
const DEPTH: &str = "depth";

/// The cameras of a bag.
pub(super) struct FoundCameras {
    /// Their topics.
    pub(super) topics: Vec<usize>,
    /// What other topics are not used, and why.
    pub(super) notes: Vec<String>,
}

/// Finds the cameras: the topics that are named, else those that the calibration names, else all that Driftless recorded, else one or two in
/// order of their names, since the others of a device may see depths or colours.
///
/// # Arguments
/// * `calibrated`: the topic of each camera of the calibration, where that states it (Kalibr's `rostopic`).
pub(super) fn find(
    bag: &Bag,
    files: &CalibrationFiles,
    calibrated: &[Option<String>],
) -> Result<FoundCameras, SequenceError> {
    match files.camera_topics.as_slice() {
        [] => choose(bag, calibrated),
        named => {
            let topics = named.iter().map(|name| find_named(bag, name));
            Ok(FoundCameras { topics: topics.collect::<Result<_, _>>()?, notes: Vec::new() })
        }
    }
}

fn find_named(bag: &Bag, name: &str) -> Result<usize, SequenceError> {
    let topic = named(bag, name, "--camera-topic", &IMAGES)?;
    // 16 bits may also be those of an infrared camera.
    let is_depth = match encoding(bag, topic).as_deref().and_then(depth_encoding) {
        Some("32FC1") => true,
        Some(_) => is_named_depth(&bag.topics()[topic].name),
        None => false,
    };
    if is_depth || bag.topics()[topic].name.ends_with(COMPRESSED_DEPTH) {
        let list = listed(bag, candidates(bag, &mut Vec::new()).into_iter());
        return Err(wrong(
            bag,
            format!("--camera-topic {name} holds depths, and is no camera; name one of:{list}"),
        ));
    }
    Ok(topic)
}

fn choose(bag: &Bag, calibrated: &[Option<String>]) -> Result<FoundCameras, SequenceError> {
    let topics = bag.topics();
    let mut notes = Vec::new();
    let found = candidates(bag, &mut notes);
    let of_camera = |camera: &Option<String>| {
        let name = camera.as_ref()?;
        found.iter().copied().find(|&topic| is_same_camera(&topics[topic].name, name))
    };
    let bound: Vec<usize> = calibrated.iter().filter_map(of_camera).collect();
    if !bound.is_empty() {
        let others = found.iter().filter(|topic| !bound.contains(topic));
        notes.extend(others.map(|&topic| {
            format!("{} is not used: it is no camera of the calibration (rostopic)", topics[topic].name)
        }));
        return Ok(FoundCameras { topics: bound, notes });
    }
    if recorded_calibration::is_own(bag) {
        let number = |topic: &usize| camera_of_images(&topics[*topic].name);
        let mut own: Vec<usize> = found.iter().copied().filter(|topic| number(topic).is_some()).collect();
        own.sort_by_key(number);
        if !own.is_empty() {
            return Ok(FoundCameras { topics: own, notes });
        }
    }
    match found.len() {
        1 | 2 => Ok(FoundCameras { topics: found, notes }),
        0 if !notes.is_empty() => Err(wrong(
            bag,
            format!(
                "no camera is recorded ({}); name one with --camera-topic if it is one",
                notes.join("; ")
            ),
        )),
        0 => {
            let list = listed(bag, 0..topics.len());
            Err(wrong(bag, format!("no images are recorded; the topics are:{list}")))
        }
        _ => {
            let list = listed(bag, found.into_iter());
            let problem = "several topics could be the cameras; name those to use with --camera-topic:";
            Err(wrong(bag, format!("{problem}{list}")))
        }
    }
}

/// The topics that may be cameras. Of one that is recorded as it is and compressed, the first counts; depths are none.
fn candidates(bag: &Bag, notes: &mut Vec<String>) -> Vec<usize> {
    let topics = bag.topics();
    let mut found: Vec<usize> = of_types(bag, &IMAGES).collect();
    let images = found.clone();
    found.retain(|&topic| {
        let name = &topics[topic].name;
        let is_double = |raw: &str| images.iter().any(|&other| topics[other].name == raw);
        if name.ends_with(COMPRESSED_DEPTH) || name.strip_suffix(COMPRESSED).is_some_and(is_double) {
            return false;
        }
        let encoding = encoding(bag, topic).unwrap_or_default();
        let is_depth = is_named_depth(name) || depth_encoding(&encoding).is_some();
        if is_depth {
            notes.push(format!("{name} is taken for depths ({encoding}), not for a camera"));
        }
        !is_depth
    });
    found
}

fn is_named_depth(name: &str) -> bool {
    name.to_ascii_lowercase().contains(DEPTH)
}

fn depth_encoding(encoding: &str) -> Option<&'static str> {
    DEPTH_ENCODINGS.into_iter().find(|depth| encoding.starts_with(depth))
}

/// The encoding of the first image of a topic.
fn encoding(bag: &Bag, topic: usize) -> Option<String> {
    let place = bag.topics()[topic].messages.first()?.place;
    Some(match messages::read_image(bag, topic, place).ok()? {
        RecordedImage::Raw(image) => image.encoding,
        RecordedImage::Compressed(image) => image.format,
    })
}
