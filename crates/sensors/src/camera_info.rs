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
    let (camera_model, distortion_model, before, given) =
        if is_undistorted { ("pinhole", "none", 0, 0) } else { layout(message, name)? };
    let mut coefficients = d.clone();
    coefficients.resize(d.len().max(before + given), 0.0);
    let intrinsics = [&coefficients[..before], &intrinsics[..]].concat();
    let lens = Lens {
        resolution,
        camera_model: Some(camera_model),
        intrinsics: &intrinsics,
        distortion_model: Some(distortion_model),
        distortion: &coefficients[before..before + given],
        distortion_key: "coefficients (D)",
    };
    Ok(Some(lens.camera(name)?))
}

/// Models of the camera and of its distortion, how many coefficients belong to the first, and how many to the second.
///
/// # Errors
/// [`SequenceError`]: coefficients that the model does not have.
fn layout<'a>(
    message: &'a CameraInfo,
    name: &Path,
) -> Result<(&'a str, &'a str, usize, usize), SequenceError> {
    let wrong = |problem: String| SequenceError::calibration(name, problem);
    let CameraInfo { d, distortion_model, .. } = message;
    // OpenCV takes 4, 5, 8, 12 or 14 coefficients under either name; the last two, of a tilted sensor, are not supported.
    let last = d.iter().rposition(|value| *value != 0.0).map_or(0, |last| last + 1);
    let (camera_model, model, before, given) = match distortion_model.as_str() {
        "plumb_bob" | "rational_polynomial" | "radtan" => {
            let shortest = [4, 5, 8].into_iter().find(|&count| last <= count).unwrap_or(12);
            ("pinhole", "radtan", 0, shortest)
        }
        "equidistant" | "fisheye" => ("pinhole", "equidistant", 0, 4),
        FOV => ("pinhole", FOV, 0, 1),
        THIN_PRISM_FISHEYE => ("pinhole", THIN_PRISM_FISHEYE, 0, 8),
        "ds" => ("ds", "none", 2, 0),
        "eucm" => ("eucm", "none", 2, 0),
        "omni" => ("omni", "radtan", 1, 4),
        // Named in the error of the reader of calibrations.
        other => ("pinhole", other, 0, d.len()),
    };
    if last > before + given {
        return Err(wrong(format!(
            "coefficient {last} of distortion_model {distortion_model} is not zero, and only the first {} are supported: calibrate with \
             plumb_bob, rational_polynomial without a tilted sensor, or equidistant",
            before + given
        )));
    }
    let fewest = if model == "radtan" && before == 0 { 4 } else { before + given };
    if d.len() < fewest {
        return Err(wrong(format!(
            "distortion_model {distortion_model} has only {} coefficients (D)",
            d.len()
        )));
    }
    Ok((camera_model, model, before, given))
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

/// Names of models that ROS has none for, so that nodes of others refuse them.
const FOV: &str = "fov";
const THIN_PRISM_FISHEYE: &str = "thin_prism_fisheye";

/// Whether ROS has a name for the distortion model of a camera, such that other nodes can use its message.
///
/// ```
/// use geometry::Distortion;
/// use sensors::ros::has_ros_name;
/// assert!(has_ros_name(&Distortion::None) && !has_ros_name(&Distortion::Fov(0.9)));
/// ```
pub fn has_ros_name(distortion: &Distortion) -> bool {
    match distortion {
        Distortion::None
        | Distortion::RadialTangential(_)
        | Distortion::Equidistant(_)
        | Distortion::Rational(_) => true,
        Distortion::Fov(_)
        | Distortion::ThinPrismFisheye(_)
        | Distortion::DoubleSphere { .. }
        | Distortion::Eucm { .. }
        | Distortion::Omni { .. } => false,
    }
}

/// A projection as a message. [`camera_of_info`] reads it back with all digits.
///
/// The model of the distortion is `plumb_bob` (5 coefficients), `rational_polynomial` (8, with a thin prism 12, as OpenCV takes them) or
/// `equidistant`. ROS has no name for the others, which are written as `fov`, `thin_prism_fisheye`, `ds`, `eucm` and `omni` with the
/// coefficients of [`Distortion::coefficients`]: nodes of others refuse them, see [`has_ros_name`].
pub fn camera_info_message(camera: &Camera, header: Header) -> CameraInfo {
    let mut d = camera.distortion.coefficients();
    let distortion_model = match camera.distortion {
        Distortion::None | Distortion::RadialTangential(_) => {
            d.resize(5, 0.0);
            "plumb_bob"
        }
        Distortion::Rational(_) if d.len() == 5 => "plumb_bob",
        Distortion::Rational(_) => "rational_polynomial",
        Distortion::ThinPrismFisheye(_) => THIN_PRISM_FISHEYE,
        other => other.name(),
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
            Distortion::from_opencv(&[-0.28, 0.07, 0.0002, 0.00002, 0.01]).unwrap(),
            Distortion::from_opencv(&[0.5, -2.7, 0.0002, 0.00002, 1.5, 0.4, -2.5, 1.5]).unwrap(),
            Distortion::Rational([0.5, -2.7, 2e-4, 2e-5, 1.5, 0.4, -2.5, 1.5, 1e-3, 2e-3, 3e-3, 4e-3]),
            Distortion::ThinPrismFisheye([0.01, -0.02, 1e-3, 2e-3, 0.003, -4e-4, 1e-3, -1e-3]),
            Distortion::DoubleSphere { xi: -0.2, alpha: 0.57 },
            Distortion::Eucm { alpha: 0.63, beta: 1.04 },
            Distortion::Omni { xi: 1.85, distortion: coefficients },
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
    fn coefficients_of_opencv_are_those_of_the_simplest_model() {
        let mut message = camera_info_message(&camera(Distortion::None), Header::default());
        let twelve = [0.5, -2.7, 2e-4, 2e-5, 1.5, 0.4, -2.5, 1.5, 1e-3, 2e-3, 3e-3, 4e-3];
        for (model, count, given) in [
            ("plumb_bob", 4, 5),
            ("plumb_bob", 5, 5),
            ("rational_polynomial", 4, 8),
            ("rational_polynomial", 8, 8),
        ]
        .into_iter()
        .chain([("rational_polynomial", 12, 14), ("plumb_bob", 8, 8), ("plumb_bob", 4, 4)])
        {
            message.distortion_model = model.to_owned();
            message.d = [&twelve[..count], &vec![0.0; given - count]].concat();
            let read = read(&message, "/cam0/image_raw").unwrap().unwrap();
            assert_eq!(Some(read.distortion), Distortion::from_opencv(&twelve[..count]), "{model} {count}");
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
        let tilted = |message: &mut CameraInfo| {
            message.d.resize(14, 0.0);
            message.d[12] = 0.1;
        };
        assert!(refused(&tilted).contains("coefficient 13"));
        let of_fisheye = |message: &mut CameraInfo| {
            message.distortion_model = "equidistant".to_owned();
            message.d[4] = 0.1;
        };
        assert!(refused(&of_fisheye).contains("coefficient 5"));
        let short = |message: &mut CameraInfo| message.d = vec![0.1, 0.2];
        assert!(refused(&short).contains("only 2 coefficients"));
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
