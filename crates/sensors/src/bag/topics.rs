//! Which topics of a bag are the IMU and the cameras.

use crate::{CalibrationFiles, SequenceError};
use bags::{Bag, Topic};
use std::fmt::Write;

pub(super) const IMU: &str = "sensor_msgs/Imu";
pub(super) const IMAGE: &str = "sensor_msgs/Image";
pub(super) const COMPRESSED_IMAGE: &str = "sensor_msgs/CompressedImage";
pub(super) const CAMERA_INFO: &str = "sensor_msgs/CameraInfo";

/// The last part of a topic's name that image_transport adds to the name of the uncompressed images.
const COMPRESSED: &str = "/compressed";
/// Depths, which have the type of compressed images.
const COMPRESSED_DEPTH: &str = "/compressedDepth";

/// The sensors of a bag, as indices of [`Bag::topics`].
///
/// ```no_run
/// use sensors::{BagSensors, CalibrationFiles};
///
/// let bag = bags::Bag::open("drive.mcap".as_ref())?;
/// let found = BagSensors::find(&bag, &CalibrationFiles::default())?;
/// println!("{} cameras", found.cameras.len());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BagSensors {
    /// The IMU, if there is one.
    pub imu: Option<usize>,
    /// One camera or two, in order.
    pub cameras: Vec<BagCamera>,
}

/// A camera in a bag.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BagCamera {
    /// Its images.
    pub images: usize,
    /// Its `CameraInfo`, if it is recorded.
    pub info: Option<usize>,
}

impl BagSensors {
    /// Finds the sensors: the topics that are named, else the only IMU, and one or two cameras in order of their
    /// names. Of a camera that is recorded as it is and compressed, the first counts.
    ///
    /// # Errors
    /// [`SequenceError::Topics`]: several topics could be meant and none is named, a named topic is not there or of
    /// another type, or there is no camera.
    pub fn find(bag: &Bag, files: &CalibrationFiles) -> Result<Self, SequenceError> {
        let cameras = match files.camera_topics.as_slice() {
            [] => find_cameras(bag)?,
            [_] | [_, _] => {
                let find = |name: &String| named(bag, name, "--camera-topic", &[IMAGE, COMPRESSED_IMAGE]);
                files.camera_topics.iter().map(find).collect::<Result<_, _>>()?
            }
            _ => return Err(wrong(bag, "three cameras are named with --camera-topic: at most two are used")),
        };
        let imu = match &files.imu_topic {
            Some(name) => Some(named(bag, name, "--imu-topic", &[IMU])?),
            None => find_imu(bag)?,
        };
        let camera = |images| BagCamera { images, info: info_of(bag, images) };
        Ok(Self { imu, cameras: cameras.into_iter().map(camera).collect() })
    }
}

fn wrong(bag: &Bag, problem: impl Into<String>) -> SequenceError {
    SequenceError::Topics { path: bag.path().to_path_buf(), problem: problem.into() }
}

/// The topic with messages that has a name.
fn named(bag: &Bag, name: &str, switch: &str, types: &[&str]) -> Result<usize, SequenceError> {
    let is_named = |topic: &Topic| topic.name.trim_start_matches('/') == name.trim_start_matches('/');
    let Some(index) = bag.topics().iter().position(is_named) else {
        let fitting = listed(bag, of_types(bag, types));
        return Err(wrong(bag, format!("{switch} {name} is not recorded; of this kind are:{fitting}")));
    };
    let topic = &bag.topics()[index];
    if !types.contains(&topic.type_name.as_str()) {
        let problem =
            format!("{switch} {name} is of type {}, but {} is needed", topic.type_name, types.join(" or "));
        return Err(wrong(bag, problem));
    }
    if topic.messages.is_empty() {
        return Err(wrong(bag, format!("{switch} {name} has no messages")));
    }
    Ok(index)
}

/// The topics of some types that have messages.
fn of_types<'a>(bag: &'a Bag, types: &'a [&'a str]) -> impl Iterator<Item = usize> + 'a {
    let fits = |topic: &Topic| types.contains(&topic.type_name.as_str()) && !topic.messages.is_empty();
    bag.topics().iter().enumerate().filter(move |(_, topic)| fits(topic)).map(|(index, _)| index)
}

fn listed(bag: &Bag, topics: impl Iterator<Item = usize>) -> String {
    let mut text = String::new();
    for topic in topics.map(|index| &bag.topics()[index]) {
        let _ = write!(text, "\n  {} ({}, {} messages)", topic.name, topic.type_name, topic.messages.len());
    }
    if text.is_empty() { " none".to_owned() } else { text }
}

fn find_imu(bag: &Bag) -> Result<Option<usize>, SequenceError> {
    let found: Vec<usize> = of_types(bag, &[IMU]).collect();
    if found.len() < 2 {
        return Ok(found.first().copied());
    }
    let list = listed(bag, found.into_iter());
    Err(wrong(bag, format!("several topics could be the IMU; name one with --imu-topic:{list}")))
}

fn find_cameras(bag: &Bag) -> Result<Vec<usize>, SequenceError> {
    let topics = bag.topics();
    let mut found: Vec<usize> = of_types(bag, &[IMAGE, COMPRESSED_IMAGE]).collect();
    let images = found.clone();
    found.retain(|&index| {
        let name = &topics[index].name;
        let is_double = |raw: &str| images.iter().any(|&other| topics[other].name == raw);
        !name.ends_with(COMPRESSED_DEPTH) && !name.strip_suffix(COMPRESSED).is_some_and(is_double)
    });
    match found.len() {
        1 | 2 => Ok(found),
        0 => Err(wrong(
            bag,
            format!("no images are recorded; the topics are:{}", listed(bag, 0..topics.len())),
        )),
        _ => {
            let list = listed(bag, found.into_iter());
            Err(wrong(
                bag,
                format!("several topics could be the cameras; name one or two with --camera-topic:{list}"),
            ))
        }
    }
}

/// The `CameraInfo` of a camera: `camera_info` in the namespace of its images, or in one around it.
fn info_of(bag: &Bag, images: usize) -> Option<usize> {
    let mut name = bag.topics()[images].name.as_str();
    while let Some((namespace, _)) = name.rsplit_once('/') {
        let wanted = format!("{namespace}/camera_info");
        if let Some(index) = of_types(bag, &[CAMERA_INFO]).find(|&index| bag.topics()[index].name == wanted) {
            return Some(index);
        }
        name = namespace;
    }
    None
}
