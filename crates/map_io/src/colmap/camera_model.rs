//! Camera models of COLMAP.

use super::PIXEL_OFFSET;
use super::error::ReadColmapError;
use geometry::camera::{Camera, Distortion};

/// Names in the order of their numbers, with the count of their parameters.
const MODELS: [(&str, usize); 12] = [
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
];

/// Name and number of parameters of the model with a number.
pub(super) fn numbered(id: u32, number: i32) -> Result<(&'static str, usize), ReadColmapError> {
    usize::try_from(number)
        .ok()
        .and_then(|index| MODELS.get(index).copied())
        .ok_or_else(|| ReadColmapError::CameraModel { camera: id, model: format!("number {number}") })
}

/// The camera of a model with its parameters.
///
/// # Errors
/// [`ReadColmapError::CameraModel`] for a model without counterpart here, or another number of parameters than it has;
/// [`ReadColmapError::Camera`].
pub(super) fn camera(
    id: u32,
    model: &str,
    [width, height]: [u32; 2],
    parameters: &[f64],
) -> Result<Camera, ReadColmapError> {
    let unsupported = || ReadColmapError::CameraModel { camera: id, model: model.to_owned() };
    let (focal, rest) = match (model, parameters) {
        (
            "SIMPLE_PINHOLE" | "SIMPLE_RADIAL" | "RADIAL" | "SIMPLE_RADIAL_FISHEYE" | "RADIAL_FISHEYE",
            [f, rest @ ..],
        ) => ([*f, *f], rest),
        (
            "PINHOLE" | "OPENCV" | "OPENCV_FISHEYE" | "FULL_OPENCV" | "FOV" | "THIN_PRISM_FISHEYE",
            [fx, fy, rest @ ..],
        ) => ([*fx, *fy], rest),
        _ => (Default::default(), &[] as &[f64]),
    };
    let (centre, distortion) = match (model, rest) {
        ("SIMPLE_PINHOLE" | "PINHOLE", &[cx, cy]) => ([cx, cy], Distortion::None),
        ("SIMPLE_RADIAL", &[cx, cy, k]) => ([cx, cy], Distortion::RadialTangential([k, 0.0, 0.0, 0.0])),
        ("RADIAL", &[cx, cy, k1, k2]) => ([cx, cy], Distortion::RadialTangential([k1, k2, 0.0, 0.0])),
        ("OPENCV", &[cx, cy, k1, k2, p1, p2]) => ([cx, cy], Distortion::RadialTangential([k1, k2, p1, p2])),
        ("OPENCV_FISHEYE", &[cx, cy, k1, k2, k3, k4]) => {
            ([cx, cy], Distortion::Equidistant([k1, k2, k3, k4]))
        }
        ("FULL_OPENCV", &[cx, cy, ref k @ ..]) if k.len() == 8 => {
            ([cx, cy], Distortion::from_opencv(k).ok_or_else(unsupported)?)
        }
        ("THIN_PRISM_FISHEYE", &[cx, cy, k1, k2, p1, p2, k3, k4, sx1, sy1]) => {
            ([cx, cy], Distortion::ThinPrismFisheye([k1, k2, p1, p2, k3, k4, sx1, sy1]))
        }
        ("FOV", &[cx, cy, omega]) => ([cx, cy], Distortion::Fov(omega)),
        ("SIMPLE_RADIAL_FISHEYE", &[cx, cy, k]) => ([cx, cy], Distortion::Equidistant([k, 0.0, 0.0, 0.0])),
        ("RADIAL_FISHEYE", &[cx, cy, k1, k2]) => ([cx, cy], Distortion::Equidistant([k1, k2, 0.0, 0.0])),
        _ => return Err(unsupported()),
    };
    let centre = centre.map(|coordinate: f64| coordinate - PIXEL_OFFSET);
    let camera = Camera { width, height, focal, centre, distortion };
    camera.validate().map_err(|problem| ReadColmapError::Camera { camera: id, problem })?;
    Ok(camera)
}

/// The model and the parameters of a camera as COLMAP has them; `None` for one that COLMAP has no model for.
pub(super) fn parameters(camera: &Camera) -> Option<(&'static str, Vec<f64>)> {
    let [cx, cy] = camera.centre.map(|centre| centre + PIXEL_OFFSET);
    let mut all = vec![camera.focal[0], camera.focal[1], cx, cy];
    let model = match &camera.distortion {
        Distortion::None => "PINHOLE",
        Distortion::RadialTangential(_) => "OPENCV",
        Distortion::Equidistant(_) => "OPENCV_FISHEYE",
        Distortion::Fov(_) => "FOV",
        Distortion::ThinPrismFisheye(_) => "THIN_PRISM_FISHEYE",
        Distortion::Rational([first @ .., _, _, _, _]) => {
            all.extend(first);
            let has_prism = camera.distortion.coefficients().len() > first.len();
            return (!has_prism).then_some(("FULL_OPENCV", all));
        }
        Distortion::DoubleSphere { .. } | Distortion::Eucm { .. } | Distortion::Omni { .. } => return None,
    };
    all.extend(camera.distortion.coefficients());
    Some((model, all))
}
