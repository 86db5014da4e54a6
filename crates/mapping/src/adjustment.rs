//! Refining all landmarks together with the poses (bundle adjustment), with the given poses as priors.
//!
//! Reference poses that are each off by 0.1 m and 0.9 deg disagree with the images by 10 px, the images with each
//! other by 1 px. A landmark is wanted as exactly as the images tell where it is *in its anchor's camera frame*, so the
//! poses have to give way while it is located.

use geometry::pose::Pose;
use geometry::rotation::left_jacobian_inverse;
use geometry::uncertain_pose::PoseWithCovariance;
use nalgebra::{Matrix6, Vector6};

use super::joint_covariance::BlockMatrix;
use super::normal_equations::{NormalEquations, PointBlocks};
use super::point::{CameraPose, Lens, Point};

/// Smallest sigmas of a pose (rad, m) that the equations can do with, where a map is built from exact poses.
const LEAST_SIGMAS: [f64; 2] = [1e-5, 1e-4];
/// Residuals count less and less beyond this many sigmas (Cauchy), at first ...
const FIRST_SCALE: f64 = 16.0;
/// ... and in the end.
const LAST_SCALE: f64 = 3.0;
/// From step to step the scale shrinks by this factor: wide first, so that good sightings pull bad poses right.
const SCALE_FACTOR: f64 = 0.6;
/// Most steps.
const MAX_STEPS: usize = 25;
/// The refinement has converged when a step lowers the cost by less than this part.
const CONVERGED: f64 = 1e-4;
/// Damping of the first step, and its limits (Levenberg-Marquardt).
const DAMPING: [f64; 3] = [1e-4, 1e-8, 1e4];

/// Poses and landmarks that fit each other.
#[derive(Clone)]
pub(super) struct Bundle {
    /// `global_from_camera` of each view.
    pub(super) poses: Vec<Pose>,
    /// All landmarks.
    pub(super) points: Vec<Point>,
}

impl Bundle {
    /// The poses as matrices.
    pub(super) fn camera_poses(&self) -> Vec<CameraPose> {
        self.poses.iter().map(CameraPose::from).collect()
    }
}

/// What is refined against.
pub(super) struct Problem<'a> {
    rig: &'a [Lens],
    priors: &'a [PoseWithCovariance],
    information: Vec<Matrix6<f64>>,
    sigma_px: f64,
}

impl<'a> Problem<'a> {
    /// A problem of its camera, given poses and pixel noise (px).
    pub(super) fn new(rig: &'a [Lens], priors: &'a [PoseWithCovariance], sigma_px: f64) -> Problem<'a> {
        let information = priors.iter().map(|prior| pose_information(&prior.covariance)).collect();
        Problem { rig, priors, information, sigma_px }
    }

    /// Refines a bundle.
    ///
    /// # Arguments
    /// * `from_priors`: the poses are still the given ones, so start with a wide scale.
    /// * `progress`: told the steps done and the most there will be.
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
            let moved = self.step(&bundle, scale, damping);
            let after = self.cost(&moved, scale);
            if after < before {
                bundle = moved;
                damping = (damping / 3.0).max(least);
                accepted_scale = scale;
            } else {
                damping *= 10.0;
            }
            let settled = accepted_scale <= LAST_SCALE && before - after < CONVERGED * before;
            if (settled && after < before) || damping > most {
                break;
            }
            scale = (scale * SCALE_FACTOR).max(LAST_SCALE);
        }
        progress(MAX_STEPS, MAX_STEPS);
        bundle
    }

    /// The normal equations of the poses alone at a refined bundle, every landmark eliminated: the inverse of their
    /// joint covariance.
    pub(super) fn reduced_equations(&self, bundle: &Bundle) -> BlockMatrix {
        self.equations(bundle, LAST_SCALE, 0.0).reduced()
    }

    /// One damped Gauss-Newton step.
    fn step(&self, bundle: &Bundle, scale: f64, damping: f64) -> Bundle {
        let step = self.equations(bundle, scale, damping).solve();
        Bundle {
            poses: bundle.poses.iter().zip(&step.poses).map(|(pose, error)| pose.retract(error)).collect(),
            points: bundle.points.iter().zip(&step.points).map(|(point, error)| point.moved(error)).collect(),
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
        for point in &bundle.points {
            self.add_point(&mut equations, point, &poses, scale, damping);
        }
        equations.damp(damping);
        equations
    }

    fn add_point(
        &self,
        equations: &mut NormalEquations,
        point: &Point,
        poses: &[CameraPose],
        scale: f64,
        damping: f64,
    ) {
        let mut blocks = PointBlocks::default();
        let anchor = point.anchor_view();
        let mut anchor_coupling = nalgebra::Matrix6x3::zeros();
        for (index, sighting) in point.sightings.iter().enumerate() {
            if index == point.anchor {
                let (pixel, by_ray) = point.predict_in_anchor(self.rig);
                let residual = sighting.pixel - pixel;
                let weight = self.weight(residual.norm(), scale);
                let mut information = blocks.information.fixed_view_mut::<2, 2>(0, 0);
                information += by_ray.transpose() * by_ray * weight;
                let mut gradient = blocks.gradient.fixed_rows_mut::<2>(0);
                gradient += by_ray.transpose() * residual * weight;
                continue;
            }
            let view = sighting.view();
            let Some(predicted) = point.predict(self.rig, poses, sighting) else { continue };
            let residual = sighting.pixel - predicted.pixel;
            let weight = self.weight(residual.norm(), scale);
            let by_anchor = predicted.by_anchor.transpose() * weight;
            let by_view = predicted.by_view.transpose() * weight;
            equations.add_pose(anchor, &(by_anchor * predicted.by_anchor), &(by_anchor * residual));
            equations.add_pose(view, &(by_view * predicted.by_view), &(by_view * residual));
            if view != anchor {
                blocks.pairs.push((anchor, view, by_anchor * predicted.by_view));
                blocks.couplings.push((view, by_view * predicted.by_point));
            }
            anchor_coupling += by_anchor * predicted.by_point;
            blocks.information += predicted.by_point.transpose() * predicted.by_point * weight;
            blocks.gradient += predicted.by_point.transpose() * residual * weight;
        }
        blocks.couplings.push((anchor, anchor_coupling));
        for index in 0..3 {
            blocks.information[(index, index)] *= 1.0 + damping;
        }
        // A weak hold on the inverse depth (sigma 1/m) for points without parallax.
        blocks.information[(2, 2)] += 1.0;
        equations.add_point(blocks);
    }

    /// The error `[δθ, δp]` of a pose against the given one, and its Jacobian by a further error.
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
        let errors = bundle.points.iter().flat_map(|point| point.errors(self.rig, &poses));
        priors + errors.map(robust).sum::<f64>()
    }
}

/// Inverse of a covariance, with a floor for poses that are said to be exact.
fn pose_information(covariance: &Matrix6<f64>) -> Matrix6<f64> {
    let mut floored = *covariance;
    for index in 0..6 {
        floored[(index, index)] += LEAST_SIGMAS[index / 3].powi(2);
    }
    floored.try_inverse().unwrap_or_else(|| Matrix6::identity() / LEAST_SIGMAS[0].powi(2))
}
