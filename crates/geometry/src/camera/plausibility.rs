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
/// The same of a term of numerator or denominator of the rational model. Calibrations with too few images have terms of hundreds there,
/// which cancel each other.
pub const MAX_RATIONAL_TERM: f64 = 1e5;

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
    for (effect, limit) in largest_terms(camera) {
        if effect > limit {
            return Err(CameraError::ImplausibleDistortion { effect, limit });
        }
    }
    Ok(())
}

/// The largest terms of the distortion at the corner that is farthest from the principal point, relative to the distance, with their limits.
fn largest_terms(camera: &Camera) -> [(f64, f64); 2] {
    let Camera { width, height, focal, centre, .. } = *camera;
    let reach =
        |side: u32, axis: usize| centre[axis].abs().max((f64::from(side) - centre[axis]).abs()) / focal[axis];
    let radius = reach(width, 0).hypot(reach(height, 1)).min(MAX_RADIUS);
    let power = |value: f64, exponent: i32| (value * radius.powi(exponent)).abs();
    let largest = |terms: &[f64]| terms.iter().copied().fold(0.0, f64::max);
    let mut rational = 0.0;
    let plain = match camera.distortion {
        Distortion::None | Distortion::Fov(_) | Distortion::DoubleSphere { .. } | Distortion::Eucm { .. } => {
            0.0
        }
        Distortion::RadialTangential([k1, k2, p1, p2])
        | Distortion::Omni { distortion: [k1, k2, p1, p2], .. } => {
            largest(&[power(k1, 2), power(k2, 4), power(p1, 1), power(p2, 1)])
        }
        Distortion::Equidistant([k1, k2, k3, k4]) => {
            largest(&[power(k1, 2), power(k2, 4), power(k3, 6), power(k4, 8)])
        }
        Distortion::Rational([k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4]) => {
            let radial = [(k1, 2), (k2, 4), (k3, 6), (k4, 2), (k5, 4), (k6, 6)];
            rational = largest(&radial.map(|(value, exponent)| power(value, exponent)));
            largest(
                &[(p1, 1), (p2, 1), (s1, 1), (s2, 3), (s3, 1), (s4, 3)]
                    .map(|(value, exponent)| power(value, exponent)),
            )
        }
        Distortion::ThinPrismFisheye([k1, k2, p1, p2, k3, k4, sx1, sy1]) => largest(
            &[(k1, 2), (k2, 4), (k3, 6), (k4, 8), (p1, 1), (p2, 1), (sx1, 1), (sy1, 1)]
                .map(|(value, exponent)| power(value, exponent)),
        ),
    };
    [(plain, MAX_DISTORTION), (rational, MAX_RATIONAL_TERM)]
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

    fn rational(coefficients: [f64; 8]) -> Distortion {
        Distortion::from_opencv(&coefficients).unwrap()
    }

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
            // A time-of-flight camera, and a calibration with terms that cancel each other.
            camera([640, 576], 504.0, rational([0.51, -2.69, 3e-4, -5e-5, 1.5, 0.39, -2.5, 1.43])),
            camera([1280, 720], 640.0, rational([-13.6, 162.0, 1e-4, 1e-4, -700.0, -13.4, 161.0, -690.0])),
            camera([512, 512], 158.0, Distortion::DoubleSphere { xi: -0.19, alpha: 0.59 }),
            camera([512, 512], 190.0, Distortion::Eucm { alpha: 0.63, beta: 1.05 }),
            camera([1280, 1024], 1400.0, Distortion::Omni { xi: 1.9, distortion: [-0.2, 0.4, 0.001, 0.001] }),
            camera(
                [6048, 4032],
                2800.0,
                Distortion::ThinPrismFisheye([0.1, -0.02, 1e-4, 1e-4, 0.03, -0.01, 1e-3, 1e-3]),
            ),
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
        for distortion in [
            Distortion::Rational([1e12; 12]),
            Distortion::Rational([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1e6, 0.0, 0.0, 0.0]),
            Distortion::ThinPrismFisheye([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1e6]),
            Distortion::DoubleSphere { xi: 1.0, alpha: 0.5 },
            Distortion::DoubleSphere { xi: 0.1, alpha: 1.1 },
            Distortion::Eucm { alpha: -0.1, beta: 1.0 },
            Distortion::Eucm { alpha: 0.5, beta: 0.0 },
            Distortion::Eucm { alpha: 0.5, beta: 1e9 },
            Distortion::Omni { xi: -1.0, distortion: [0.0; 4] },
            Distortion::Omni { xi: 1.0, distortion: [0.0, 0.0, f64::NAN, 0.0] },
        ] {
            let camera = Camera { distortion, ..real()[1].clone() };
            assert!(camera.validate().is_err(), "{distortion:?}");
        }
        assert!(Camera { width: u32::MAX, ..real()[0].clone() }.validate().is_err());
    }
}
