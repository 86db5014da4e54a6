//! A landmark as bearing and inverse depth in its anchor, and how its pixels change with the poses.

use geometry::rotation::skew;
use nalgebra::{Matrix2, Matrix2x3, Matrix2x6, Vector2, Vector3};

use super::camera::{CameraPose, MAX_DEPTH, MIN_DEPTH, MappingCamera};
use super::keyframe_view::FeatureId;
use super::landmark_prior::LandmarkPrior;

/// An observation of a landmark by a keyframe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LandmarkObservation {
    /// The view and its feature.
    pub(super) feature: FeatureId,
    /// Which camera: 0, or 1 for the same feature matched in the image of the second camera.
    pub(super) camera: usize,
    /// Its pixel there.
    pub(super) pixel: Vector2<f64>,
}

impl LandmarkObservation {
    /// Index of the view.
    pub(super) fn view(&self) -> usize {
        self.feature.0
    }
}

/// A landmark during map building. In its anchor's camera frame it is at `[ray, 1] / inverse_depth`.
///
/// Inverse depth is well-behaved for landmarks without parallax, whose position would diverge.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct InverseDepthLandmark {
    /// Index of the anchor's observation; it is one of camera 0.
    pub(super) anchor: usize,
    /// Normalized coordinates in the anchor: its bearing.
    pub(super) ray: Vector2<f64>,
    /// One over the depth in the anchor (1/m).
    pub(super) inverse_depth: f64,
    /// All observations, ordered by view and camera.
    pub(super) observations: Vec<LandmarkObservation>,
    /// What a map that is extended knows of it: its observations there, of which only the anchor is in `observations`.
    pub(super) prior: Option<LandmarkPrior>,
}

/// A predicted pixel and its Jacobians (2 rows, px).
pub(super) struct Prediction {
    /// The pixel.
    pub(super) pixel: Vector2<f64>,
    /// By the error `[δθ, δp]` of the anchor's pose.
    pub(super) by_anchor: Matrix2x6<f64>,
    /// By the error of the observing view's pose.
    pub(super) by_view: Matrix2x6<f64>,
    /// By ray and inverse depth.
    pub(super) by_landmark: Matrix2x3<f64>,
}

impl InverseDepthLandmark {
    /// Number of keyframes that observe it.
    pub(super) fn view_count(&self) -> usize {
        self.observations.iter().filter(|observation| observation.camera == 0).count()
    }

    /// Index of the anchor's view.
    pub(super) fn anchor_view(&self) -> usize {
        self.observations[self.anchor].view()
    }

    /// The views that say something of it: all that observe it, and those of its prior.
    pub(super) fn views_with_prior(&self) -> impl Iterator<Item = usize> {
        let of_prior = self.prior.iter().flat_map(LandmarkPrior::views);
        self.observations.iter().map(LandmarkObservation::view).chain(of_prior)
    }

    /// Position in G times the inverse depth, as a direction from the anchor: `R [ray, 1]`.
    fn direction(&self, anchor: &CameraPose) -> Vector3<f64> {
        anchor.rotation * self.ray.push(1.0)
    }

    /// Position in G (m).
    pub(super) fn position(&self, anchor: &CameraPose) -> Vector3<f64> {
        anchor.position + self.direction(anchor) / self.inverse_depth
    }

    /// The landmark in the frame of the observing camera, times its inverse depth in the anchor. `None` for a landmark
    /// nearer than [`MIN_DEPTH`]: at the camera's centre its pixel is undefined.
    fn in_camera(
        &self,
        cameras: &[MappingCamera],
        poses: &[CameraPose],
        observation: &LandmarkObservation,
    ) -> Option<Vector3<f64>> {
        let camera = &cameras[observation.camera];
        let (anchor, view) = (&poses[self.anchor_view()], &poses[observation.view()]);
        let in_first = if observation.view() == self.anchor_view() {
            self.ray.push(1.0)
        } else {
            let scaled = self.direction(anchor) + (anchor.position - view.position) * self.inverse_depth;
            view.rotation.transpose() * scaled
        };
        let in_camera = camera.rotation * in_first + camera.offset * self.inverse_depth;
        (in_camera.z >= MIN_DEPTH * self.inverse_depth).then_some(in_camera)
    }

    /// The predicted pixel of an observation; `None` where the landmark is not visible.
    pub(super) fn project(
        &self,
        cameras: &[MappingCamera],
        poses: &[CameraPose],
        observation: &LandmarkObservation,
    ) -> Option<Vector2<f64>> {
        cameras[observation.camera].camera.project(&self.in_camera(cameras, poses, observation)?).ok()
    }

    /// The predicted pixel of an observation other than the anchor's, with its Jacobians.
    ///
    /// The landmark is scaled by its inverse depth, which does not change the pixel:
    /// ```text
    /// d = A R_v^T s + rho b,   s = R_a [ray, 1] + rho (p_a - p_v),   A, b: camera_from_first
    /// dd/dtheta_a = -A R_v^T [R_a [ray, 1]]x    dd/dp_a =  rho A R_v^T
    /// dd/dtheta_v =  A R_v^T [s]x               dd/dp_v = -rho A R_v^T
    /// dd/dray = A R_v^T R_a [e1 e2]             dd/drho = A R_v^T (p_a - p_v) + b
    /// ```
    /// In the anchor's own view `s = R_a [ray, 1]`, independent of the poses.
    pub(super) fn predict(
        &self,
        cameras: &[MappingCamera],
        poses: &[CameraPose],
        observation: &LandmarkObservation,
    ) -> Option<Prediction> {
        let camera = &cameras[observation.camera];
        let (anchor, view) = (&poses[self.anchor_view()], &poses[observation.view()]);
        let in_camera = self.in_camera(cameras, poses, observation)?;
        let (pixel, by_camera) = camera.camera.project_with_jacobian(&in_camera).ok()?;
        let by_global = by_camera * camera.rotation * view.rotation.transpose();
        let mut by_depth = by_camera * camera.offset;
        let (mut by_anchor, mut by_view) = (Matrix2x6::zeros(), Matrix2x6::zeros());
        if observation.view() != self.anchor_view() {
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
        let by_landmark = Matrix2x3::from_columns(&[by_ray.column(0), by_ray.column(1), by_depth.column(0)]);
        Some(Prediction { pixel, by_anchor, by_view, by_landmark })
    }

    /// The pixel in the anchor and its Jacobian by the ray (2x2).
    pub(super) fn predict_in_anchor(&self, cameras: &[MappingCamera]) -> (Vector2<f64>, Matrix2<f64>) {
        cameras[0].camera.distort_normalized_with_jacobian(&self.ray)
    }

    /// Adds an error `[ray, inverse depth]`, and keeps the depth between [`MIN_DEPTH`] and [`MAX_DEPTH`].
    pub(super) fn corrected(&self, error: &Vector3<f64>) -> InverseDepthLandmark {
        let mut landmark = self.clone();
        landmark.ray += error.xy();
        landmark.inverse_depth =
            (landmark.inverse_depth + error.z).clamp(MAX_DEPTH.recip(), MIN_DEPTH.recip());
        landmark
    }

    /// Reprojection error of each observation (px), infinite where the landmark is not visible; zero for an anchor that
    /// is part of the prior.
    pub(super) fn errors(&self, cameras: &[MappingCamera], poses: &[CameraPose]) -> Vec<f64> {
        let error = |(index, observation): (usize, &LandmarkObservation)| {
            if index == self.anchor && self.prior.is_some() {
                return 0.0;
            }
            let pixel = if index == self.anchor {
                Some(self.predict_in_anchor(cameras).0)
            } else {
                self.project(cameras, poses, observation)
            };
            pixel.map_or(f64::INFINITY, |pixel| (observation.pixel - pixel).norm())
        };
        self.observations.iter().enumerate().map(error).collect()
    }

    /// The same landmark re-anchored in another of its observations by camera 0; `None` where it lies behind that view.
    pub(super) fn anchored_at(&self, index: usize, poses: &[CameraPose]) -> Option<InverseDepthLandmark> {
        if index == self.anchor {
            return Some(self.clone());
        }
        let position = self.position(&poses[self.anchor_view()]);
        let view = &poses[self.observations[index].view()];
        let p = view.rotation.transpose() * (position - view.position);
        (p.z >= MIN_DEPTH).then(|| InverseDepthLandmark {
            anchor: index,
            ray: p.xy() / p.z,
            inverse_depth: 1.0 / p.z.min(MAX_DEPTH),
            observations: self.observations.clone(),
            prior: self.prior.clone(),
        })
    }

    /// Removes observations for which `keep` is false, and those by camera 1 in keyframes whose camera 0 no longer observes
    /// it. `None` where fewer than `least` keyframes are left, unless one observes it in stereo. The anchor must be kept or
    /// changed before.
    pub(super) fn retained(&self, keep: &[bool], least: usize) -> Option<InverseDepthLandmark> {
        let kept_views: Vec<usize> = self
            .observations
            .iter()
            .zip(keep)
            .filter(|(observation, keep)| **keep && observation.camera == 0)
            .map(|(observation, _)| observation.view())
            .collect();
        let keep: Vec<bool> = self
            .observations
            .iter()
            .zip(keep)
            .map(|(s, keep)| *keep && kept_views.contains(&s.view()))
            .collect();
        let mut landmark = self.clone();
        let mut kept = keep.iter();
        landmark.observations.retain(|_| kept.next().copied().unwrap_or(false));
        landmark.anchor = keep[..self.anchor].iter().filter(|&&keep| keep).count();
        let enough = kept_views.len() >= least
            || landmark.observations.iter().any(|observation| observation.camera > 0);
        (keep[self.anchor] && enough).then_some(landmark)
    }
}
