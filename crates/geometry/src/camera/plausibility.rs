//! What no camera has: parameters that were not calibrated but mistyped, damaged, or made up.
//!
//! Every calibration that is loaded and every query is checked here. The bounds are far from all lenses: what is refused would
//! only cost time, overflow, or make a filter diverge.

use super::{Camera, CameraError, Distortion};
use crate::pose::Pose;

/// Most columns or rows of an image.
pub const MAX_CAMERA_SIDE: u32 = 1 << 16;

/// Least focal length as a fraction of the longer side: a fisheye lens of 180 degrees has 0.3.
pub const MIN_FOCAL: f64 = 0.01;
/// Largest focal length as a multiple of the longer side: a field of view of 0.06 degrees, as of a telescope.
pub const MAX_FOCAL: f64 = 1000.0;

/// How far the principal point may be outside of the image, in longer sides: images are cropped, but not from one ten times as large.
pub const MAX_CENTRE_OFFSET: f64 = 10.0;

/// How many times its distance from the principal point a term of the distortion may move a point of the image. Lenses reach one.
pub const MAX_DISTORTION: f64 = 100.0;

/// Farther from the principal point (normalized coordinates, or rad) no lens has an image: a fisheye lens of 220 degrees reaches 1.9.
const MAX_RADIUS: f64 = 2.0;

/// Longest distance between a camera and the IMU, m: both are on one vehicle, and the longest ships have 400.
pub const MAX_MOUNT_M: f64 = 1000.0;

/// Checks the parameters of a camera that are finite and positive.
pub(super) fn check(camera: &Camera) -> Result<(), CameraError> {
    let Camera { width, height, focal, centre, .. } = *camera;
    if width.max(height) > MAX_CAMERA_SIDE {
        return Err(CameraError::LargeImage { width, height });
    }
    let side = f64::from(width.max(height));
    if !focal.iter().all(|focal| (MIN_FOCAL * side..=MAX_FOCAL * side).contains(focal)) {
        return Err(CameraError::ImplausibleFocalLength { focal, side: width.max(height) });
    }
    let is_near = |(centre, sides): (f64, u32)| {
        let margin = MAX_CENTRE_OFFSET * side;
        (-margin..=f64::from(sides) + margin).contains(&centre)
    };
    if !centre.into_iter().zip([width, height]).all(is_near) {
        return Err(CameraError::ImplausibleCentre(centre[0], centre[1]));
    }
    let effect = largest_term(camera);
    if effect > MAX_DISTORTION { Err(CameraError::ImplausibleDistortion { effect }) } else { Ok(()) }
}

/// The largest term of the distortion at the corner that is farthest from the principal point, relative to the distance.
fn largest_term(camera: &Camera) -> f64 {
    let Camera { width, height, focal, centre, .. } = *camera;
    let reach =
        |side: u32, axis: usize| centre[axis].abs().max((f64::from(side) - centre[axis]).abs()) / focal[axis];
    let radius = reach(width, 0).hypot(reach(height, 1)).min(MAX_RADIUS);
    let squared = radius * radius;
    let terms = match camera.distortion {
        Distortion::None | Distortion::Fov(_) => [0.0; 4],
        Distortion::RadialTangential([k1, k2, p1, p2]) => {
            [k1 * squared, k2 * squared.powi(2), p1 * radius, p2 * radius]
        }
        Distortion::Equidistant([k1, k2, k3, k4]) => {
            [k1 * squared, k2 * squared.powi(2), k3 * squared.powi(3), k4 * squared.powi(4)]
        }
    };
    terms.into_iter().map(f64::abs).fold(0.0, f64::max)
}

/// Checks where a camera is mounted, in the frame of the IMU.
///
/// # Errors
/// [`CameraError::ImplausibleMount`].
///
/// ```
/// use geometry::{Pose, check_mount};
/// use nalgebra::{UnitQuaternion, Vector3};
///
/// let at = |x: f64| Pose::new(UnitQuaternion::identity(), Vector3::x() * x);
/// assert!(check_mount(&at(0.1)).is_ok());
/// assert!(check_mount(&at(1e30)).is_err());
/// ```
pub fn check_mount(imu_from_camera: &Pose) -> Result<(), CameraError> {
    let distance = imu_from_camera.translation.norm();
    if distance <= MAX_MOUNT_M { Ok(()) } else { Err(CameraError::ImplausibleMount { distance }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of a wide-angle lens, of a fisheye lens, and of a long lens, as calibrations state them.
    fn real() -> Vec<Camera> {
        let camera = |side: [u32; 2], focal: f64, distortion| Camera {
            width: side[0],
            height: side[1],
            focal: [focal; 2],
            centre: side.map(|side| f64::from(side) / 2.0),
            distortion,
        };
        vec![
            camera([752, 480], 458.0, Distortion::RadialTangential([-0.283, 0.074, 0.0002, 1.8e-5])),
            camera([512, 512], 190.0, Distortion::Equidistant([0.0034, 0.0007, -0.0020, 0.0002])),
            camera([1920, 1080], 300.0, Distortion::Equidistant([-0.03, 0.08, -0.09, 0.03])),
            camera([1280, 1024], 300_000.0, Distortion::RadialTangential([-20.0, 4000.0, 0.01, 0.01])),
            camera([640, 480], 250.0, Distortion::Fov(0.93)),
        ]
    }

    #[test]
    fn real_lenses_pass_and_absurd_ones_are_named() {
        for camera in real() {
            camera.validate().unwrap();
            for absurd in [1e308, 1e-320, 1e-3, 1e9] {
                let error = Camera { focal: [absurd; 2], ..camera.clone() }.validate().unwrap_err();
                assert!(error.to_string().contains("focal"), "{error}");
            }
            for absurd in [1e30, -1e6] {
                let error = Camera { centre: [absurd, 0.0], ..camera.clone() }.validate().unwrap_err();
                assert!(error.to_string().contains("principal point"), "{error}");
            }
            for huge in [1e30, -1e30, 1e12] {
                for at in 0..4 {
                    let mut k = [0.0; 4];
                    k[at] = huge;
                    for distortion in [Distortion::RadialTangential(k), Distortion::Equidistant(k)] {
                        let error = Camera { distortion, focal: [500.0; 2], ..camera.clone() }.validate();
                        assert!(error.unwrap_err().to_string().contains("distortion"), "{k:?}");
                    }
                }
            }
        }
        let million = Camera { distortion: Distortion::Equidistant([1e6; 4]), ..real()[1].clone() };
        assert!(million.validate().is_err());
        assert!(Camera { width: u32::MAX, ..real()[0].clone() }.validate().is_err());
    }
}
