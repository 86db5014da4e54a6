//! Which topics of a bag are the IMU and the cameras.

use super::camera_topics::{self, FoundCameras};
use super::{calibration, foxglove, imu_topics, index};
use crate::{CalibrationFiles, SequenceError};
use bags::{Bag, Topic};
use std::fmt::Write;

pub(super) const IMU: &str = "sensor_msgs/Imu";
pub(super) const IMAGE: &str = "sensor_msgs/Image";
pub(super) const COMPRESSED_IMAGE: &str = "sensor_msgs/CompressedImage";
/// Types of images.
pub(super) const IMAGES: [&str; 4] =
    [IMAGE, COMPRESSED_IMAGE, foxglove::RAW_IMAGE, foxglove::COMPRESSED_IMAGE];
/// Types of wheels.
pub(super) const JOINT_STATE: &str = "sensor_msgs/JointState";
pub(super) const ODOMETRY: &str = "nav_msgs/Odometry";
/// Type of GNSS.
pub(super) const NAV_SAT_FIX: &str = "sensor_msgs/NavSatFix";
/// Type of positions in the frame of the map.
pub(super) const POSITION: &str = "geometry_msgs/PoseWithCovarianceStamped";
pub(super) const CAMERA_INFO: &str = "sensor_msgs/CameraInfo";

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
    /// The IMU, or its gyroscope, if there is one.
    pub imu: Option<usize>,
    /// The accelerometer, where it has a topic of its own.
    pub accelerometer: Option<usize>,
    /// The cameras, in order.
    pub cameras: Vec<BagCamera>,
    /// Topics that are no cameras of this robot, and why, a line each.
    pub notes: Vec<String>,
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
    /// Finds the sensors: the topics that are named, else the only IMU (or gyroscope and accelerometer), and the cameras that
    /// the calibration names by its `rostopic`, else all that Driftless recorded, else one or two in order of their names. Of a camera that is recorded as it
    /// is and compressed, the first counts; depths are no camera.
    ///
    /// # Errors
    /// [`SequenceError::Topics`]: several topics could be meant and none is named, a named topic is not there or of
    /// another type, or there is no camera.
    pub fn find(bag: &Bag, files: &CalibrationFiles) -> Result<Self, SequenceError> {
        let calibrated = calibration::camera_topics(bag, files);
        let FoundCameras { topics, notes } = camera_topics::find(bag, files, &calibrated)?;
        let (imu, accelerometer) = imu_topics::find(bag, files)?;
        let camera = |images| BagCamera { images, info: info_of(bag, images) };
        Ok(Self { imu, accelerometer, cameras: topics.into_iter().map(camera).collect(), notes })
    }

    /// The stamps in the headers of a topic of readings or images, in order and without single wrong ones, nanoseconds; `None`
    /// of a topic of another type, or with unreadable messages only.
    ///
    /// # Arguments
    /// * `topic`: index in [`Bag::topics`].
    pub fn stamps(bag: &Bag, topic: usize) -> Option<Vec<i64>> {
        let type_name = bag.topics().get(topic)?.type_name.as_str();
        let is_sensor = type_name == IMU || IMAGES.contains(&type_name);
        let stamps = is_sensor.then(|| index::stamps(bag, topic))?;
        (!stamps.is_empty()).then_some(stamps)
    }
}

pub(super) fn wrong(bag: &Bag, problem: impl Into<String>) -> SequenceError {
    SequenceError::Topics { path: bag.path().to_path_buf(), problem: problem.into() }
}

/// The topic with messages that has a name.
pub(super) fn named(bag: &Bag, name: &str, switch: &str, types: &[&str]) -> Result<usize, SequenceError> {
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
pub(super) fn of_types<'a>(bag: &'a Bag, types: &'a [&'a str]) -> impl Iterator<Item = usize> + 'a {
    let fits = |topic: &Topic| types.contains(&topic.type_name.as_str()) && !topic.messages.is_empty();
    bag.topics().iter().enumerate().filter(move |(_, topic)| fits(topic)).map(|(index, _)| index)
}

pub(super) fn listed(bag: &Bag, topics: impl Iterator<Item = usize>) -> String {
    let mut text = String::new();
    for topic in topics.map(|index| &bag.topics()[index]) {
        let _ = write!(text, "\n  {} ({}, {} messages)", topic.name, topic.type_name, topic.messages.len());
    }
    if text.is_empty() { " none".to_owned() } else { text }
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
