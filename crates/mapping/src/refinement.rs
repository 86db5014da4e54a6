//! Bundle adjustment in rounds, with outliers dropped in between, and the covariance of the result.

use adjustment::{
    Bundle, Factor, InverseDepthLandmark, JointPrior, LandmarkTie, Loss, MAPPED_INVERSE_DEPTHS,
    MeasuredPoses, MountedCamera, PixelModel, PosePrior, Problem, RelativePose, StateCovariance, ViewPose,
    information_times,
};
use estimator::inertial_chain::InertialChain;
use nalgebra::{DVector, Vector3, Vector6};

use super::error::BuildError;
use super::joint_covariance::{
    FrameAndScale, JointCovariance, SCALE_SIGMA, ScaleFloor, covariance_of_new, joint_covariance,
};
use super::keyframe_view::KeyframeView;
use super::loop_closure::plausible;
use super::options::{BuildOptions, FIRST_SIGMA_PX};
use super::progress::{Progress, Stage};
use super::report::BuildReport;
use super::stored_poses::{Posterior, StoredPoses};

/// Scale of Cauchy's robust loss in the first iteration (standard deviations of a pixel): reference poses off by
/// 0.1 m and 0.9 deg cause residuals of 10 px.
const FIRST_SCALE: f64 = 16.0;
/// Scale in the end: rejects what pixel noise cannot explain.
const LAST_SCALE: f64 = 3.0;
/// Information of a weak prior on the inverse depth (m^2), sigma 1/m, for landmarks without parallax.
const DEPTH_INFORMATION: f64 = 1.0;
/// An observation is dropped when its reprojection error after refinement exceeds this (standard deviations of a pixel).
pub(super) const REPROJECTION_GATE: f64 = 4.0;
/// Rounds of bundle adjustment of a finished map; outliers are dropped after each.
pub(super) const ROUNDS: usize = 3;
/// Limits of the estimated pixel noise (px). The images of a map agree better with each other than with a robot's: with
/// the 0.36 px of V1_01, a filter run in that map rejects four of ten correct matches; more than 5 px is no feature.
const SIGMA_PX_LIMITS: [f64; 2] = [1.0, MAX_SIGMA_PX];
/// The largest pixel noise that is estimated (px): it stands for any noise that is as large or larger.
pub const MAX_SIGMA_PX: f64 = 5.0;

/// Number of landmarks from which pixel noise can be estimated: its median is then within 20 %.
const MIN_LANDMARKS: usize = 50;

/// What is known of the states besides the pixels.
#[derive(Default)]
pub(super) struct Constraints {
    /// Priors of poses.
    pub(super) priors: Vec<PosePrior>,
    /// Measured poses and positions, some of which may be wrong.
    pub(super) measured: MeasuredPoses,
    /// Readings of the IMU between views.
    pub(super) inertial: Option<InertialChain>,
    /// Relative poses of places seen again.
    pub(super) relative_poses: Vec<RelativePose>,
    /// Poses of the keyframes of maps that are extended or merged.
    pub(super) stored: Vec<JointPrior>,
    /// Landmarks that two maps share.
    pub(super) ties: Vec<LandmarkTie>,
    /// Direction of gravity, unit vector, where nothing else defines the frame: it is that of the map as a whole.
    pub(super) own_frame: Option<Vector3<f64>>,
    /// How well the scale may be known at most, where the maps that are merged may share its error.
    pub(super) scale_floor: Option<ScaleFloor>,
}

impl Constraints {
    /// Reference poses as priors.
    pub(super) fn of_references(views: &[KeyframeView<'_>]) -> Constraints {
        let prior =
            |(view, content): (usize, &KeyframeView<'_>)| PosePrior::of_reference(view, &content.prior);
        Constraints { priors: views.iter().enumerate().map(prior).collect(), ..Constraints::default() }
    }

    /// The loops that the trajectory of a bundle, with its uncertainty, does not contradict.
    ///
    /// # Errors
    /// [`BuildError::Indefinite`].
    pub(super) fn plausible_loops(
        &self,
        cameras: &[MountedCamera],
        bundle: &Bundle,
        loops: Vec<RelativePose>,
        sigma_px: f64,
    ) -> Result<Vec<RelativePose>, BuildError> {
        let covariance = self.problem(cameras, sigma_px).covariance(bundle).ok_or(BuildError::Indefinite)?;
        Ok(plausible(loops, &bundle.poses, &covariance))
    }

    /// What is stated of the frame and of the scale of some views.
    ///
    /// What gives the scale otherwise than by known poses is a recording, by its baseline or its accelerometer. Where there is no recording,
    /// the poses, or the maps, are what gives the scale, with the errors that they state.
    ///
    /// # Arguments
    /// * `posterior`: of the views.
    fn frame_and_scale(
        &self,
        covariance: &StateCovariance,
        bundle: &Bundle,
        posterior: &Posterior<'_>,
    ) -> FrameAndScale {
        match (self.own_frame, self.scale_floor, &self.inertial) {
            (Some(gravity), ..) => FrameAndScale::OfTheWhole(gravity),
            (None, Some(floor), _) => FrameAndScale::WithScaleFloor(floor),
            (None, None, Some(_)) => {
                FrameAndScale::WithScaleError(self.scale_errors(covariance, bundle, posterior))
            }
            (None, None, None) => FrameAndScale::AsAdjusted,
        }
    }

    /// How far the views of a posterior are off where all lengths that the recording measures are off by [`SCALE_SIGMA`].
    ///
    /// Such a recording fits `s`, the trajectory that is larger by a share, as well as it would fit the true one. With the information `H`
    /// of everything and `K` of what is known of the poses besides the recording, the adjustment is off by
    /// ```text
    /// H^-1 (H - K) s = s - P K s
    /// ```
    /// It does not matter about which point `s` is larger: neither images nor IMU see position and yaw.
    pub(super) fn scale_errors(
        &self,
        covariance: &StateCovariance,
        bundle: &Bundle,
        posterior: &Posterior<'_>,
    ) -> Vec<Vector6<f64>> {
        let known: [&dyn Factor; 3] = [&self.priors, &self.measured, &self.stored];
        let layout = bundle.layout();
        // Near the recording, whose views come first: what cancels is small then.
        let recorded = if layout.motions > 0 { layout.motions } else { bundle.poses.len() };
        let positions = bundle.poses[..recorded].iter().map(|pose| pose.translation);
        let centre = positions.sum::<Vector3<f64>>() / recorded.max(1) as f64;
        let mut larger: DVector<f64> = DVector::zeros(layout.dim());
        for (view, pose) in bundle.poses.iter().enumerate() {
            let off = (pose.translation - centre) * SCALE_SIGMA;
            larger.fixed_rows_mut::<3>(layout.pose(view).start + 3).copy_from(&off);
        }
        let held = covariance.times(&information_times(&known, bundle, &larger));
        posterior.moved(&(larger - held), layout)
    }

    /// The least-squares problem for a pixel noise (px).
    fn problem<'a>(&'a self, cameras: &'a [MountedCamera], sigma_px: f64) -> Problem<'a> {
        let factors: Vec<&dyn Factor> = vec![
            &self.priors,
            &self.measured,
            &self.inertial,
            &self.relative_poses,
            &self.stored,
            &self.ties,
        ];
        Problem { cameras, factors, pixels: pixel_model(sigma_px) }
    }
}

/// Pixels of a map, with a noise (px).
pub(super) fn pixel_model(sigma_px: f64) -> PixelModel {
    PixelModel {
        sigma_px,
        loss: Loss::Cauchy,
        depth_information: DEPTH_INFORMATION,
        inverse_depths: MAPPED_INVERSE_DEPTHS,
        landmark_steps: 0,
    }
}

/// Refines poses and landmarks, drops outliers, and estimates the pixel noise, which goes into the report.
///
/// # Arguments
/// * `rounds`: [`ROUNDS`], or fewer for a bundle that is adjusted again.
pub(super) fn refine_all(
    cameras: &[MountedCamera],
    constraints: &Constraints,
    start: Bundle,
    rounds: usize,
    options: &BuildOptions,
    report: &mut BuildReport,
    progress: Progress<'_>,
) -> Bundle {
    let mut bundle = start;
    let mut sigma_px = options.sigma_px.unwrap_or(FIRST_SIGMA_PX);
    for round in 0..rounds {
        let scales = [if round == 0 { FIRST_SCALE } else { LAST_SCALE }, LAST_SCALE];
        bundle = constraints.problem(cameras, sigma_px).minimize(bundle, scales, |done, steps| {
            progress(Stage::BundleAdjustment, round * steps + done, rounds * steps);
        });
        if options.sigma_px.is_none() {
            sigma_px = estimated_sigma_px(&bundle, cameras).unwrap_or(sigma_px);
        }
        let before: usize = bundle.landmarks.iter().map(InverseDepthLandmark::image_count).sum();
        let poses = bundle.view_poses();
        let gate = REPROJECTION_GATE * sigma_px;
        let pruned = |landmark: &InverseDepthLandmark| {
            prune(landmark, cameras, &poses, gate, options.min_observations)
        };
        bundle.landmarks = bundle.landmarks.iter().filter_map(pruned).collect();
        let after: usize = bundle.landmarks.iter().map(InverseDepthLandmark::image_count).sum();
        report.dropped_observations += before - after;
    }
    report.sigma_px = sigma_px;
    bundle
}

/// The joint covariance of the poses of some views.
///
/// # Arguments
/// * `views`: with all tied keyframes of stored maps, in order.
/// * `keyframes`: how many keyframes the views are.
/// * `stored`: the maps whose keyframes took part in the adjustment.
///
/// # Errors
/// [`BuildError::Indefinite`].
pub(super) fn covariance_of(
    cameras: &[MountedCamera],
    constraints: &Constraints,
    bundle: &Bundle,
    (views, keyframes): (&[usize], usize),
    stored: &[StoredPoses],
    sigma_px: f64,
    progress: Progress<'_>,
) -> Result<JointCovariance, BuildError> {
    let covariance = state_covariance(cameras, constraints, bundle, sigma_px)?;
    Ok(stated_covariance(&covariance, constraints, bundle, (views, keyframes), stored, progress))
}

/// The covariance of all states of a bundle at the minimum.
///
/// # Errors
/// [`BuildError::Indefinite`].
pub(super) fn state_covariance(
    cameras: &[MountedCamera],
    constraints: &Constraints,
    bundle: &Bundle,
    sigma_px: f64,
) -> Result<StateCovariance, BuildError> {
    constraints.problem(cameras, sigma_px).covariance(bundle).ok_or(BuildError::Indefinite)
}

/// What a map states of the covariance of all states: see [`covariance_of`].
pub(super) fn stated_covariance(
    covariance: &StateCovariance,
    constraints: &Constraints,
    bundle: &Bundle,
    (views, keyframes): (&[usize], usize),
    stored: &[StoredPoses],
    progress: Progress<'_>,
) -> JointCovariance {
    let positions: Vec<_> = views.iter().map(|&view| bundle.poses[view].translation).collect();
    let posterior = Posterior::new(covariance, &bundle.poses, views, stored);
    let show = |done, all| progress(Stage::Covariance, done, all);
    let frame_and_scale = constraints.frame_and_scale(covariance, bundle, &posterior);
    joint_covariance(&posterior, (views, keyframes), &positions, frame_and_scale, show)
}

/// Covariances and cross-covariances of the views of a recording that was located in a map, whose keyframes state theirs as they did.
///
/// # Arguments
/// * `covariance`: of all states at the minimum.
/// * `views`: those of the recording's keyframes, then those of the map's keyframes; `new` of them are of the recording.
pub(super) fn located_covariance(
    covariance: &StateCovariance,
    constraints: &Constraints,
    bundle: &Bundle,
    (views, new): (&[usize], usize),
    stored: &StoredPoses,
    progress: Progress<'_>,
) -> JointCovariance {
    let posterior = Posterior::new(covariance, &bundle.poses, views, std::slice::from_ref(stored));
    let show = |done, all| progress(Stage::Covariance, done, all);
    let errors = constraints.scale_errors(covariance, bundle, &posterior);
    let mut joint = covariance_of_new(&posterior, (views, new), &errors, show);
    joint.own.extend(stored.stated());
    joint
}

/// The pixel noise from the residuals of a refined bundle (px); `None` without landmarks.
fn estimated_sigma_px(bundle: &Bundle, cameras: &[MountedCamera]) -> Option<f64> {
    let poses = bundle.view_poses();
    let of = |least_images: usize| {
        let observed = bundle.landmarks.iter().filter(move |landmark| landmark.image_count() >= least_images);
        observed.map(|landmark| landmark.errors(cameras, &poses))
    };
    // A stereo pair at one instant agrees better than views from different places, as a robot's will be.
    if of(2).count() >= MIN_LANDMARKS { median_sigma_px(of(2)) } else { median_sigma_px(of(1)) }
}

/// The pixel noise (px) by the median landmark, which is robust to outliers. The squared residuals of a landmark with `n`
/// observations, over the noise's variance, are chi-square distributed with `2n - 3` degrees of freedom, whose median
/// Wilson and Hilferty approximate.
///
/// # Arguments
/// * `landmarks`: reprojection errors of each landmark, at least two (px).
///
/// # Returns
/// The noise within [`SIGMA_PX_LIMITS`]; `None` without landmarks.
pub(super) fn median_sigma_px(landmarks: impl Iterator<Item = Vec<f64>>) -> Option<f64> {
    let variance = |errors: Vec<f64>| {
        let freedom = (2 * errors.len() - 3) as f64;
        let median = freedom * (1.0 - 2.0 / (9.0 * freedom)).powi(3);
        errors.iter().map(|error| error * error).sum::<f64>() / median
    };
    let mut variances: Vec<f64> = landmarks.map(variance).filter(|value| value.is_finite()).collect();
    Some(geometry::median(&mut variances)?.sqrt().clamp(SIGMA_PX_LIMITS[0], SIGMA_PX_LIMITS[1]))
}

/// Drops observations beyond `gate` (px), and changes the anchor where it is one of them.
fn prune(
    landmark: &InverseDepthLandmark,
    cameras: &[MountedCamera],
    poses: &[ViewPose],
    gate: f64,
    least: usize,
) -> Option<InverseDepthLandmark> {
    let errors = landmark.errors(cameras, poses);
    let keep: Vec<bool> = errors.iter().map(|&error| error <= gate).collect();
    if keep[landmark.anchor] {
        return landmark.retained(&keep, least);
    }
    let middle = keep.len() / 2;
    let can_anchor = |&index: &usize| keep[index] && !landmark.observations[index].is_second;
    let anchor = (0..keep.len()).filter(can_anchor).min_by_key(|index| index.abs_diff(middle))?;
    landmark.anchored_at(anchor, cameras, poses)?.retained(&keep, least)
}
