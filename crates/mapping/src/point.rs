//! A landmark as a ray and an inverse depth in its anchor, and how the poses move its pixels.

use geometry::camera::Camera;
use geometry::pose::Pose;
use geometry::rotation::skew;
use nalgebra::{Matrix2, Matrix2x3, Matrix2x6, Matrix3, Vector2, Vector3};
use sensors::CameraSensor;

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

/// A camera of the rig, and where it sits: `p_lens = rotation p_first + offset`, in metres, with the frame of camera 0.
#[derive(Clone, Debug)]
pub(super) struct Lens {
    /// The camera.
    pub(super) camera: Camera,
    rotation: Matrix3<f64>,
    offset: Vector3<f64>,
}

impl Lens {
    /// Rotation and offset (m) that take a point from the frame of camera 0 to this one's.
    pub(super) fn lens_from_first(&self) -> (Matrix3<f64>, Vector3<f64>) {
        (self.rotation, self.offset)
    }

    /// The cameras of a recording: the one that the views are poses of, and its stereo partner, if there is one.
    pub(super) fn of_rig(sensors: &[CameraSensor]) -> Vec<Lens> {
        let lens = |sensor: &CameraSensor| {
            let lens_from_first = sensor.imu_from_camera.inverse() * sensors[0].imu_from_camera;
            let CameraPose { rotation, position } = CameraPose::from(&lens_from_first);
            Lens { camera: sensor.camera.clone(), rotation, offset: position }
        };
        sensors.iter().map(lens).collect()
    }
}

/// Where a view saw a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sighting {
    /// The view and its feature.
    pub(super) feature: Feature,
    /// Which camera of the rig: 0, or 1 for the same feature found again by the stereo partner.
    pub(super) lens: usize,
    /// The feature's pixel there.
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
    /// Which of the sightings is the anchor's; it is one of camera 0.
    pub(super) anchor: usize,
    /// Normalized coordinates in the anchor.
    pub(super) ray: Vector2<f64>,
    /// One over the depth in the anchor (1/m).
    pub(super) inverse_depth: f64,
    /// All sightings, ordered by view and camera.
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
    /// Number of views that saw it.
    pub(super) fn view_count(&self) -> usize {
        self.sightings.iter().filter(|sighting| sighting.lens == 0).count()
    }

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

    /// The point in the frame of the lens that made a sighting, times its inverse depth in the anchor. `None` for a point
    /// nearer than [`MIN_DEPTH`]: from a point at its own centre a camera can see any pixel.
    fn in_lens(&self, rig: &[Lens], poses: &[CameraPose], sighting: &Sighting) -> Option<Vector3<f64>> {
        let lens = &rig[sighting.lens];
        let (anchor, view) = (&poses[self.anchor_view()], &poses[sighting.view()]);
        let in_first = if sighting.view() == self.anchor_view() {
            self.ray.push(1.0)
        } else {
            let scaled = self.direction(anchor) + (anchor.position - view.position) * self.inverse_depth;
            view.rotation.transpose() * scaled
        };
        let in_lens = lens.rotation * in_first + lens.offset * self.inverse_depth;
        (in_lens.z >= MIN_DEPTH * self.inverse_depth).then_some(in_lens)
    }

    /// The pixel of a sighting; `None` where it cannot see the point.
    pub(super) fn project(
        &self,
        rig: &[Lens],
        poses: &[CameraPose],
        sighting: &Sighting,
    ) -> Option<Vector2<f64>> {
        rig[sighting.lens].camera.project(&self.in_lens(rig, poses, sighting)?).ok()
    }

    /// The pixel of a sighting other than the anchor's, with its Jacobians.
    ///
    /// The point is scaled by its inverse depth, which leaves the pixel as it is:
    /// ```text
    /// d = A R_v^T s + rho b,   s = R_a [ray, 1] + rho (p_a - p_v),   A, b: the lens
    /// dd/dtheta_a = -A R_v^T [R_a [ray, 1]]x    dd/dp_a =  rho A R_v^T
    /// dd/dtheta_v =  A R_v^T [s]x               dd/dp_v = -rho A R_v^T
    /// dd/dray = A R_v^T R_a [e1 e2]             dd/drho = A R_v^T (p_a - p_v) + b
    /// ```
    /// In the anchor's own view `s = R_a [ray, 1]`, and the poses do not matter.
    pub(super) fn predict(
        &self,
        rig: &[Lens],
        poses: &[CameraPose],
        sighting: &Sighting,
    ) -> Option<Prediction> {
        let lens = &rig[sighting.lens];
        let (anchor, view) = (&poses[self.anchor_view()], &poses[sighting.view()]);
        let in_lens = self.in_lens(rig, poses, sighting)?;
        let (pixel, by_lens) = lens.camera.project_with_jacobian(&in_lens).ok()?;
        let by_global = by_lens * lens.rotation * view.rotation.transpose();
        let mut by_depth = by_lens * lens.offset;
        let (mut by_anchor, mut by_view) = (Matrix2x6::zeros(), Matrix2x6::zeros());
        if sighting.view() != self.anchor_view() {
            let direction = self.direction(anchor);
            let baseline = anchor.position - view.position;
            let scaled = direction + baseline * self.inverse_depth;
            let by_position = by_global * self.inverse_depth;
            by_anchor.fixed_view_mut::<2, 3>(0, 0).copy_from(&(-by_global * skew(&direction)));
            by_anchor.fixed_view_mut::<2, 3>(0, 3).copy_from(&by_position);
            by_view.fixed_view_mut::<2, 3>(0, 0).copy_from(&(by_global * skew(&scaled)));
            by_view.fixed_view_mut::<2, 3>(0, 3).copy_from(&-by_position);
            by_depth += by_global * baseline;
        }
        let by_ray = by_global * anchor.rotation.fixed_columns::<2>(0);
        let by_point = Matrix2x3::from_columns(&[by_ray.column(0), by_ray.column(1), by_depth.column(0)]);
        Some(Prediction { pixel, by_anchor, by_view, by_point })
    }

    /// The pixel in the anchor and its Jacobian by the ray (2x2).
    pub(super) fn predict_in_anchor(&self, rig: &[Lens]) -> (Vector2<f64>, Matrix2<f64>) {
        rig[0].camera.distort_normalized_with_jacobian(&self.ray)
    }

    /// Adds an error `[ray, inverse depth]`, and keeps the depth between [`MIN_DEPTH`] and [`MAX_DEPTH`].
    pub(super) fn moved(&self, error: &Vector3<f64>) -> Point {
        let mut point = self.clone();
        point.ray += error.xy();
        point.inverse_depth = (point.inverse_depth + error.z).clamp(MAX_DEPTH.recip(), MIN_DEPTH.recip());
        point
    }

    /// Reprojection error of each sighting (px), infinite where the view cannot see the point.
    pub(super) fn errors(&self, rig: &[Lens], poses: &[CameraPose]) -> Vec<f64> {
        let error = |(index, sighting): (usize, &Sighting)| {
            let pixel = if index == self.anchor {
                Some(self.predict_in_anchor(rig).0)
            } else {
                self.project(rig, poses, sighting)
            };
            pixel.map_or(f64::INFINITY, |pixel| (sighting.pixel - pixel).norm())
        };
        self.sightings.iter().enumerate().map(error).collect()
    }

    /// The same landmark told from another of its sightings by camera 0; `None` where it lies behind that view.
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

    /// Takes out sightings for which `keep` is false, and those by a stereo partner whose own camera 0 goes. `None`
    /// where fewer than `least` views are left, unless a single view saw it in stereo. The anchor must stay or be
    /// moved before.
    pub(super) fn retained(&self, keep: &[bool], least: usize) -> Option<Point> {
        let kept_views: Vec<usize> = self
            .sightings
            .iter()
            .zip(keep)
            .filter(|(sighting, keep)| **keep && sighting.lens == 0)
            .map(|(sighting, _)| sighting.view())
            .collect();
        let keep: Vec<bool> = self
            .sightings
            .iter()
            .zip(keep)
            .map(|(s, keep)| *keep && kept_views.contains(&s.view()))
            .collect();
        let mut point = self.clone();
        let mut kept = keep.iter();
        point.sightings.retain(|_| kept.next().copied().unwrap_or(false));
        point.anchor = keep[..self.anchor].iter().filter(|&&keep| keep).count();
        let enough = kept_views.len() >= least || point.sightings.iter().any(|sighting| sighting.lens > 0);
        (keep[self.anchor] && enough).then_some(point)
    }
}
