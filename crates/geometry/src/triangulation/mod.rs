//! Triangulation of landmarks from cameras with known poses.

mod inverse_depth;

use crate::camera::{Camera, ProjectionError};
use crate::pose::Pose;
use inverse_depth::{InverseDepth, Residuals, ViewGeometry};
use nalgebra::{Matrix3, Vector2, Vector3};
use smallvec::SmallVec;

/// Number of views without heap allocation: the sliding window of a filter with stereo images.
const USUAL_VIEWS: usize = 48;

/// One observation of the landmark.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// Pose of the camera; all views have the same parent frame.
    pub parent_from_camera: Pose,
    /// Distorted pixel.
    pub pixel: Vector2<f64>,
    /// Standard deviation of the pixel in u and in v, pixels.
    pub sigma_px: f64,
}

/// Settings and acceptance thresholds of [`triangulate`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TriangulationOptions {
    /// Minimum parallax (radians): largest angle between the first ray and any other.
    pub min_parallax: f64,
    /// Maximum standard deviation of the inverse depth in the first camera, relative to the inverse depth. Beyond it the
    /// error is not Gaussian.
    pub max_relative_depth_sigma: f64,
    /// Minimum depth in any view, metres.
    pub min_depth: f64,
    /// Maximum number of Levenberg-Marquardt iterations after the linear solution.
    pub max_iterations: usize,
    /// Threshold of Huber's loss in standard deviations; infinite for least squares.
    pub huber_sigmas: f64,
}

impl Default for TriangulationOptions {
    /// 2 mrad (one pixel at a focal length of 500), 50 % relative depth sigma, 5 cm, 5 iterations, least squares.
    fn default() -> Self {
        Self {
            min_parallax: 2e-3,
            max_relative_depth_sigma: 0.5,
            min_depth: 0.05,
            max_iterations: 5,
            huber_sigmas: f64::INFINITY,
        }
    }
}

/// A triangulated landmark.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Triangulated {
    /// Position in the parent frame of the views, metres.
    pub position: Vector3<f64>,
    /// Covariance of the position for the sigmas of the views and exact poses (m^2, parent frame).
    pub covariance: Matrix3<f64>,
    /// Mean norm of the pixel residuals, pixels.
    pub mean_reprojection_error: f64,
}

/// Why a landmark could not be triangulated.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum TriangulationError {
    /// Fewer than two views.
    #[error("{0} views; at least two are needed")]
    TooFewViews(usize),
    /// The number of cameras is not the number of views.
    #[error("{cameras} cameras for {views} views")]
    LengthMismatch {
        /// Number of cameras given.
        cameras: usize,
        /// Number of views given.
        views: usize,
    },
    /// NaN or infinity, or a sigma that is not positive.
    #[error("a pose, pixel or sigma is not finite or not positive")]
    InvalidInput,
    /// A pixel that cannot be unprojected.
    #[error("a pixel cannot be unprojected: {0}")]
    NoRay(#[source] ProjectionError),
    /// The rays are too close to parallel, or the depth is too uncertain.
    #[error("the rays are too close to parallel to observe the depth")]
    Degenerate,
    /// The solution lies behind a camera or below the minimum depth.
    #[error("the landmark is behind or too close to a camera")]
    BehindCamera,
}

/// Triangulates one landmark from the pixels of several cameras whose poses are known.
///
/// Linear least squares on the rays, then Levenberg-Marquardt on the pixel residuals over the landmark's inverse depth
/// in the first view.
///
/// # Arguments
/// * `camera_of_view`: n cameras, one per view (references may repeat).
/// * `views`: n views, in any order; the first is the anchor of the inverse depth.
///
/// # Returns
/// The landmark in the common parent frame of the views (metres), its covariance (m^2), and the mean residual. Outliers
/// are not rejected: they show in `mean_reprojection_error` and [`reprojection_error`].
///
/// # Errors
/// [`TriangulationError::TooFewViews`] below two views, [`TriangulationError::Degenerate`] if the parallax is below
/// `min_parallax` or the relative depth sigma above `max_relative_depth_sigma`, [`TriangulationError::BehindCamera`],
/// [`TriangulationError::NoRay`], [`TriangulationError::InvalidInput`], [`TriangulationError::LengthMismatch`].
///
/// # Example
/// ```
/// use geometry::{Camera, Distortion, Pose, TriangulationOptions, View, triangulate};
/// use nalgebra::Vector3;
///
/// let camera =
///     Camera { width: 752, height: 480, focal: [460.0; 2], centre: [376.0, 240.0], distortion: Distortion::None };
/// let landmark = Vector3::new(0.3, -0.2, 4.0);
/// let views = [0.0, 0.1, 0.2].map(|x| {
///     let global_from_camera = Pose { translation: Vector3::new(x, 0.0, 0.0), ..Pose::identity() };
///     let pixel = camera.project(&global_from_camera.inverse_transform(&landmark)).unwrap();
///     View { parent_from_camera: global_from_camera, pixel, sigma_px: 1.0 }
/// });
/// let triangulated = triangulate(&[&camera; 3], &views, &TriangulationOptions::default())?;
/// assert!((triangulated.position - landmark).norm() < 1e-6);
/// // The depth is the least certain direction.
/// assert!(triangulated.covariance.m33 > triangulated.covariance.m11);
/// # Ok::<(), geometry::TriangulationError>(())
/// ```
///
/// Source: Mourikis & Roumeliotis, ICRA 2007, appendix; Civera, Davison & Montiel, T-RO 2008 (inverse depth).
pub fn triangulate(
    camera_of_view: &[&Camera],
    views: &[View],
    options: &TriangulationOptions,
) -> Result<Triangulated, TriangulationError> {
    check_input(camera_of_view, views)?;
    let anchor = &views[0].parent_from_camera;
    let mut geometries = SmallVec::<[ViewGeometry; USUAL_VIEWS]>::new();
    let mut rays = RaySystem::default();
    for (camera, view) in camera_of_view.iter().zip(views) {
        let normalized = camera.unproject(&view.pixel).map_err(TriangulationError::NoRay)?;
        let geometry = ViewGeometry::new(camera, view, anchor);
        rays.add(&geometry, &normalized);
        geometries.push(geometry);
    }
    if rays.parallax() < options.min_parallax {
        return Err(TriangulationError::Degenerate);
    }
    let residuals = Residuals { views: &geometries, huber_sigmas: options.huber_sigmas };
    let solution = inverse_depth::solve(&residuals, &rays.anchor, rays.solve(), options.max_iterations)
        .ok_or(TriangulationError::BehindCamera)?;

    let InverseDepth { x, y, rho } = solution.estimate;
    if rho <= 0.0 {
        // Rays that diverge within their noise intersect at infinity; rays that clearly diverge, behind the cameras.
        let sigma = solution.information.try_inverse().map_or(f64::INFINITY, |c| c.m33.sqrt());
        let behind = -rho > 3.0 * sigma;
        return Err(if behind { TriangulationError::BehindCamera } else { TriangulationError::Degenerate });
    }
    let inverse_depth_covariance =
        solution.information.try_inverse().ok_or(TriangulationError::Degenerate)?;
    let relative_sigma = inverse_depth_covariance.m33.sqrt() / rho;
    if relative_sigma.is_nan() || relative_sigma > options.max_relative_depth_sigma {
        return Err(TriangulationError::Degenerate);
    }
    let in_anchor = Vector3::new(x, y, 1.0) / rho;
    let nearest = geometries.iter().map(|view| view.depth(&solution.estimate)).fold(f64::INFINITY, f64::min);
    if nearest < options.min_depth {
        return Err(TriangulationError::BehindCamera);
    }
    let by_parameters = anchor.rotation.to_rotation_matrix().into_inner()
        * Matrix3::from_columns(&[Vector3::x() / rho, Vector3::y() / rho, -in_anchor / rho]);
    let covariance = by_parameters * inverse_depth_covariance * by_parameters.transpose();
    Ok(Triangulated {
        position: anchor.transform(&in_anchor),
        covariance: (covariance + covariance.transpose()) * 0.5,
        mean_reprojection_error: residuals.mean_length(&solution.estimate),
    })
}

/// Distance (pixels) between the observed pixel of a view and the projection of a `position` (metres, parent frame of
/// the view).
///
/// # Errors
/// [`ProjectionError`] if the position cannot be projected.
pub fn reprojection_error(
    camera: &Camera,
    view: &View,
    position: &Vector3<f64>,
) -> Result<f64, ProjectionError> {
    let pixel = camera.project(&view.parent_from_camera.inverse_transform(position))?;
    Ok((view.pixel - pixel).norm())
}

fn check_input(camera_of_view: &[&Camera], views: &[View]) -> Result<(), TriangulationError> {
    if camera_of_view.len() != views.len() {
        return Err(TriangulationError::LengthMismatch { cameras: camera_of_view.len(), views: views.len() });
    }
    if views.len() < 2 {
        return Err(TriangulationError::TooFewViews(views.len()));
    }
    let valid = |view: &View| {
        view.parent_from_camera.is_finite()
            && view.pixel.iter().all(|value| value.is_finite())
            && view.sigma_px.is_finite()
            && view.sigma_px > 0.0
    };
    if views.iter().all(valid) { Ok(()) } else { Err(TriangulationError::InvalidInput) }
}

/// Normal equations of the point nearest to all rays, in the anchor's frame: `sum (I - b b^T) (p - c) = 0`.
#[derive(Default)]
struct RaySystem {
    normal: Matrix3<f64>,
    right: Vector3<f64>,
    first_ray: Option<Vector3<f64>>,
    /// Normalized coordinates in the anchor.
    anchor: Vector2<f64>,
    max_sin_squared: f64,
}

impl RaySystem {
    fn add(&mut self, view: &ViewGeometry, normalized: &Vector2<f64>) {
        let (centre, direction) = view.ray_in_anchor(normalized);
        match &self.first_ray {
            None => {
                self.first_ray = Some(direction);
                self.anchor = *normalized;
            }
            Some(first) => {
                let behind = first.dot(&direction) < 0.0;
                let sin_squared = if behind { 1.0 } else { first.cross(&direction).norm_squared() };
                self.max_sin_squared = self.max_sin_squared.max(sin_squared);
            }
        }
        let projector = Matrix3::identity() - direction * direction.transpose();
        self.normal += projector;
        self.right += projector * centre;
    }

    /// Largest angle to the first ray, radians (at most a right angle).
    fn parallax(&self) -> f64 {
        self.max_sin_squared.min(1.0).sqrt().asin()
    }

    fn solve(&self) -> Option<Vector3<f64>> {
        Some(self.normal.try_inverse()? * self.right)
    }
}
