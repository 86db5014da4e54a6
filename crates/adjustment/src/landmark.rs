//! A landmark as bearing and inverse depth in its anchor, and how its pixels change with the poses.

use geometry::rotation::skew;
use nalgebra::{Matrix2x3, Matrix2x6, Vector2, Vector3};

use crate::camera::{MAX_DEPTH, MIN_DEPTH, MountedCamera, ViewPose};
use crate::landmark_prior::LandmarkPrior;

/// A feature: index of its view, index within the view.
pub type FeatureId = (usize, usize);

/// Limits of the inverse depth of a landmark of a map (1/m).
pub const MAPPED_INVERSE_DEPTHS: [f64; 2] = [1.0 / MAX_DEPTH, 1.0 / MIN_DEPTH];

/// An observation of a landmark by a view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LandmarkObservation {
    /// The view and its feature.
    pub feature: FeatureId,
    /// Which camera of the body.
    pub camera: usize,
    /// Whether it is the feature of the observation before it once more, matched in the image of the second camera of a stereo pair.
    pub is_second: bool,
    /// Its pixel there (px).
    pub pixel: Vector2<f64>,
}

impl LandmarkObservation {
    /// Index of the view.
    pub fn view(&self) -> usize {
        self.feature.0
    }
}

/// A landmark during an adjustment. In the frame of the camera of its anchor it is at `[ray, 1] / inverse_depth`.
///
/// Inverse depth is well-behaved for landmarks without parallax, whose position would diverge.
#[derive(Clone, Debug, PartialEq)]
pub struct InverseDepthLandmark {
    /// Index of the anchor's observation; in a map it is not one of a second camera.
    pub anchor: usize,
    /// Normalized coordinates in the anchor: its bearing.
    pub ray: Vector2<f64>,
    /// One over the depth in the anchor (1/m).
    pub inverse_depth: f64,
    /// All observations, ordered by view and camera.
    pub observations: Vec<LandmarkObservation>,
    /// What a map that is extended knows of it: its observations there, of which only the anchor is in `observations`.
    pub prior: Option<LandmarkPrior>,
}

/// A predicted pixel and its Jacobians (2 rows, px).
pub struct Prediction {
    /// The pixel.
    pub pixel: Vector2<f64>,
    /// By the error `[δθ, δp]` of the anchor's pose.
    pub by_anchor: Matrix2x6<f64>,
    /// By the error of the observing view's pose.
    pub by_view: Matrix2x6<f64>,
    /// By ray and inverse depth.
    pub by_landmark: Matrix2x3<f64>,
}

impl InverseDepthLandmark {
    /// Number of images that observe it; a stereo pair counts once.
    pub fn image_count(&self) -> usize {
        self.observations.iter().filter(|observation| !observation.is_second).count()
    }

    /// Index of the anchor's view.
    pub fn anchor_view(&self) -> usize {
        self.observations[self.anchor].view()
    }

    /// The views that say something of it: all that observe it, and those of its prior.
    pub fn views_with_prior(&self) -> impl Iterator<Item = usize> {
        let of_prior = self.prior.iter().flat_map(LandmarkPrior::views);
        self.observations.iter().map(LandmarkObservation::view).chain(of_prior)
    }

    /// The position in the body of the anchor times the inverse depth.
    fn in_anchor_body(&self, cameras: &[MountedCamera]) -> Vector3<f64> {
        let camera = &cameras[self.observations[self.anchor].camera];
        camera.rotation.transpose() * (self.ray.push(1.0) - camera.offset * self.inverse_depth)
    }

    /// Position in G (m).
    pub fn position(&self, cameras: &[MountedCamera], poses: &[ViewPose]) -> Vector3<f64> {
        let anchor = &poses[self.anchor_view()];
        anchor.position + anchor.rotation * self.in_anchor_body(cameras) / self.inverse_depth
    }

    /// The landmark in the frame of the observing camera, times its inverse depth in the anchor. `None` for a landmark
    /// nearer than the camera sees: at its centre the pixel is undefined.
    fn in_camera(
        &self,
        cameras: &[MountedCamera],
        poses: &[ViewPose],
        observation: &LandmarkObservation,
    ) -> Option<Vector3<f64>> {
        let camera = &cameras[observation.camera];
        let in_anchor = self.in_anchor_body(cameras);
        let in_body = if observation.view() == self.anchor_view() {
            in_anchor
        } else {
            let (anchor, view) = (&poses[self.anchor_view()], &poses[observation.view()]);
            let baseline = anchor.position - view.position;
            view.rotation.transpose() * (anchor.rotation * in_anchor + baseline * self.inverse_depth)
        };
        let in_camera = camera.rotation * in_body + camera.offset * self.inverse_depth;
        (in_camera.z >= camera.least_depth * self.inverse_depth).then_some(in_camera)
    }

    /// The predicted pixel of an observation; `None` where the landmark is not visible.
    fn project(&self, cameras: &[MountedCamera], poses: &[ViewPose], index: usize) -> Option<Vector2<f64>> {
        let observation = &self.observations[index];
        let camera = &cameras[observation.camera].camera;
        if index == self.anchor {
            return Some(camera.distort_normalized_with_jacobian(&self.ray).0);
        }
        camera.project(&self.in_camera(cameras, poses, observation)?).ok()
    }

    /// The predicted pixel of an observation, with its Jacobians.
    ///
    /// The landmark is scaled by its inverse depth, which does not change the pixel:
    /// ```text
    /// d = A R_v^T s + rho b,   s = R_a w + rho (p_a - p_v),   w = A_a^T ([ray, 1] - rho b_a),   A, b: camera_from_body
    /// dd/dtheta_a = -A R_v^T [R_a w]x           dd/dp_a =  rho A R_v^T
    /// dd/dtheta_v =  A R_v^T [s]x               dd/dp_v = -rho A R_v^T
    /// dd/dray = A R_v^T R_a A_a^T [e1 e2]       dd/drho = A R_v^T (p_a - p_v - R_a A_a^T b_a) + b
    /// ```
    /// In the anchor's own view `s = R_a w`, independent of the poses.
    pub fn predict(&self, cameras: &[MountedCamera], poses: &[ViewPose], index: usize) -> Option<Prediction> {
        let observation = &self.observations[index];
        let camera = &cameras[observation.camera];
        let (mut by_anchor, mut by_view) = (Matrix2x6::zeros(), Matrix2x6::zeros());
        if index == self.anchor {
            let (pixel, by_ray) = camera.camera.distort_normalized_with_jacobian(&self.ray);
            return Some(Prediction { pixel, by_anchor, by_view, by_landmark: by_ray.insert_column(2, 0.0) });
        }
        let anchor_camera = &cameras[self.observations[self.anchor].camera];
        let (anchor, view) = (&poses[self.anchor_view()], &poses[observation.view()]);
        let in_camera = self.in_camera(cameras, poses, observation)?;
        let (pixel, by_camera) = camera.camera.project_with_jacobian(&in_camera).ok()?;
        let by_global = by_camera * camera.rotation * view.rotation.transpose();
        let mut by_landmark = by_global * anchor.rotation * anchor_camera.rotation.transpose();
        let mut by_depth = by_camera * camera.offset - by_landmark * anchor_camera.offset;
        if observation.view() != self.anchor_view() {
            let direction = anchor.rotation * self.in_anchor_body(cameras);
            let baseline = anchor.position - view.position;
            let scaled = direction + baseline * self.inverse_depth;
            let by_position = by_global * self.inverse_depth;
            by_anchor.fixed_view_mut::<2, 3>(0, 0).copy_from(&(-by_global * skew(&direction)));
            by_anchor.fixed_view_mut::<2, 3>(0, 3).copy_from(&by_position);
            by_view.fixed_view_mut::<2, 3>(0, 0).copy_from(&(by_global * skew(&scaled)));
            by_view.fixed_view_mut::<2, 3>(0, 3).copy_from(&-by_position);
            by_depth += by_global * baseline;
        }
        by_landmark.set_column(2, &by_depth);
        Some(Prediction { pixel, by_anchor, by_view, by_landmark })
    }

    /// Adds an error `[ray, inverse depth]`, and keeps the inverse depth within limits (1/m).
    pub fn corrected(&self, error: &Vector3<f64>, [least, most]: [f64; 2]) -> InverseDepthLandmark {
        let mut landmark = self.clone();
        landmark.ray += error.xy();
        landmark.inverse_depth = (landmark.inverse_depth + error.z).clamp(least, most);
        landmark
    }

    /// Reprojection error of each observation (px), infinite where the landmark is not visible; zero for an anchor that
    /// is part of the prior.
    pub fn errors(&self, cameras: &[MountedCamera], poses: &[ViewPose]) -> Vec<f64> {
        let error = |(index, observation): (usize, &LandmarkObservation)| {
            if index == self.anchor && self.prior.is_some() {
                return 0.0;
            }
            let pixel = self.project(cameras, poses, index);
            pixel.map_or(f64::INFINITY, |pixel| (observation.pixel - pixel).norm())
        };
        self.observations.iter().enumerate().map(error).collect()
    }

    /// The same landmark re-anchored in another of its observations; `None` where it lies behind that camera.
    pub fn anchored_at(
        &self,
        index: usize,
        cameras: &[MountedCamera],
        poses: &[ViewPose],
    ) -> Option<InverseDepthLandmark> {
        if index == self.anchor {
            return Some(self.clone());
        }
        let (camera, view) =
            (&cameras[self.observations[index].camera], &poses[self.observations[index].view()]);
        let in_body = view.rotation.transpose() * (self.position(cameras, poses) - view.position);
        let p = camera.rotation * in_body + camera.offset;
        (p.z > 0.0 && p.z >= camera.least_depth).then(|| InverseDepthLandmark {
            anchor: index,
            ray: p.xy() / p.z,
            inverse_depth: 1.0 / p.z.min(MAX_DEPTH),
            observations: self.observations.clone(),
            prior: self.prior.clone(),
        })
    }

    /// Removes observations for which `keep` is false. The anchor must be kept or changed before.
    pub fn without(mut self, keep: &[bool]) -> InverseDepthLandmark {
        let mut kept = keep.iter();
        self.observations.retain(|_| kept.next().copied().unwrap_or(false));
        self.anchor = keep[..self.anchor].iter().filter(|&&keep| keep).count();
        self
    }

    /// Removes observations for which `keep` is false, and those by second cameras where the first one no longer observes
    /// it. `None` where fewer than `least` images are left, unless a stereo pair observes it. The anchor must be kept or
    /// changed before.
    pub fn retained(&self, keep: &[bool], least: usize) -> Option<InverseDepthLandmark> {
        let kept_features: Vec<FeatureId> = self
            .observations
            .iter()
            .zip(keep)
            .filter(|(observation, keep)| **keep && !observation.is_second)
            .map(|(observation, _)| observation.feature)
            .collect();
        let keep: Vec<bool> = self
            .observations
            .iter()
            .zip(keep)
            .map(|(s, keep)| *keep && kept_features.contains(&s.feature))
            .collect();
        let landmark = self.clone().without(&keep);
        let enough = kept_features.len() >= least
            || landmark.observations.iter().any(|observation| observation.is_second);
        (keep[self.anchor] && enough).then_some(landmark)
    }
}
