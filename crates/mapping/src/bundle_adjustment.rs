//! Bundle adjustment: all landmarks together with the poses, with the reference poses as priors.
//!
//! Reference poses that are each off by 0.1 m and 0.9 deg disagree with the images by 10 px, the images with each
//! other by 1 px. The position of a landmark *in its anchor's camera frame* has to be as accurate as the images
//! allow, so the poses are estimated with it.

use geometry::pose::Pose;
use nalgebra::{DVector, Matrix6, Matrix6x3, Vector6};

use super::camera::{CameraPose, MappingCamera};
use super::inertial::{InertialChain, Motion};
use super::landmark::InverseDepthLandmark;
use super::landmark_equations::{LandmarkBlocks, LandmarkEquations};
use super::landmark_tie::LandmarkTie;
use super::layout::{MOTION, POSE, StateLayout};
use super::normal_equations::NormalEquations;
use super::parallel;
use super::pose_prior::PosePrior;
use super::pose_priors::PriorFactors;
use super::relative_pose::RelativePose;
use super::sparse_system::SparseFactor;
use super::stored_poses::JointPrior;

/// Scale of Cauchy's robust loss in the first iteration (standard deviations of a pixel): reference poses off by
/// 0.1 m and 0.9 deg cause residuals of 10 px.
const FIRST_SCALE: f64 = 16.0;
/// Scale in the end: rejects what pixel noise cannot explain.
const LAST_SCALE: f64 = 3.0;
/// Factor between the scales of two iterations (graduated non-convexity): wide first, so that inliers correct bad poses.
const SCALE_FACTOR: f64 = 0.6;
/// Maximum number of iterations: the scale reaches its end after 4, the others are for convergence.
const MAX_STEPS: usize = 25;
/// Damped steps end when one lowers the cost by less than this part.
const CONVERGED: f64 = 1e-4;
/// Undamped steps end when one lowers the cost by less than this: the cost is half a squared Mahalanobis distance, so that what is
/// left then is a small part of a standard deviation in every direction.
const FINAL_CONVERGED: f64 = 0.01;
/// Maximum number of undamped steps at the end.
const FINAL_STEPS: usize = 20;
/// Landmarks whose equations are summed up by one thread: so few that their blocks stay in its cache.
const RUN: usize = 512;
/// Damping of the first step, and its limits (Levenberg-Marquardt).
const DAMPING: [f64; 3] = [1e-4, 1e-8, 1e4];

/// The estimated poses and landmarks.
#[derive(Clone)]
pub(super) struct Bundle {
    /// `global_from_camera` of each view.
    pub(super) poses: Vec<Pose>,
    /// Velocity and biases of each view; empty without an IMU.
    pub(super) motions: Vec<Motion>,
    /// All landmarks.
    pub(super) landmarks: Vec<InverseDepthLandmark>,
}

impl Bundle {
    /// The poses with rotation matrices.
    pub(super) fn camera_poses(&self) -> Vec<CameraPose> {
        self.poses.iter().map(CameraPose::from).collect()
    }

    /// The layout of the states.
    pub(super) fn layout(&self) -> StateLayout {
        StateLayout { views: self.poses.len(), motions: self.motions.len() }
    }

    /// The bundle moved by an error of its states.
    pub(super) fn moved(&self, error: &DVector<f64>) -> Bundle {
        let layout = self.layout();
        let pose = |(view, pose): (usize, &Pose)| {
            pose.retract(&error.fixed_rows::<POSE>(layout.pose(view).start).into_owned())
        };
        let motion = |(view, motion): (usize, &Motion)| {
            motion.retract(&error.fixed_rows::<MOTION>(layout.motion(view).start).into_owned())
        };
        Bundle {
            poses: self.poses.iter().enumerate().map(pose).collect(),
            motions: self.motions.iter().enumerate().map(motion).collect(),
            landmarks: self.landmarks.clone(),
        }
    }
}

/// What the bundle is adjusted to, besides the pixels of its landmarks.
pub(super) struct Problem<'a> {
    /// The cameras.
    pub(super) cameras: &'a [MappingCamera],
    /// Priors of poses: reference poses, or that of the first pose, which defines G.
    pub(super) priors: &'a [PosePrior],
    /// Measured poses and positions, some of which may be wrong.
    pub(super) measured: &'a PriorFactors,
    /// Readings of the IMU between the views.
    pub(super) inertial: Option<&'a InertialChain>,
    /// Relative poses of places that are seen again.
    pub(super) relative_poses: &'a [RelativePose],
    /// Poses of the keyframes of maps that are extended or merged.
    pub(super) stored: &'a [JointPrior],
    /// Landmarks that two maps share.
    pub(super) ties: &'a [LandmarkTie],
    /// Standard deviation of a pixel (px).
    pub(super) sigma_px: f64,
}

impl Problem<'_> {
    /// Minimizes the cost from an initial bundle: Levenberg-Marquardt, then undamped steps.
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
            let after = candidate.as_ref().map_or(f64::INFINITY, |candidate| self.cost(candidate, scale));
            if let Some(candidate) = candidate.filter(|_| after < before) {
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
        self.finish(bundle)
    }

    /// Undamped steps. Neighbouring poses are known to millimetres and the shape of a long trajectory to decimetres: damped steps, which
    /// are relative to the diagonal, hardly move the whole, and end some standard deviations from the minimum.
    fn finish(&self, start: Bundle) -> Bundle {
        let mut bundle = start;
        let mut cost = self.cost(&bundle, LAST_SCALE);
        for _ in 0..FINAL_STEPS {
            let Some(candidate) = self.step(&bundle, LAST_SCALE, 0.0) else { break };
            let after = self.cost(&candidate, LAST_SCALE);
            if after >= cost {
                break;
            }
            let lowered = cost - after;
            (bundle, cost) = (candidate, after);
            if lowered < FINAL_CONVERGED {
                break;
            }
        }
        bundle
    }

    /// The factor of the information matrix of all states at the minimum, with the landmarks eliminated.
    pub(super) fn information(&self, bundle: &Bundle) -> Option<SparseFactor> {
        self.equations(bundle, f64::INFINITY, 0.0).system().factor()
    }

    /// One damped Gauss-Newton step; `None` where the equations are singular.
    fn step(&self, bundle: &Bundle, scale: f64, damping: f64) -> Option<Bundle> {
        let step = self.equations(bundle, scale, damping).solve(damping)?;
        let landmarks = bundle.landmarks.iter().zip(&step.landmarks);
        let landmarks = landmarks.map(|(landmark, error)| landmark.corrected(error)).collect();
        Some(Bundle { landmarks, ..bundle.moved(&step.states) })
    }

    /// The normal equations at a bundle.
    pub(super) fn equations(&self, bundle: &Bundle, scale: f64, damping: f64) -> NormalEquations {
        let layout = bundle.layout();
        let mut equations = NormalEquations::new(layout);
        for prior in self.priors {
            prior.add_to(&mut equations, layout, &bundle.poses);
        }
        self.measured.add_to(&mut equations, layout, &bundle.poses, scale);
        if let Some(inertial) = self.inertial {
            inertial.add_to(&mut equations, layout, &bundle.poses, &bundle.motions);
        }
        for relative in self.relative_poses {
            relative.add_to(&mut equations, layout, &bundle.poses);
        }
        for stored in self.stored {
            stored.add_to(&mut equations, layout, &bundle.poses);
        }
        for tie in self.ties {
            tie.add_to(&mut equations, layout, &bundle.poses, scale);
        }
        let poses = bundle.camera_poses();
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
        poses: &[CameraPose],
        scale: f64,
        damping: f64,
    ) -> LandmarkEquations {
        let mut equations =
            LandmarkEquations::new(landmarks.iter().flat_map(InverseDepthLandmark::views_with_prior));
        let mut blocks = LandmarkBlocks::default();
        for landmark in landmarks {
            blocks.clear();
            if let Some(prior) = &landmark.prior {
                prior.add_to(&mut equations, &mut blocks, landmark, &bundle.poses);
            }
            self.add_pixels(&mut equations, &mut blocks, landmark, poses, scale);
            for index in 0..3 {
                blocks.information[(index, index)] *= 1.0 + damping;
            }
            if landmark.prior.is_none() {
                // A weak prior on the inverse depth (sigma 1/m) for landmarks without parallax.
                blocks.information[(2, 2)] += 1.0;
            }
            equations.add_landmark(&blocks);
        }
        equations
    }

    fn add_pixels(
        &self,
        equations: &mut LandmarkEquations,
        blocks: &mut LandmarkBlocks,
        landmark: &InverseDepthLandmark,
        poses: &[CameraPose],
        scale: f64,
    ) {
        let anchor = landmark.anchor_view();
        let (mut anchor_information, mut anchor_gradient) = (Matrix6::zeros(), Vector6::zeros());
        let mut anchor_coupling = Matrix6x3::zeros();
        for (index, observation) in landmark.observations.iter().enumerate() {
            if index == landmark.anchor {
                if landmark.prior.is_some() {
                    continue;
                }
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
            blocks.information += predicted.by_landmark.transpose() * predicted.by_landmark * weight;
            blocks.gradient += predicted.by_landmark.transpose() * residual * weight;
            if view == anchor {
                // Both cameras of the anchor: the pixel does not depend on its pose.
                continue;
            }
            let by_anchor = predicted.by_anchor.transpose() * weight;
            let by_view = predicted.by_view.transpose() * weight;
            anchor_information += by_anchor * predicted.by_anchor;
            anchor_gradient += by_anchor * residual;
            anchor_coupling += by_anchor * predicted.by_landmark;
            equations.add_pose(view, &(by_view * predicted.by_view), &(by_view * residual));
            equations.add_pair(anchor, view, &(by_anchor * predicted.by_view));
            blocks.couplings.push((view, by_view * predicted.by_landmark));
        }
        equations.add_pose(anchor, &anchor_information, &anchor_gradient);
        blocks.couplings.push((anchor, anchor_coupling));
    }

    /// Information of a residual of this length (px^-2): `sigma^-2 / (1 + (e / scale sigma)^2)`.
    fn weight(&self, residual: f64, scale: f64) -> f64 {
        let sigmas = residual / self.sigma_px;
        (self.sigma_px * self.sigma_px * (1.0 + (sigmas / scale).powi(2))).recip()
    }

    /// The cost whose weights are [`Problem::weight`].
    pub(super) fn cost(&self, bundle: &Bundle, scale: f64) -> f64 {
        let priors: f64 = self.priors.iter().map(|prior| prior.cost(&bundle.poses)).sum();
        let measured = self.measured.cost(&bundle.poses, scale);
        let inertial = self.inertial.map_or(0.0, |inertial| inertial.cost(&bundle.poses, &bundle.motions));
        let relative: f64 =
            self.relative_poses.iter().map(|relative| 0.5 * relative.distance(&bundle.poses)).sum();
        let stored: f64 = self.stored.iter().map(|stored| stored.cost(&bundle.poses)).sum();
        let ties: f64 = self.ties.iter().map(|tie| tie.cost(&bundle.poses, scale)).sum();
        let known = bundle
            .landmarks
            .iter()
            .filter_map(|landmark| landmark.prior.as_ref().map(|prior| prior.cost(landmark, &bundle.poses)));
        let known: f64 = known.sum();
        let poses = bundle.camera_poses();
        let robust = |error: f64| {
            let sigmas = (error / self.sigma_px).min(1e6);
            0.5 * scale * scale * (sigmas / scale).powi(2).ln_1p()
        };
        let errors = bundle.landmarks.iter().flat_map(|landmark| landmark.errors(self.cameras, &poses));
        priors + measured + inertial + relative + stored + ties + known + errors.map(robust).sum::<f64>()
    }
}
