//! What the observations of a stored landmark say of it, given the poses of the keyframes that observe it.
//!
//! The poses of a map state what is left of its observations once the landmarks are eliminated. What these observations
//! say beyond that is the landmark given the poses:
//! ```text
//! y = -V^-1 W^T x + v,   v ~ N(0, V^-1),   V = sum J_y^T J_y / s^2,   W = sum J_x^T J_y / s^2
//! ```
//! with `y` the error of ray and inverse depth and `x` the errors of the poses, both relative to the map. The inverse depth is
//! compared by its logarithm: a difference of inverse depths becomes smaller when everything is made larger, so that hundreds
//! of landmarks, each with its noise, would make a map grow. Poses and this
//! together are the same as the observations themselves, so that each is used once, however often a map is extended.

use geometry::camera::Camera;
use geometry::pose::Pose;
use nalgebra::{Matrix3, Matrix3x6, Matrix6x3, Vector2, Vector3};
use types::LandmarkId;

use crate::camera::{MIN_DEPTH, MountedCamera, ViewPose};
use crate::landmark::{InverseDepthLandmark, LandmarkObservation, MAPPED_INVERSE_DEPTHS};
use crate::landmark_equations::LandmarkBlocks;
use crate::pose_prior::pose_error;

/// Gauss-Newton iterations from the position that the map states.
const STEPS: usize = 8;
/// Inverse depths of fewer standard deviations than this have no logarithm that is worth while.
const MIN_SIGMAS_OF_DEPTH: f64 = 5.0;
/// Least information on the inverse depth, m^2: for landmarks without parallax.
const MIN_DEPTH_INFORMATION: f64 = 1.0;

/// The distribution of a stored landmark given the poses of its keyframes.
#[derive(Clone, Debug, PartialEq)]
pub struct LandmarkPrior {
    /// Its id in the map.
    pub id: LandmarkId,
    /// Whether the inverse depth is given by its logarithm.
    pub is_logarithmic: bool,
    /// Ray and inverse depth in its anchor, at the stored poses.
    mean: Vector3<f64>,
    /// V.
    information: Matrix3<f64>,
    /// View, its stored pose, and its block of `V^-1 W^T`.
    poses: Vec<(usize, Pose, Matrix3x6<f64>)>,
}

/// A keyframe that observes a stored landmark.
pub struct StoredObserver<'a> {
    /// Its view.
    pub view: usize,
    /// Its stored pose.
    pub pose: Pose,
    /// Its camera.
    pub camera: &'a Camera,
    /// Where it sees the landmark (px).
    pub pixel: Vector2<f64>,
}

impl LandmarkPrior {
    /// A stored landmark with its prior, its anchor as the only observation.
    ///
    /// # Arguments
    /// * `position_in_anchor`: in the camera of its anchor (m).
    /// * `observers`: its anchor first.
    /// * `sigma_px`: px.
    ///
    /// # Returns
    /// `None` where the anchor or the landmark is impossible.
    pub fn landmark(
        id: LandmarkId,
        position_in_anchor: &Vector3<f64>,
        observers: &[StoredObserver<'_>],
        sigma_px: f64,
    ) -> Option<InverseDepthLandmark> {
        let p = position_in_anchor;
        if p.z < MIN_DEPTH {
            return None;
        }
        let unmoved =
            |observer: &StoredObserver<'_>| MountedCamera::new(observer.camera.clone(), &Pose::identity());
        let cameras: Vec<MountedCamera> = observers.iter().map(unmoved).collect();
        let poses: Vec<ViewPose> = observers.iter().map(|observer| ViewPose::from(&observer.pose)).collect();
        let observation = |(at, observer): (usize, &StoredObserver<'_>)| LandmarkObservation {
            feature: (at, 0),
            camera: at,
            is_second: false,
            pixel: observer.pixel,
        };
        let mut landmark = InverseDepthLandmark {
            anchor: 0,
            ray: p.xy() / p.z,
            inverse_depth: p.z.recip(),
            observations: observers.iter().enumerate().map(observation).collect(),
            prior: None,
        };
        let (mut information, mut couplings) = (Matrix3::zeros(), Vec::new());
        for _ in 0..STEPS {
            let gradient;
            (information, couplings, gradient) = linearize(&landmark, &cameras, &poses, sigma_px);
            let error = information.cholesky()?.solve(&gradient);
            landmark = landmark.corrected(&error, MAPPED_INVERSE_DEPTHS);
        }
        let inverse = information.try_inverse()?;
        let poses = observers.iter().zip(&couplings);
        let rho = landmark.inverse_depth;
        let is_logarithmic = rho > MIN_SIGMAS_OF_DEPTH * inverse[(2, 2)].sqrt();
        let unit = if is_logarithmic { rho } else { 1.0 };
        let (to_unit, of_unit) = (
            Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, 1.0 / unit)),
            Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, unit)),
        );
        let gain = |coupling: &Matrix6x3<f64>| to_unit * inverse * coupling.transpose();
        let prior = LandmarkPrior {
            id,
            is_logarithmic,
            mean: landmark.ray.push(if is_logarithmic { rho.ln() } else { rho }),
            information: of_unit * information * of_unit,
            poses: poses.map(|(observer, coupling)| (observer.view, observer.pose, gain(coupling))).collect(),
        };
        let anchor = LandmarkObservation {
            feature: (observers.first()?.view, 0),
            camera: 0,
            is_second: false,
            pixel: observers.first()?.pixel,
        };
        Some(InverseDepthLandmark { observations: vec![anchor], prior: Some(prior), ..landmark })
    }

    /// The views whose poses it depends on.
    pub fn views(&self) -> impl Iterator<Item = usize> {
        self.poses.iter().map(|(view, ..)| *view)
    }

    /// Ray and inverse depth as the prior gives them, and their Jacobian by ray and inverse depth.
    fn parameters(&self, landmark: &InverseDepthLandmark) -> (Vector3<f64>, Matrix3<f64>) {
        let rho = landmark.inverse_depth;
        let (depth, slope) = if !self.is_logarithmic {
            (rho, 1.0)
        } else if rho > 0.0 {
            (rho.ln(), rho.recip())
        } else {
            // The tangent at the mean.
            let mean = self.mean.z.exp();
            (self.mean.z + (rho - mean) / mean, mean.recip())
        };
        (landmark.ray.push(depth), Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, slope)))
    }

    /// `y + V^-1 W^T x`, with the error of each pose and its Jacobian.
    fn residual(&self, landmark: &InverseDepthLandmark, poses: &[Pose]) -> Vector3<f64> {
        let start = self.parameters(landmark).0 - self.mean;
        self.poses.iter().fold(start, |sum, (view, mean, gain)| sum + gain * mean.local(&poses[*view]))
    }

    /// Ray and inverse depth (or its logarithm) in the anchor, given poses.
    pub fn expected(&self, poses: &[Pose]) -> Vector3<f64> {
        self.poses.iter().fold(self.mean, |sum, (view, mean, gain)| sum - gain * mean.local(&poses[*view]))
    }

    /// How they change with the error of each pose: minus these.
    pub fn gains(&self, poses: &[Pose]) -> impl Iterator<Item = (usize, Matrix3x6<f64>)> {
        self.poses.iter().map(|(view, mean, gain)| (*view, gain * pose_error(mean, &poses[*view]).1))
    }

    /// Their covariance, given the poses.
    pub fn covariance(&self) -> Option<Matrix3<f64>> {
        self.information.try_inverse()
    }

    /// Half the squared residual, in standard deviations.
    pub fn cost(&self, landmark: &InverseDepthLandmark, poses: &[Pose]) -> f64 {
        let residual = self.residual(landmark, poses);
        0.5 * residual.dot(&(self.information * residual))
    }

    /// Adds the linearized residual.
    pub fn add_to(&self, blocks: &mut LandmarkBlocks, landmark: &InverseDepthLandmark, poses: &[Pose]) {
        let weighted = self.information * self.residual(landmark, poses);
        let by_landmark = self.parameters(landmark).1;
        blocks.information += by_landmark * self.information * by_landmark;
        blocks.gradient -= by_landmark * weighted;
        let by_pose: Vec<(usize, Matrix3x6<f64>)> = self.gains(poses).collect();
        for (index, (view, by_view)) in by_pose.iter().enumerate() {
            let coupling: Matrix6x3<f64> = by_view.transpose() * self.information;
            blocks.poses.push((*view, coupling * by_view, -(by_view.transpose() * weighted)));
            for (other, by_other) in &by_pose[index + 1..] {
                blocks.pairs.push((*view, *other, coupling * by_other));
            }
            blocks.couplings.push((*view, coupling * by_landmark));
        }
    }
}

/// V, the blocks of W and the negative gradient by the landmark.
fn linearize(
    landmark: &InverseDepthLandmark,
    cameras: &[MountedCamera],
    poses: &[ViewPose],
    sigma_px: f64,
) -> (Matrix3<f64>, Vec<Matrix6x3<f64>>, Vector3<f64>) {
    let weight = (sigma_px * sigma_px).recip();
    let mut information = Matrix3::zeros();
    information[(2, 2)] = MIN_DEPTH_INFORMATION;
    let mut gradient = Vector3::zeros();
    let mut couplings = vec![Matrix6x3::zeros(); poses.len()];
    for (at, observation) in landmark.observations.iter().enumerate() {
        let Some(predicted) = landmark.predict(cameras, poses, at) else { continue };
        let weighted = predicted.by_landmark.transpose() * weight;
        information += weighted * predicted.by_landmark;
        gradient += weighted * (observation.pixel - predicted.pixel);
        couplings[landmark.anchor] += predicted.by_anchor.transpose() * predicted.by_landmark * weight;
        couplings[at] += predicted.by_view.transpose() * predicted.by_landmark * weight;
    }
    (information, couplings, gradient)
}
