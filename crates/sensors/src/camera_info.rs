//! Projections of cameras as `sensor_msgs/CameraInfo`, and back.

use crate::SequenceError;
use calibration::Lens;
use calibration::kalibr::COMPRESSED;
use geometry::camera::{Camera, Distortion};
use ros_messages::sensor_msgs::CameraInfo;
use ros_messages::std_msgs::Header;
use std::path::Path;

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
/// [`SequenceError`]: a distortion that is not supported, numbers that are no projection.
pub fn camera_of_info(
    message: &CameraInfo,
    images: &str,
    name: &Path,
) -> Result<Option<Camera>, SequenceError> {
    let CameraInfo { k, p, d, .. } = message;
    if k[0] == 0.0 {
        return Ok(None);
    }
    let wrong = |problem: String| SequenceError::calibration(name, problem);
    let is_rectified =
        images.trim_end_matches(COMPRESSED).rsplit('/').next().is_some_and(|last| RECTIFIED.contains(&last));
    let of_sensor = if is_rectified { [p[0], p[5], p[2], p[6]] } else { [k[0], k[4], k[2], k[5]] };
    let (resolution, intrinsics) = of_images(message, of_sensor);
    let is_undistorted = is_rectified || d.iter().all(|value| *value == 0.0);
    if message.distortion_model.is_empty() && !is_undistorted {
        return Err(wrong(
            "distortion_model is empty, but there are coefficients (D): have the driver name plumb_bob or equidistant, or state \
             distortion_model and distortion_coeffs in --calibration"
                .to_owned(),
        ));
    }
    if d.is_empty() && !is_rectified && !message.distortion_model.is_empty() {
        tracing::warn!(
            "{}: there are no coefficients (D) of distortion_model {}: the images are taken for undistorted",
            name.display(),
            message.distortion_model
        );
    }
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
        resolution,
        camera_model: None,
        intrinsics: &intrinsics,
        distortion_model: Some(model),
        distortion: &d[..wanted.min(d.len())],
        distortion_key: "coefficients (D)",
    };
    Ok(Some(lens.camera(name)?))
}

/// Resolution and intrinsics (focal lengths, principal point) of the images: the message states those of the whole sensor at full
/// resolution, a region of it in its pixels, and then the binning.
fn of_images(message: &CameraInfo, [fu, fv, cu, cv]: [f64; 4]) -> ([u32; 2], [f64; 4]) {
    let CameraInfo { roi, width, height, .. } = message;
    let [width, height] =
        if (roi.width, roi.height) == (0, 0) { [*width, *height] } else { [roi.width, roi.height] };
    // Zero means one.
    let [horizontal, vertical] = [message.binning_x, message.binning_y].map(|pixels| pixels.max(1));
    let [by_u, by_v] = [horizontal, vertical].map(f64::from);
    let [u, v] = [roi.x_offset, roi.y_offset].map(f64::from);
    ([width / horizontal, height / vertical], [fu / by_u, fv / by_v, (cu - u) / by_u, (cv - v) / by_v])
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
    fn binning_and_a_region_of_interest_are_those_of_the_images() {
        let mut message = camera_info_message(&camera(Distortion::None), Header::default());
        (message.binning_x, message.binning_y) = (2, 4);
        let binned = read(&message, "/cam0/image_raw").unwrap().unwrap();
        assert_eq!((binned.width, binned.height), (376, 120));
        assert_eq!((binned.focal, binned.centre), ([229.3, 114.325], [183.6, 62.1]));
        (message.roi.x_offset, message.roi.y_offset) = (100, 40);
        (message.roi.width, message.roi.height) = (400, 200);
        let part = read(&message, "/cam0/image_raw").unwrap().unwrap();
        assert_eq!((part.width, part.height), (200, 50));
        assert!((part.centre[0] - 133.6).abs() < 1e-9 && (part.centre[1] - 52.1).abs() < 1e-9);
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
        assert!(refused(&|message| message.d[4] = 0.1).contains("coefficient 5"));
        let unnamed = |message: &mut CameraInfo| {
            message.distortion_model.clear();
            message.d[0] = 0.1;
        };
        assert!(refused(&unnamed).contains("distortion_model is empty"));
        assert!(refused(&|message| message.k[4] = f64::NAN).contains("/cam0/camera_info"));
        let other = |message: &mut CameraInfo| {
            message.distortion_model = "mei".to_owned();
            message.d[0] = 0.1;
        };
        assert!(refused(&other).contains("mei"));
    }
}
