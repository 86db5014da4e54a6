//! Errors of cameras.

use super::plausibility::{MAX_CAMERA_SIDE, MAX_CENTRE_OFFSET, MAX_FOCAL, MAX_MOUNT_M, MIN_FOCAL};

/// Why a point cannot be projected, or a pixel not be unprojected.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ProjectionError {
    /// The point lies behind the camera or in its focal plane.
    #[error("the point is behind the camera")]
    BehindCamera,
    /// The ray or pixel is outside the range where the distortion model is invertible.
    #[error("the ray is outside the range where the distortion model is invertible")]
    OutsideModel,
    /// A coordinate is NaN or infinite.
    #[error("a coordinate is not finite")]
    NotFinite,
}

/// Why camera parameters are invalid.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CameraError {
    /// An image without pixels.
    #[error("the image size is {width} x {height}; both must be positive")]
    EmptyImage {
        /// Width, pixels.
        width: u32,
        /// Height, pixels.
        height: u32,
    },
    /// A focal length that is not a positive number.
    #[error("the focal lengths are {0} and {1} pixels; both must be positive and finite")]
    FocalLength(f64, f64),
    /// A principal point that is not finite.
    #[error("the principal point is ({0}, {1}); both must be finite")]
    Centre(f64, f64),
    /// An image that is larger than any sensor's.
    #[error(
        "the image size is {width} x {height}; at most {MAX_CAMERA_SIDE} columns and rows are a camera's"
    )]
    LargeImage {
        /// Width, pixels.
        width: u32,
        /// Height, pixels.
        height: u32,
    },
    /// A focal length that no lens has.
    #[error(
        "the focal lengths are {:e} and {:e} pixels, and no lens has these for {side} pixels: {MIN_FOCAL} to {MAX_FOCAL} times as much are \
         a camera's", focal[0], focal[1]
    )]
    ImplausibleFocalLength {
        /// Focal lengths, pixels.
        focal: [f64; 2],
        /// The longer side of the image, pixels.
        side: u32,
    },
    /// A principal point far outside of the image.
    #[error("the principal point ({0:e}, {1:e}) is more than {MAX_CENTRE_OFFSET} images away from the image")]
    ImplausibleCentre(f64, f64),
    /// Distortion coefficients that no lens has.
    #[error(
        "a term of the distortion is {effect:e} times what it distorts at the corner of the image, and no lens reaches {limit}"
    )]
    ImplausibleDistortion {
        /// The largest term, relative.
        effect: f64,
        /// [`MAX_DISTORTION`](super::MAX_DISTORTION), or that of terms that cancel each other.
        limit: f64,
    },
    /// A camera far from its IMU.
    #[error("the camera is {distance:e} m from the IMU, and at most {MAX_MOUNT_M} m are believed")]
    ImplausibleMount {
        /// Their distance, m.
        distance: f64,
    },
    /// A distortion coefficient that is not finite.
    #[error("a distortion coefficient is {0}; all must be finite")]
    DistortionCoefficients(f64),
    /// A parameter of the double sphere, extended unified or omnidirectional model is out of range.
    #[error("{parameter} of the camera model is {value}; it must lie between {min} and {max}")]
    ModelParameter {
        /// Its name.
        parameter: &'static str,
        /// Its value.
        value: f64,
        /// The least.
        min: f64,
        /// The largest.
        max: f64,
    },
    /// The parameter of the FOV model is out of range.
    #[error("the FOV parameter is {omega} rad; it must lie between {min} and pi")]
    FovParameter {
        /// The parameter, radians.
        omega: f64,
        /// Its minimum, radians.
        min: f64,
    },
}
