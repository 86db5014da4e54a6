//! Bundle adjustment: all landmarks together with the poses, with the reference poses as priors.
//!
//! Reference poses that are each off by 0.1 m and 0.9 deg disagree with the images by 10 px, the images with each
//! other by 1 px. The position of a landmark *in its anchor's camera frame* has to be as accurate as the images
//! allow, so the poses are estimated with it.

use geometry::pose::Pose;
use geometry::rotation::left_jacobian_inverse;
use geometry::uncertain_pose::PoseWithCovariance;
use nalgebra::{Matrix6, Vector6};

use super::block_matrix::BlockMatrix;
use super::camera::{CameraPose, MappingCamera};
use super::landmark::InverseDepthLandmark;
use super::normal_equations::{LandmarkBlocks, NormalEquations};

/// Lower bounds of the standard deviations of a prior pose (rad, m), which keep the equations well-conditioned where a map
/// is built from exact poses.
const MIN_SIGMAS: [f64; 2] = [1e-5, 1e-4];
/// Scale of Cauchy's robust loss in the first iteration (standard deviations of a pixel): reference poses off by
/// 0.1 m and 0.9 deg cause residuals of 10 px.
const FIRST_SCALE: f64 = 16.0;
/// Scale in the end: rejects what pixel noise cannot explain.
const LAST_SCALE: f64 = 3.0;
/// Factor between the scales of two iterations (graduated non-convexity): wide first, so that inliers correct bad poses.
const SCALE_FACTOR: f64 = 0.6;
/// Maximum number of iterations: the scale reaches its end after 4, the others are for convergence.
const MAX_STEPS: usize = 25;
/// Converged when a step lowers the cost by less than this part.
const CONVERGED: f64 = 1e-4;
/// Damping of the first step, and its limits (Levenberg-Marquardt).
const DAMPING: [f64; 3] = [1e-4, 1e-8, 1e4];

/// The estimated poses and landmarks.
#[derive(Clone)]
pub(super) struct Bundle {
    /// `global_from_camera` of each view.
    pub(super) poses: Vec<Pose>,
    /// All landmarks.
    pub(super) landmarks: Vec<InverseDepthLandmark>,
}

impl Bundle {
    /// The poses with rotation matrices.
    pub(super) fn camera_poses(&self) -> Vec<CameraPose> {
        self.poses.iter().map(CameraPose::from).collect()
    }
}

/// What the bundle is adjusted to.
pub(super) struct Problem<'a> {
    cameras: &'a [MappingCamera],
    priors: &'a [PoseWithCovariance],
    information: Vec<Matrix6<f64>>,
    sigma_px: f64,
}

impl<'a> Problem<'a> {
    /// A problem with its cameras, prior poses and pixel noise (px).
    pub(super) fn new(
        cameras: &'a [MappingCamera],
        priors: &'a [PoseWithCovariance],
        sigma_px: f64,
    ) -> Problem<'a> {
        let information = priors.iter().map(|prior| pose_information(&prior.covariance)).collect();
        Problem { cameras, priors, information, sigma_px }
    }

    /// Minimizes the cost from an initial bundle (Levenberg-Marquardt).
    ///
    /// # Arguments
    /// * `from_priors`: the poses are still the reference poses, so start with a wide scale.
    /// * `progress`: called with the iterations done and their maximum.
    pub(super) fn refine(
        &self,
        start: Bundle,
        from_priors: bool,
        mut progress: impl FnMut(usize, usize),
    ) -> Bundle {
        let mut bundle = start;
        let mut scale = if from_priors { FIRST_SCALE } else { LAST_SCALE };
        let [mut damping, least, most] = DAMPING;
        let mut accepted_scale = f64::INFINITY;
        for step in 0..MAX_STEPS {
            progress(step, MAX_STEPS);
            let before = self.cost(&bundle, scale);
            let candidate = self.step(&bundle, scale, damping);
            let after = self.cost(&candidate, scale);
            if after < before {
                bundle = candidate;
                damping = (damping / 3.0).max(least);
                accepted_scale = scale;
            } else {
                damping *= 10.0;
            }
            let converged = accepted_scale <= LAST_SCALE && before - after < CONVERGED * before;
            if (converged && after < before) || damping > most {
                break;
            }
            scale = (scale * SCALE_FACTOR).max(LAST_SCALE);
        }
        progress(MAX_STEPS, MAX_STEPS);
        bundle
    }

    /// The normal equations of the poses at the minimum, with all landmarks eliminated: the information matrix of the poses.
    pub(super) fn reduced_equations(&self, bundle: &Bundle) -> BlockMatrix {
        self.equations(bundle, LAST_SCALE, 0.0).reduced()
    }

    /// One damped Gauss-Newton step.
    fn step(&self, bundle: &Bundle, scale: f64, damping: f64) -> Bundle {
        let step = self.equations(bundle, scale, damping).solve();
        Bundle {
            poses: bundle.poses.iter().zip(&step.poses).map(|(pose, error)| pose.retract(error)).collect(),
            landmarks: bundle
                .landmarks
                .iter()
                .zip(&step.landmarks)
                .map(|(landmark, error)| landmark.corrected(error))
                .collect(),
        }
    }

    /// The normal equations at a bundle.
    fn equations(&self, bundle: &Bundle, scale: f64, damping: f64) -> NormalEquations {
        let mut equations = NormalEquations::new(bundle.poses.len());
        for (view, pose) in bundle.poses.iter().enumerate() {
            let (error, jacobian) = self.prior_error(view, pose);
            let weighted = jacobian.transpose() * self.information[view];
            equations.add_pose(view, &(weighted * jacobian), &-(weighted * error));
        }
        let poses = bundle.camera_poses();
        for landmark in &bundle.landmarks {
            self.add_landmark(&mut equations, landmark, &poses, scale, damping);
        }
        equations.damp(damping);
        equations
    }

    fn add_landmark(
        &self,
        equations: &mut NormalEquations,
        landmark: &InverseDepthLandmark,
        poses: &[CameraPose],
        scale: f64,
        damping: f64,
    ) {
        let mut blocks = LandmarkBlocks::default();
        let anchor = landmark.anchor_view();
        let mut anchor_coupling = nalgebra::Matrix6x3::zeros();
        for (index, observation) in landmark.observations.iter().enumerate() {
            if index == landmark.anchor {
                let (pixel, by_ray) = landmark.predict_in_anchor(self.cameras);
                let residual = observation.pixel - pixel;
                let weight = self.weight(residual.norm(), scale);
                let mut information = blocks.information.fixed_view_mut::<2, 2>(0, 0);
                information += by_ray.transpose() * by_ray * weight;
                let mut gradient = blocks.gradient.fixed_rows_mut::<2>(0);
                gradient += by_ray.transpose() * residual * weight;
                continue;
            }
            let view = observation.view();
            let Some(predicted) = landmark.predict(self.cameras, poses, observation) else { continue };
            let residual = observation.pixel - predicted.pixel;
            let weight = self.weight(residual.norm(), scale);
            let by_anchor = predicted.by_anchor.transpose() * weight;
            let by_view = predicted.by_view.transpose() * weight;
            equations.add_pose(anchor, &(by_anchor * predicted.by_anchor), &(by_anchor * residual));
            equations.add_pose(view, &(by_view * predicted.by_view), &(by_view * residual));
            if view != anchor {
                blocks.pairs.push((anchor, view, by_anchor * predicted.by_view));
                blocks.couplings.push((view, by_view * predicted.by_landmark));
            }
            anchor_coupling += by_anchor * predicted.by_landmark;
            blocks.information += predicted.by_landmark.transpose() * predicted.by_landmark * weight;
            blocks.gradient += predicted.by_landmark.transpose() * residual * weight;
        }
        blocks.couplings.push((anchor, anchor_coupling));
        for index in 0..3 {
            blocks.information[(index, index)] *= 1.0 + damping;
        }
        // A weak prior on the inverse depth (sigma 1/m) for landmarks without parallax.
        blocks.information[(2, 2)] += 1.0;
        equations.add_landmark(blocks);
    }

    /// The error `[δθ, δp]` of a pose relative to its prior, and its Jacobian by a further error.
    fn prior_error(&self, view: usize, pose: &Pose) -> (Vector6<f64>, Matrix6<f64>) {
        let error = self.priors[view].pose.local(pose);
        let mut jacobian = Matrix6::identity();
        let by_rotation = left_jacobian_inverse(&error.fixed_rows::<3>(0).into_owned());
        jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&by_rotation);
        (error, jacobian)
    }

    /// Information of a residual of this length (px^-2): `sigma^-2 / (1 + (e / scale sigma)^2)`.
    fn weight(&self, residual: f64, scale: f64) -> f64 {
        let sigmas = residual / self.sigma_px;
        (self.sigma_px * self.sigma_px * (1.0 + (sigmas / scale).powi(2))).recip()
    }

    /// The cost whose weights are [`Problem::weight`].
    fn cost(&self, bundle: &Bundle, scale: f64) -> f64 {
        let priors: f64 = bundle
            .poses
            .iter()
            .enumerate()
            .map(|(view, pose)| {
                let error = self.priors[view].pose.local(pose);
                0.5 * error.dot(&(self.information[view] * error))
            })
            .sum();
        let poses = bundle.camera_poses();
        let robust = |error: f64| {
            let sigmas = (error / self.sigma_px).min(1e6);
            0.5 * scale * scale * (sigmas / scale).powi(2).ln_1p()
        };
        let errors = bundle.landmarks.iter().flat_map(|landmark| landmark.errors(self.cameras, &poses));
        priors + errors.map(robust).sum::<f64>()
    }
}

/// Inverse of a covariance, with a lower bound for exact poses.
fn pose_information(covariance: &Matrix6<f64>) -> Matrix6<f64> {
    let mut floored = *covariance;
    for index in 0..6 {
        floored[(index, index)] += MIN_SIGMAS[index / 3].powi(2);
    }
    floored.try_inverse().unwrap_or_else(|| Matrix6::identity() / MIN_SIGMAS[0].powi(2))
}
