//! A landmark as a ray and an inverse depth in its anchor, and how the poses move its pixels.

use geometry::camera::Camera;
use geometry::pose::Pose;
use geometry::rotation::skew;
use nalgebra::{Matrix2, Matrix2x3, Matrix2x6, Matrix3, Vector2, Vector3};

use super::tracks::Feature;

/// Largest depth that a landmark is given (m): beyond it, depth means nothing for any view of the map.
pub(super) const MAX_DEPTH: f64 = 500.0;
/// Smallest depth (m).
pub(super) const MIN_DEPTH: f64 = 0.1;

/// A pose with its rotation as a matrix.
#[derive(Clone, Copy, Debug)]
pub(super) struct CameraPose {
    /// `global_from_camera`.
    pub(super) rotation: Matrix3<f64>,
    /// Centre of the camera in G (m).
    pub(super) position: Vector3<f64>,
}

impl From<&Pose> for CameraPose {
    fn from(pose: &Pose) -> Self {
        Self { rotation: pose.rotation.to_rotation_matrix().into_inner(), position: pose.translation }
    }
}

/// Where a view saw a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sighting {
    /// The view and its feature.
    pub(super) feature: Feature,
    /// The feature's pixel.
    pub(super) pixel: Vector2<f64>,
}

impl Sighting {
    /// Index of the view.
    pub(super) fn view(&self) -> usize {
        self.feature.0
    }
}

/// A landmark under construction. In its anchor's camera frame it is at `[ray, 1] / inverse_depth`.
///
/// Inverse depth keeps points without parallax harmless, where a position would run off to infinity.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Point {
    /// Which of the sightings is the anchor's.
    pub(super) anchor: usize,
    /// Normalized coordinates in the anchor.
    pub(super) ray: Vector2<f64>,
    /// One over the depth in the anchor (1/m).
    pub(super) inverse_depth: f64,
    /// All sightings, ordered by view.
    pub(super) sightings: Vec<Sighting>,
}

/// A predicted pixel and how it changes (2 rows, px).
pub(super) struct Prediction {
    /// The pixel.
    pub(super) pixel: Vector2<f64>,
    /// By the error `[δθ, δp]` of the anchor's pose.
    pub(super) by_anchor: Matrix2x6<f64>,
    /// By the error of the observing view's pose.
    pub(super) by_view: Matrix2x6<f64>,
    /// By ray and inverse depth.
    pub(super) by_point: Matrix2x3<f64>,
}

impl Point {
    /// Index of the anchor's view.
    pub(super) fn anchor_view(&self) -> usize {
        self.sightings[self.anchor].view()
    }

    /// Position in G times the inverse depth, as a direction from the anchor: `R [ray, 1]`.
    fn direction(&self, anchor: &CameraPose) -> Vector3<f64> {
        anchor.rotation * self.ray.push(1.0)
    }

    /// Position in G (m).
    pub(super) fn position(&self, anchor: &CameraPose) -> Vector3<f64> {
        anchor.position + self.direction(anchor) / self.inverse_depth
    }

    /// The pixel in a view other than the anchor; `None` where it cannot see the point.
    pub(super) fn project(
        &self,
        camera: &Camera,
        anchor: &CameraPose,
        view: &CameraPose,
    ) -> Option<Vector2<f64>> {
        let scaled = self.direction(anchor) + (anchor.position - view.position) * self.inverse_depth;
        camera.project(&(view.rotation.transpose() * scaled)).ok()
    }

    /// The pixel in a view other than the anchor, with its Jacobians.
    ///
    /// The point is scaled by its inverse depth, which leaves the pixel as it is:
    /// ```text
    /// d = R_v^T s,   s = R_a [ray, 1] + rho (p_a - p_v)
    /// dd/dtheta_a = -R_v^T [R_a [ray, 1]]x    dd/dp_a =  rho R_v^T
    /// dd/dtheta_v =  R_v^T [s]x               dd/dp_v = -rho R_v^T
    /// dd/dray = R_v^T R_a [e1 e2]             dd/drho = R_v^T (p_a - p_v)
    /// ```
    pub(super) fn predict(
        &self,
        camera: &Camera,
        anchor: &CameraPose,
        view: &CameraPose,
    ) -> Option<Prediction> {
        let direction = self.direction(anchor);
        let baseline = anchor.position - view.position;
        let scaled = direction + baseline * self.inverse_depth;
        let (pixel, by_camera) = camera.project_with_jacobian(&(view.rotation.transpose() * scaled)).ok()?;
        let by_global = by_camera * view.rotation.transpose();
        let by_position = by_global * self.inverse_depth;
        let mut by_anchor = Matrix2x6::zeros();
        by_anchor.fixed_view_mut::<2, 3>(0, 0).copy_from(&(-by_global * skew(&direction)));
        by_anchor.fixed_view_mut::<2, 3>(0, 3).copy_from(&by_position);
        let mut by_view = Matrix2x6::zeros();
        by_view.fixed_view_mut::<2, 3>(0, 0).copy_from(&(by_global * skew(&scaled)));
        by_view.fixed_view_mut::<2, 3>(0, 3).copy_from(&-by_position);
        let by_ray = by_global * anchor.rotation.fixed_columns::<2>(0);
        let by_depth = by_global * baseline;
        let by_point = Matrix2x3::from_columns(&[by_ray.column(0), by_ray.column(1), by_depth.column(0)]);
        Some(Prediction { pixel, by_anchor, by_view, by_point })
    }

    /// The pixel in the anchor and its Jacobian by the ray (2x2).
    pub(super) fn predict_in_anchor(&self, camera: &Camera) -> (Vector2<f64>, Matrix2<f64>) {
        camera.distort_normalized_with_jacobian(&self.ray)
    }

    /// Adds an error `[ray, inverse depth]`, and keeps the depth between [`MIN_DEPTH`] and [`MAX_DEPTH`].
    pub(super) fn moved(&self, error: &Vector3<f64>) -> Point {
        let mut point = self.clone();
        point.ray += error.xy();
        point.inverse_depth = (point.inverse_depth + error.z).clamp(MAX_DEPTH.recip(), MIN_DEPTH.recip());
        point
    }

    /// Reprojection error of each sighting (px), infinite where the view cannot see the point.
    pub(super) fn errors(&self, camera: &Camera, poses: &[CameraPose]) -> Vec<f64> {
        let anchor = &poses[self.anchor_view()];
        let error = |(index, sighting): (usize, &Sighting)| {
            let pixel = if index == self.anchor {
                Some(self.predict_in_anchor(camera).0)
            } else {
                self.project(camera, anchor, &poses[sighting.view()])
            };
            pixel.map_or(f64::INFINITY, |pixel| (sighting.pixel - pixel).norm())
        };
        self.sightings.iter().enumerate().map(error).collect()
    }

    /// The same landmark told from another of its sightings; `None` where it lies behind that view.
    pub(super) fn anchored_at(&self, index: usize, poses: &[CameraPose]) -> Option<Point> {
        if index == self.anchor {
            return Some(self.clone());
        }
        let position = self.position(&poses[self.anchor_view()]);
        let view = &poses[self.sightings[index].view()];
        let p = view.rotation.transpose() * (position - view.position);
        (p.z >= MIN_DEPTH).then(|| Point {
            anchor: index,
            ray: p.xy() / p.z,
            inverse_depth: 1.0 / p.z.min(MAX_DEPTH),
            sightings: self.sightings.clone(),
        })
    }

    /// Takes out sightings for which `keep` is false. `None` where fewer than `least` are left. The anchor must stay
    /// or be moved before.
    pub(super) fn retained(&self, keep: &[bool], least: usize) -> Option<Point> {
        let mut point = self.clone();
        let mut kept = keep.iter();
        point.sightings.retain(|_| kept.next().copied().unwrap_or(false));
        point.anchor = keep[..self.anchor].iter().filter(|&&keep| keep).count();
        (keep[self.anchor] && point.sightings.len() >= least).then_some(point)
    }
}
