//! Projections of cameras as `sensor_msgs/CameraInfo`, and back.

use crate::SequenceError;
use crate::calibration_yaml::Lens;
use geometry::camera::{Camera, Distortion};
use ros_messages::sensor_msgs::CameraInfo;
use ros_messages::std_msgs::Header;
use std::path::Path;

/// How image_transport ends the topic of compressed images.
const COMPRESSED: &str = "/compressed";
/// ROS calls rectified images so, at the end of the topic's name.
const RECTIFIED: [&str; 3] = ["image_rect", "image_rect_color", "image_rect_raw"];

/// The topic of a camera's `CameraInfo` by that of its images, as image_transport pairs them.
///
/// ```
/// use sensors::ros::camera_info_topic;
/// assert_eq!(camera_info_topic("/cam0/image_raw/compressed"), "/cam0/camera_info");
/// assert_eq!(camera_info_topic("image"), "camera_info");
/// ```
pub fn camera_info_topic(images: &str) -> String {
    match images.trim_end_matches(COMPRESSED).rsplit_once('/') {
        Some((namespace, _)) => format!("{namespace}/camera_info"),
        None => "camera_info".to_owned(),
    }
}

/// The projection that a message states; `None` for a camera without calibration, whose message is of zeros.
///
/// # Arguments
/// * `images`: the topic of the images, whose name says whether they are rectified.
/// * `name`: of the topic, for errors.
///
/// # Errors
/// [`SequenceError`]: a distortion that is not supported, binning or a region of interest, numbers that are no projection.
pub fn camera_of_info(
    message: &CameraInfo,
    images: &str,
    name: &Path,
) -> Result<Option<Camera>, SequenceError> {
    let CameraInfo { k, p, d, roi, width, height, .. } = message;
    if k[0] == 0.0 {
        return Ok(None);
    }
    let wrong = |problem: String| SequenceError::calibration(name, problem);
    let is_part = (roi.width, roi.height) != (0, 0) && (roi.width, roi.height) != (*width, *height);
    if message.binning_x.max(message.binning_y) > 1 || is_part {
        let problem = "binning and regions of interest are not supported: give the calibration of these images in a file";
        return Err(wrong(problem.to_owned()));
    }
    let is_rectified =
        images.trim_end_matches(COMPRESSED).rsplit('/').next().is_some_and(|last| RECTIFIED.contains(&last));
    let intrinsics = if is_rectified { [p[0], p[5], p[2], p[6]] } else { [k[0], k[4], k[2], k[5]] };
    let is_undistorted = is_rectified || d.iter().all(|value| *value == 0.0);
    // Higher orders of the distortion are zero in most calibrations, and not supported in the others.
    let (model, wanted) = match message.distortion_model.as_str() {
        _ if is_undistorted => ("none", 0),
        "plumb_bob" | "rational_polynomial" | "radtan" => ("plumb_bob", 4),
        "equidistant" | "fisheye" => ("equidistant", 4),
        other => (other, d.len()),
    };
    if let Some(order) = d.iter().skip(wanted).position(|value| *value != 0.0)
        && !is_undistorted
    {
        return Err(wrong(format!(
            "coefficient {} of distortion_model {} is not zero, and only the first {wanted} are supported: calibrate with \
             plumb_bob and k3 = 0, or equidistant",
            wanted + order + 1,
            message.distortion_model
        )));
    }
    let lens = Lens {
        resolution: [*width, *height],
        camera_model: None,
        intrinsics: &intrinsics,
        distortion_model: Some(model),
        distortion: &d[..wanted.min(d.len())],
        distortion_key: "coefficients (D)",
    };
    lens.camera(name).map(Some)
}

/// The name of the FOV model in messages. ROS has none, so that nodes of others refuse it.
const FOV: &str = "fov";

/// A projection as a message. [`camera_of_info`] reads it back with all digits.
///
/// The model of the distortion is `plumb_bob` or `equidistant`; ROS has no name for the FOV model, which is written as `fov`: nodes of others
/// refuse it.
pub fn camera_info_message(camera: &Camera, header: Header) -> CameraInfo {
    let (distortion_model, d) = match camera.distortion {
        Distortion::None => ("plumb_bob", vec![0.0; 5]),
        Distortion::RadialTangential([k1, k2, p1, p2]) => ("plumb_bob", vec![k1, k2, p1, p2, 0.0]),
        Distortion::Equidistant(k) => ("equidistant", k.to_vec()),
        Distortion::Fov(omega) => (FOV, vec![omega]),
    };
    let ([fu, fv], [cu, cv]) = (camera.focal, camera.centre);
    CameraInfo {
        header,
        height: camera.height,
        width: camera.width,
        distortion_model: distortion_model.to_owned(),
        d,
        k: [fu, 0.0, cu, 0.0, fv, cv, 0.0, 0.0, 1.0],
        r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: [fu, 0.0, cu, 0.0, 0.0, fv, cv, 0.0, 0.0, 0.0, 1.0, 0.0],
        ..CameraInfo::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(distortion: Distortion) -> Camera {
        Camera { width: 752, height: 480, focal: [458.6, 457.3], centre: [367.2, 248.4], distortion }
    }

    fn read(message: &CameraInfo, images: &str) -> Result<Option<Camera>, SequenceError> {
        camera_of_info(message, images, Path::new("/cam0/camera_info"))
    }

    #[test]
    fn a_projection_survives_as_a_message() {
        let coefficients = [-0.28, 0.07, 0.0002, 0.00002];
        for distortion in [
            Distortion::None,
            Distortion::RadialTangential(coefficients),
            Distortion::Equidistant(coefficients),
            Distortion::Fov(0.9),
        ] {
            let message = camera_info_message(&camera(distortion), Header::default());
            assert_eq!(read(&message, "/cam0/image_raw").unwrap(), Some(camera(distortion)));
            // Rectified images have none.
            let rectified = read(&message, "/cam0/image_rect/compressed").unwrap().unwrap();
            assert_eq!(rectified, camera(Distortion::None));
        }
    }

    #[test]
    fn what_is_no_projection_of_the_images_is_refused() {
        assert_eq!(read(&CameraInfo::default(), "/image_raw").unwrap(), None);
        let good = camera_info_message(&camera(Distortion::None), Header::default());
        let refused = |change: &dyn Fn(&mut CameraInfo)| {
            let mut message = good.clone();
            change(&mut message);
            read(&message, "/cam0/image_raw").unwrap_err().to_string()
        };
        assert!(refused(&|message| message.binning_x = 2).contains("binning"));
        assert!(refused(&|message| message.roi.width = 10).contains("regions of interest"));
        assert!(refused(&|message| message.d[4] = 0.1).contains("coefficient 5"));
        assert!(refused(&|message| message.k[4] = f64::NAN).contains("/cam0/camera_info"));
        let other = |message: &mut CameraInfo| {
            message.distortion_model = "mei".to_owned();
            message.d[0] = 0.1;
        };
        assert!(refused(&other).contains("mei"));
    }
}
