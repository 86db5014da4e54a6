//! The projection of a camera from its `sensor_msgs/CameraInfo`.

use super::messages;
use crate::SequenceError;
use crate::calibration_yaml::Lens;
use bags::Bag;
use geometry::camera::Camera;
use ros_messages::sensor_msgs::CameraInfo;
use std::path::PathBuf;

/// ROS calls rectified images so, at the end of the topic's name.
const RECTIFIED: [&str; 3] = ["image_rect", "image_rect_color", "image_rect_raw"];

/// Reads the first sound message of a topic.
///
/// # Arguments
/// * `images`: the topic of the images, whose name says whether they are rectified.
pub(super) fn read(bag: &Bag, images: usize, info: usize) -> Result<Option<Camera>, SequenceError> {
    let topic = &bag.topics()[info];
    let mut messages = topic.messages.iter();
    let found = messages.find_map(|message| messages::read::<CameraInfo>(bag, info, message.place).ok());
    // An uncalibrated camera publishes zeros.
    let Some(found) = found.filter(|found| found.k[0] != 0.0) else { return Ok(None) };
    let name: PathBuf = format!("{}, {}", bag.path().display(), topic.name).into();
    let wrong = |problem: String| SequenceError::calibration(&name, problem);
    let roi = &found.roi;
    let is_part = (roi.width, roi.height) != (0, 0) && (roi.width, roi.height) != (found.width, found.height);
    if found.binning_x.max(found.binning_y) > 1 || is_part {
        let problem = "binning and regions of interest are not supported: give the calibration of these images in a file";
        return Err(wrong(problem.to_owned()));
    }
    let image_name = bag.topics()[images].name.trim_end_matches("/compressed");
    let is_rectified = image_name.rsplit('/').next().is_some_and(|last| RECTIFIED.contains(&last));
    let intrinsics = if is_rectified {
        [found.p[0], found.p[5], found.p[2], found.p[6]]
    } else {
        [found.k[0], found.k[4], found.k[2], found.k[5]]
    };
    let is_undistorted = is_rectified || found.d.iter().all(|value| *value == 0.0);
    // Higher orders of the distortion are zero in most calibrations, and not supported in the others.
    let (model, wanted) = match found.distortion_model.as_str() {
        _ if is_undistorted => ("none", 0),
        "plumb_bob" | "rational_polynomial" | "radtan" => ("plumb_bob", 4),
        "equidistant" | "fisheye" => ("equidistant", 4),
        other => (other, found.d.len()),
    };
    if let Some(order) = found.d.iter().skip(wanted).position(|value| *value != 0.0)
        && !is_undistorted
    {
        return Err(wrong(format!(
            "coefficient {} of distortion_model {} is not zero, and only the first {wanted} are supported: calibrate with \
             plumb_bob and k3 = 0, or equidistant",
            wanted + order + 1,
            found.distortion_model
        )));
    }
    let lens = Lens {
        resolution: [found.width, found.height],
        camera_model: None,
        intrinsics: &intrinsics,
        distortion_model: Some(model),
        distortion: &found.d[..wanted.min(found.d.len())],
        distortion_key: "coefficients (D)",
    };
    lens.camera(&name).map(Some)
}
