//! The calibration that a bag carries within itself: `CameraInfo`, `/tf_static`, and the noise of the IMU, for which ROS has no
//! message, in the text of a recording of Driftless.

use super::BagCamera;
use super::messages;
use super::topics::BagSensors;
use crate::camera_info::camera_of_info;
use crate::ros_bag::{
    GNSS_ENTRY, IMU_ENTRY, IMU_FRAME_ENTRY, METADATA, WHEELS_ENTRY, delay_entry, rate_entry, readout_entry,
};
use crate::ros_sensors::CameraTiming;
use crate::static_transforms::StaticTransforms;
use crate::{GnssSensor, ImuSensor, SequenceError, WheelSensor};
use bags::{Bag, Metadata};
use calibration::{sensor_yaml, wheel_yaml};
use geometry::camera::Camera;
use geometry::pose::Pose;
use ros_messages::sensor_msgs::{CameraInfo, Imu};
use ros_messages::tf2_msgs::TFMessage;
use std::path::PathBuf;

/// Last part of the name of the topic of static transforms, and its type.
const TF_STATIC: &str = "tf_static";
const TF_TYPE: &str = "tf2_msgs/TFMessage";

/// What a bag lacks of a calibration.
#[derive(Debug, thiserror::Error)]
pub(super) enum NotRecorded {
    /// A camera without projection.
    #[error("no CameraInfo of {images} is recorded")]
    Projection {
        /// Topic of its images.
        images: String,
    },
    /// A camera of which it is not known where it is.
    #[error("/tf_static does not say where {camera:?} is on {imu:?}")]
    Mounting {
        /// Frame of the IMU; empty where it has none.
        imu: String,
        /// Frame of the camera.
        camera: String,
    },
    /// A projection that cannot be used.
    #[error(transparent)]
    Sequence(#[from] SequenceError),
}

/// Projection and `imu_from_camera` of each camera.
pub(super) fn cameras(bag: &Bag, sensors: &BagSensors) -> Result<Vec<(Camera, Pose)>, NotRecorded> {
    let written = || own(bag).and_then(|metadata| metadata.entries.get(IMU_FRAME_ENTRY)).cloned();
    let imu = match sensors.imu {
        Some(imu) => imu_frame(bag, imu),
        None => written().unwrap_or_default(),
    };
    let transforms = static_transforms(bag);
    let mut cameras = Vec::new();
    for camera in &sensors.cameras {
        let Some((projection, frame)) = projection(bag, camera)? else {
            let images = bag.topics()[camera.images].name.clone();
            return Err(NotRecorded::Projection { images });
        };
        let Some(imu_from_camera) = transforms.between(&imu, &frame) else {
            return Err(NotRecorded::Mounting { imu, camera: frame });
        };
        geometry::check_mount(&imu_from_camera).map_err(|error| {
            SequenceError::calibration(bag.path(), format!("{frame} on /tf_static: {error}"))
        })?;
        cameras.push((projection, imu_from_camera));
    }
    Ok(cameras)
}

/// The projection of a camera as the first sound `CameraInfo` states it, and the name of its frame; `None` where none is recorded, or
/// none is stated.
pub(super) fn projection(bag: &Bag, camera: &BagCamera) -> Result<Option<(Camera, String)>, SequenceError> {
    let Some(info) = camera.info else { return Ok(None) };
    let Some(found) = messages::first::<CameraInfo>(bag, info) else { return Ok(None) };
    let name: PathBuf = format!("{}, {}", bag.path().display(), bag.topics()[info].name).into();
    let projection = camera_of_info(&found, &bag.topics()[camera.images].name, &name)?;
    Ok(projection.map(|projection| (projection, found.header.frame_id)))
}

/// Whether Driftless recorded the sensors: the images are stamped on the clock of the IMU then.
pub(super) fn is_own(bag: &Bag) -> bool {
    own(bag).is_some()
}

/// The IMU of a recording of Driftless.
pub(super) fn imu(bag: &Bag) -> Result<Option<ImuSensor>, SequenceError> {
    let Some((name, text)) = entry(bag, IMU_ENTRY) else { return Ok(None) };
    Ok(Some(sensor_yaml::imu_of_text(&name, text)?))
}

/// The wheels of a recording of Driftless.
pub(super) fn wheels(bag: &Bag) -> Result<Option<WheelSensor>, SequenceError> {
    let Some((name, text)) = entry(bag, WHEELS_ENTRY) else { return Ok(None) };
    Ok(Some(wheel_yaml::wheels_of_text(&name, text)?))
}

/// The antenna of GNSS of a recording of Driftless.
pub(super) fn gnss(bag: &Bag) -> Result<Option<GnssSensor>, SequenceError> {
    let Some((name, text)) = entry(bag, GNSS_ENTRY) else { return Ok(None) };
    Ok(Some(sensor_yaml::gnss_of_text(&name, text)?))
}

/// A text of a recording of Driftless, and what it is called in errors.
fn entry<'a>(bag: &'a Bag, name: &str) -> Option<(PathBuf, &'a String)> {
    let text = own(bag)?.entries.get(name)?;
    Some((format!("{}, {name}", bag.path().display()).into(), text))
}

/// The stated rates, readout times and delays of all cameras, of a recording of Driftless.
pub(super) fn timing(bag: &Bag, sensors: &BagSensors) -> Option<Vec<CameraTiming>> {
    let entries = &own(bag)?.entries;
    let number = |entry: &String| entries.get(entry)?.parse().ok().filter(|number: &f64| number.is_finite());
    let of = |camera: &BagCamera| {
        let topic = &bag.topics()[camera.info?].name;
        let rate_hz = number(&rate_entry(topic)).filter(|rate_hz| *rate_hz > 0.0)?;
        let [readout_s, delay_s] =
            [readout_entry(topic), delay_entry(topic)].map(|entry| number(&entry).unwrap_or_default());
        Some(CameraTiming { rate_hz, readout_s, delay_s })
    };
    sensors.cameras.iter().map(of).collect()
}

fn own(bag: &Bag) -> Option<&Metadata> {
    bag.metadata().iter().find(|metadata| metadata.name == METADATA)
}

/// All messages of `/tf_static`, also of one in a namespace.
pub(super) fn static_transforms(bag: &Bag) -> StaticTransforms {
    let mut transforms = StaticTransforms::default();
    for (index, topic) in bag.topics().iter().enumerate() {
        if topic.type_name != TF_TYPE || topic.name.rsplit('/').next() != Some(TF_STATIC) {
            continue;
        }
        let messages = topic.messages.iter().map(|message| messages::read(bag, index, message.place));
        messages
            .filter_map(|message: Result<TFMessage, _>| message.ok())
            .for_each(|message| transforms.add(&message));
    }
    transforms
}

/// The frame of the IMU, as its first message names it.
pub(super) fn imu_frame(bag: &Bag, imu: usize) -> String {
    messages::first::<Imu>(bag, imu).map(|message| message.header.frame_id).unwrap_or_default()
}
