//! The cost of a bundle, its normal equations, and a step of all unknowns.
//!
//! Reference poses that are each off by 0.1 m and 0.9 deg disagree with the images by 10 px, the images with each
//! other by 1 px. The position of a landmark *in its anchor's camera frame* has to be as accurate as the images
//! allow, so the poses are estimated with it.

use nalgebra::{Matrix6, Matrix6x3, Vector2, Vector6};

use crate::bundle::Bundle;
use crate::camera::{MountedCamera, ViewPose};
use crate::covariance::StateCovariance;
use crate::factor::Factor;
use crate::landmark::{InverseDepthLandmark, Prediction};
use crate::landmark_equations::{LandmarkBlocks, LandmarkEquations};
use crate::loss::Loss;
use crate::normal_equations::{NormalEquations, Step};
use crate::parallel;
use crate::sparse_system::SparseCholesky;

/// Landmarks whose equations are summed up by one thread: so few that their blocks stay in its cache.
const RUN: usize = 512;
/// Decrease of the cost of a landmark below which its step is the last one.
const LANDMARK_CONVERGED: f64 = 1e-3;

/// What is assumed of pixels and of the landmarks that they show.
#[derive(Clone, Copy, Debug)]
pub struct PixelModel {
    /// Standard deviation of a pixel (px).
    pub sigma_px: f64,
    /// Loss of a residual.
    pub loss: Loss,
    /// Information of a weak prior on the inverse depth (m^2), for landmarks without parallax.
    pub depth_information: f64,
    /// Limits of the inverse depth (1/m).
    pub inverse_depths: [f64; 2],
    /// Steps of each landmark by itself after each step of all. Where the scale of a trajectory changes, all depths must change
    /// with it, which a linear step does not achieve (embedded point iterations, Jeong et al., PAMI 2012).
    pub landmark_steps: usize,
}

impl PixelModel {
    /// Information of a residual of this length (px^-2): `sigma^-2` over its attenuation.
    fn weight(&self, residual: f64, scale: f64) -> f64 {
        (self.sigma_px * self.sigma_px * self.loss.attenuation(residual / self.sigma_px, scale)).recip()
    }
}

/// What a bundle is adjusted to.
pub struct Problem<'a> {
    /// The cameras.
    pub cameras: &'a [MountedCamera],
    /// All terms of the cost besides pixels, for example priors of poses.
    pub factors: Vec<&'a dyn Factor>,
    /// Noise and loss of the pixels.
    pub pixels: PixelModel,
}

/// A pixel of a landmark, linearized.
struct WeightedPixel {
    view: usize,
    predicted: Prediction,
    residual: Vector2<f64>,
    weight: f64,
}

impl WeightedPixel {
    fn add_to(&self, blocks: &mut LandmarkBlocks) {
        let by_landmark = self.predicted.by_landmark;
        blocks.information += by_landmark.transpose() * by_landmark * self.weight;
        blocks.gradient += by_landmark.transpose() * self.residual * self.weight;
    }
}

impl Problem<'_> {
    /// The covariance of all states at the minimum, without robust weights.
    ///
    /// # Returns
    /// `None` where the states are not determined.
    pub fn covariance(&self, bundle: &Bundle) -> Option<StateCovariance> {
        self.equations(bundle, f64::INFINITY, 0.0).covariance()
    }

    /// One damped Gauss-Newton step; `None` where the equations are singular.
    pub(crate) fn step(
        &self,
        bundle: &Bundle,
        scale: f64,
        damping: f64,
        cholesky: &mut SparseCholesky,
    ) -> Option<Bundle> {
        let step = self.equations(bundle, scale, damping).solve_with(cholesky, damping)?;
        Some(self.stepped(bundle, &step, 1.0, scale))
    }

    /// The bundle moved by a part of a step, with the landmarks adjusted by themselves after it.
    pub(crate) fn stepped(&self, bundle: &Bundle, step: &Step, part: f64, scale: f64) -> Bundle {
        let mut next = bundle.moved(&(&step.states * part));
        let poses = next.view_poses();
        for (landmark, error) in next.landmarks.iter_mut().zip(&step.landmarks) {
            *landmark = landmark.corrected(&(error * part), self.pixels.inverse_depths);
            self.adjust_landmark(landmark, &poses, scale);
        }
        next
    }

    /// A bundle after a step, and its cost, if that is lower than before.
    ///
    /// # Arguments
    /// * `before`: cost of the bundle before the step.
    /// * `holds_landmarks`: where the cost is not lower, landmarks that the step made worse stay where they were. One that its pixels hardly
    ///   determine goes astray with any part of a step, and would keep everything else from moving.
    pub(crate) fn lower(
        &self,
        (start, before): (&Bundle, f64),
        mut candidate: Bundle,
        scale: f64,
        holds_landmarks: bool,
    ) -> Option<(Bundle, f64)> {
        let after = self.cost(&candidate, scale);
        if after < before || !holds_landmarks {
            return (after < before).then_some((candidate, after));
        }
        let poses = candidate.view_poses();
        for (moved, unmoved) in candidate.landmarks.iter_mut().zip(&start.landmarks) {
            let cost = |landmark: &InverseDepthLandmark| {
                let of_prior =
                    landmark.prior.as_ref().map_or(0.0, |prior| prior.cost(landmark, &candidate.poses));
                of_prior + self.landmark_cost(landmark, &poses, scale)
            };
            let (of_moved, of_unmoved) = (cost(moved), cost(unmoved));
            if of_moved.is_nan() || of_moved > of_unmoved {
                moved.clone_from(unmoved);
            }
        }
        self.lower((start, before), candidate, scale, false)
    }

    /// Steps of one landmark for fixed poses.
    fn adjust_landmark(&self, landmark: &mut InverseDepthLandmark, poses: &[ViewPose], scale: f64) {
        let mut cost = None;
        for _ in 0..self.pixels.landmark_steps {
            let before = cost.unwrap_or_else(|| self.landmark_cost(landmark, poses, scale));
            let mut blocks = LandmarkBlocks::default();
            self.weighted_pixels(landmark, poses, scale).for_each(|pixel| pixel.add_to(&mut blocks));
            blocks.information[(2, 2)] += self.pixels.depth_information;
            let Some(inverse) = blocks.information.try_inverse() else { break };
            let moved = landmark.corrected(&(inverse * blocks.gradient), self.pixels.inverse_depths);
            let after = self.landmark_cost(&moved, poses, scale);
            if after.is_nan() || before - after <= LANDMARK_CONVERGED {
                break;
            }
            cost = Some(after);
            *landmark = moved;
        }
    }

    /// The normal equations at a bundle.
    ///
    /// # Arguments
    /// * `scale`: of the robust losses (standard deviations); infinite for none.
    /// * `damping`: of the landmarks; that of the states is an argument of [`NormalEquations::solve`].
    pub fn equations(&self, bundle: &Bundle, scale: f64, damping: f64) -> NormalEquations {
        let mut equations = NormalEquations::new(bundle.layout());
        for factor in &self.factors {
            factor.add_to(&mut equations, bundle, scale);
        }
        let poses = bundle.view_poses();
        let run = |landmarks: &[InverseDepthLandmark]| {
            self.landmark_equations(landmarks, bundle, &poses, scale, damping)
        };
        parallel::for_each_run(&bundle.landmarks, RUN, run, |of_run| equations.add_landmarks(of_run));
        equations
    }

    /// The equations of some landmarks at a bundle.
    fn landmark_equations(
        &self,
        landmarks: &[InverseDepthLandmark],
        bundle: &Bundle,
        poses: &[ViewPose],
        scale: f64,
        damping: f64,
    ) -> LandmarkEquations {
        let mut equations =
            LandmarkEquations::new(landmarks.iter().flat_map(InverseDepthLandmark::views_with_prior));
        let mut blocks = LandmarkBlocks::default();
        for landmark in landmarks {
            blocks.clear();
            if let Some(prior) = &landmark.prior {
                prior.add_to(&mut blocks, landmark, &bundle.poses);
            }
            self.add_pixels(&mut blocks, landmark, poses, scale);
            for index in 0..3 {
                blocks.information[(index, index)] *= 1.0 + damping;
            }
            if landmark.prior.is_none() {
                blocks.information[(2, 2)] += self.pixels.depth_information;
            }
            equations.add_landmark(&blocks);
        }
        equations
    }

    fn add_pixels(
        &self,
        blocks: &mut LandmarkBlocks,
        landmark: &InverseDepthLandmark,
        poses: &[ViewPose],
        scale: f64,
    ) {
        let anchor = landmark.anchor_view();
        let (mut anchor_information, mut anchor_gradient) = (Matrix6::zeros(), Vector6::zeros());
        let mut anchor_coupling = Matrix6x3::zeros();
        for pixel in self.weighted_pixels(landmark, poses, scale) {
            pixel.add_to(blocks);
            let WeightedPixel { view, predicted, residual, weight } = pixel;
            if view == anchor {
                // The pixel does not depend on the pose of the anchor.
                continue;
            }
            let by_anchor = predicted.by_anchor.transpose() * weight;
            let by_view = predicted.by_view.transpose() * weight;
            anchor_information += by_anchor * predicted.by_anchor;
            anchor_gradient += by_anchor * residual;
            anchor_coupling += by_anchor * predicted.by_landmark;
            blocks.poses.push((view, by_view * predicted.by_view, by_view * residual));
            blocks.pairs.push((anchor, view, by_anchor * predicted.by_view));
            blocks.couplings.push((view, by_view * predicted.by_landmark));
        }
        blocks.poses.push((anchor, anchor_information, anchor_gradient));
        blocks.couplings.push((anchor, anchor_coupling));
    }

    /// The visible pixels of a landmark besides those of its prior.
    fn weighted_pixels(
        &self,
        landmark: &InverseDepthLandmark,
        poses: &[ViewPose],
        scale: f64,
    ) -> impl Iterator<Item = WeightedPixel> {
        landmark.observations.iter().enumerate().filter_map(move |(index, observation)| {
            if index == landmark.anchor && landmark.prior.is_some() {
                return None;
            }
            let predicted = landmark.predict(self.cameras, poses, index)?;
            let residual = observation.pixel - predicted.pixel;
            let weight = self.pixels.weight(residual.norm(), scale);
            Some(WeightedPixel { view: observation.view(), predicted, residual, weight })
        })
    }

    /// The cost whose gradient the equations have.
    pub fn cost(&self, bundle: &Bundle, scale: f64) -> f64 {
        let factors: f64 = self.factors.iter().map(|factor| factor.cost(bundle, scale)).sum();
        let known = bundle
            .landmarks
            .iter()
            .filter_map(|landmark| landmark.prior.as_ref().map(|prior| prior.cost(landmark, &bundle.poses)));
        let known: f64 = known.sum();
        let poses = bundle.view_poses();
        let pixels = bundle.landmarks.iter().map(|landmark| self.landmark_cost(landmark, &poses, scale));
        factors + known + pixels.sum::<f64>()
    }

    /// The loss of all pixels of a landmark.
    fn landmark_cost(&self, landmark: &InverseDepthLandmark, poses: &[ViewPose], scale: f64) -> f64 {
        let PixelModel { loss, sigma_px, .. } = self.pixels;
        let errors = landmark.errors(self.cameras, poses).into_iter();
        errors.map(|error| loss.cost(error / sigma_px, scale)).sum()
    }
}
