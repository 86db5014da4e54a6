//! Map building without reference poses: odometry, loops, and one visual-inertial bundle adjustment.
//!
//! G is the frame of the odometry, with z up, origin and yaw of its first pose; or that of poses or positions that are known
//! besides.

use std::time::Instant;

use adjustment::{
    Bundle, InverseDepthLandmark, MeasuredPose, MeasuredPoses, PosePrior, RelativePose, ViewMotion,
    gauge_information, remove_wrong,
};
use estimator::EstimatorConfig;
use estimator::imu::ImuBuffer;
use estimator::inertial_chain::InertialChain;
use estimator::propagation::ImuState;
use geometry::uncertain_pose::{PoseWithCovariance, isotropic_covariance};
use map::contents::MapContents;
use map::model::{GAUGE_SIGMA_P, GAUGE_SIGMA_YAW};
use map::sessions::Session;
use nalgebra::{Matrix6, Vector3};
use sensors::Sequence;

use super::aliasing::find_aliases;
use super::assemble;
use super::camera::Rig;
use super::correlations::Correlations;
use super::error::BuildError;
use super::feature_source::{Extraction, FeatureSource};
use super::joint_covariance::JointCovariance;
use super::keyframe_view::{FeatureId, KeyframeView, image_count, keyframes};
use super::loop_closure::{consistent, find_loops, log_refused};
use super::matching::{self, FeatureMatch, ImageId};
use super::odometry::{LOCAL_SIGMAS, Odometry, add_tracks};
use super::options::{BuildOptions, FIRST_SIGMA_PX};
use super::pieces::check_one_piece;
use super::pipeline::{check, match_all, triangulate_all};
use super::pose_priors::{AlignedPriors, PosePriors};
use super::progress::Progress;
use super::readings::{buffered, inertial_chain};
use super::refinement::{Constraints, ROUNDS, covariance_of, refine_all};
use super::report::{BuildReport, UntrackedImages};
use super::session::{enter, session_of};
use super::still_views::make_still;

/// What defines G: standard deviations of yaw (rad), of the tilt that only gravity gives (rad), and of the position (m) of
/// the first view.
const GAUGE_SIGMAS: [f64; 3] = [GAUGE_SIGMA_YAW, 0.5, GAUGE_SIGMA_P];
/// The same where known poses or positions define G: next to nothing.
const WIDE_SIGMAS: [f64; 3] = [10.0, 0.5, 1e4];
/// The build fails where more than this part of the known poses and positions contradict the recording.
const MAX_REFUSED: f64 = 0.5;
/// Uncertainty of a view after loops are closed, for the epipolar constraint (rad, m).
const ADJUSTED_SIGMAS: [f64; 2] = [0.005, 0.05];
/// Standard deviations of keyframes while loops are searched (rad, m): recognition wants some, none is used.
const SEARCH_SIGMAS: [f64; 2] = [1e-5, 1e-4];

/// Builds a map from a recording without reference poses.
///
/// # Arguments
/// * `sequence`: with readings of the IMU. Tracks in its frames tie the views together besides the features.
/// * `odometry`: states at its images.
/// * `priors`: poses and positions in G that are known besides; without, G is the frame of the odometry.
/// * `extraction`: how features are extracted from images; `None` takes those that the recording has.
/// * `progress`: called with the stage and its steps.
///
/// # Returns
/// The map, sorted and valid, and statistics of it. Without priors its covariance is relative to the map as a whole: to the frame in
/// which positions and yaw of its keyframes have no error in the mean.
///
/// # Errors
/// [`BuildError`], with what to do.
pub fn build_map_from_odometry(
    sequence: &Sequence,
    odometry: &Odometry,
    priors: &PosePriors,
    extraction: Option<Extraction<'_>>,
    options: &BuildOptions,
    progress: Progress<'_>,
) -> Result<(MapContents, BuildReport), BuildError> {
    let start = Instant::now();
    let aligned = priors.aligned(odometry, &sequence.imu_samples)?;
    let odometry = aligned.as_ref().map_or(odometry, |aligned| &aligned.odometry);
    let mut builder = Builder::new(sequence, odometry, extraction, options, progress)?;
    if builder.report.keyframes < 2 {
        return Err(no_motion(odometry));
    }
    if let Some(aligned) = &aligned {
        builder.use_priors(priors, aligned);
    }
    let (bundle, constraints) = builder.build()?;
    let session = builder.session();
    let Builder { rig, options, views, mut report, progress, .. } = builder;
    let keyframes = keyframes(&views);
    let stated = (&keyframes[..], image_count(&views));
    let joint = covariance_of(&rig.cameras, &constraints, &bundle, stated, &[], report.sigma_px, progress)?;
    let in_time: Vec<(usize, i64)> = keyframes.iter().map(|&view| (view, views[view].stamp_ns)).collect();
    check_one_piece(&joint, &in_time, sequence.frames.first().map_or(0, |frame| frame.stamp_ns))?;
    let mut contents =
        assemble::map_contents(&rig, &views, &bundle, Some(&joint), report.sigma_px, &options)?;
    contents.info.own_frame = constraints.own_frame.is_some();
    enter(&mut contents.info, session, report.sigma_px, &contents.keyframes);
    contents.count_sessions();
    find_aliases(&mut contents, progress)?;
    assemble::fill_report(&mut report, &rig.cameras, &views, &bundle, &contents);
    report.seconds = start.elapsed().as_secs_f64();
    Ok((contents, report))
}

fn no_motion(odometry: &Odometry) -> BuildError {
    let mut moved_m: f64 = 0.0;
    let mut seconds = 0.0;
    if let Some((first_ns, first)) = odometry.states.first() {
        for (stamp_ns, state) in &odometry.states {
            let from_first = state.local_from_imu.translation - first.local_from_imu.translation;
            moved_m = moved_m.max(from_first.norm());
            seconds = (stamp_ns - first_ns) as f64 * 1e-9;
        }
    }
    BuildError::NoMotion { moved_m, seconds }
}

/// What the stages share.
pub(super) struct Builder<'a, 'p> {
    sequence: &'a Sequence,
    readings: ImuBuffer,
    odometry: &'a Odometry,
    /// Settings of the odometry, with the noise of the IMU as it turns out.
    config: EstimatorConfig,
    /// The cameras.
    pub(super) rig: Rig,
    /// Settings, with the gravity of G.
    pub(super) options: BuildOptions,
    /// The keyframes, and what ties them together.
    pub(super) views: Vec<KeyframeView<'a>>,
    /// Poses and positions that are known besides the recording.
    known: Vec<MeasuredPose>,
    /// Tracks of points without descriptors.
    tracks: Vec<Vec<FeatureId>>,
    /// Statistics so far.
    pub(super) report: BuildReport,
    /// Called with the stage and its steps.
    pub(super) progress: Progress<'p>,
}

impl<'a, 'p> Builder<'a, 'p> {
    /// Selects the views of a recording.
    ///
    /// # Errors
    /// [`BuildError`] for impossible options and a recording without keyframes.
    pub(super) fn new(
        sequence: &'a Sequence,
        odometry: &'a Odometry,
        extraction: Option<Extraction<'_>>,
        options: &BuildOptions,
        progress: Progress<'p>,
    ) -> Result<Builder<'a, 'p>, BuildError> {
        check(options)?;
        let mut options = options.clone();
        options.gravity_in_global = Some(-Vector3::z());
        let rig = Rig::new(&sequence.cameras, odometry.cameras);
        let mut source = FeatureSource::new(extraction, &rig);
        let mut views = odometry.select_views(sequence, &mut source, &options, progress)?;
        let mut report = BuildReport::of_views(&views, source.unreadable);
        report.untracked_images = UntrackedImages::of(&sequence.frames);
        let tracks = add_tracks(&mut views, &sequence.frames, &rig);
        report.imu_noise_scale = odometry.imu_noise_scale;
        let readings = buffered(&sequence.imu_samples);
        make_still(&mut views, &sequence.cameras, &rig, &readings, |stamp_ns| {
            odometry.at(stamp_ns).map(|state| state.gyroscope_bias)
        });
        let mut config = odometry.config.clone();
        config.imu_noise = config.imu_noise.inflated(odometry.imu_noise_scale);
        Ok(Builder {
            sequence,
            readings,
            odometry,
            config,
            rig,
            options,
            views,
            known: Vec::new(),
            tracks,
            report,
            progress,
        })
    }

    /// Uses poses and positions that are known besides.
    fn use_priors(&mut self, priors: &PosePriors, aligned: &AlignedPriors) {
        self.known = aligned.factors(&self.views, &self.sequence.cameras[0].imu_from_camera);
        self.report.pose_priors = priors.len();
        self.report.pose_priors_outside = priors.len() - self.known.len();
    }

    /// Adjusts the trajectory by neighbours, then closes loops, then adjusts all with the landmarks of all places fused.
    ///
    /// # Errors
    /// [`BuildError`].
    pub(super) fn build(&mut self) -> Result<(Bundle, Constraints), BuildError> {
        let motions: Vec<ViewMotion> = self
            .views
            .iter()
            .filter_map(|view| self.odometry.at(view.stamp_ns))
            .map(ImuState::motion)
            .collect();
        let in_time = matching::pairs_in_time(&self.rig, &self.views, &self.options);
        let matches = self.matches(&in_time)?;
        let landmarks = self.landmarks(&matches);
        let poses = self.views.iter().map(|view| view.prior.pose).collect();
        let mut bundle = Bundle { poses, motions, landmarks };
        bundle = self.adjust(&self.constraints(&bundle), bundle, 1);
        self.refuse_wrong_priors(&bundle)?;
        bundle = self.close_loops(bundle)?;
        self.set_priors(&bundle, ADJUSTED_SIGMAS);
        let in_space: Vec<(ImageId, ImageId)> = matching::pairs(&self.rig, &self.views, &self.options)
            .into_iter()
            .filter(|pair| in_time.binary_search(pair).is_err())
            .collect();
        let mut all = matches;
        all.extend(self.matches(&in_space)?);
        let landmarks = self.landmarks(&all);
        self.learn_imu_noise(&bundle);
        self.report.dropped_observations = 0;
        bundle.landmarks = landmarks;
        let mut constraints = self.constraints(&bundle);
        bundle = self.adjust(&constraints, bundle, ROUNDS);
        if self.refuse_wrong_priors(&bundle)? {
            constraints = self.constraints(&bundle);
            bundle = self.adjust(&constraints, bundle, 1);
        }
        Ok((bundle, constraints))
    }

    /// Leaves out the known poses and positions that the trajectory contradicts.
    ///
    /// # Returns
    /// Whether there are such.
    ///
    /// # Errors
    /// [`BuildError::PosePriorsContradict`] where they are most of them.
    fn refuse_wrong_priors(&mut self, bundle: &Bundle) -> Result<bool, BuildError> {
        let wrong = remove_wrong(&mut self.known, &bundle.poses);
        self.report.refused_pose_priors += wrong;
        let (refused, used) = (self.report.refused_pose_priors, self.known.len());
        if refused as f64 > MAX_REFUSED * (refused + used) as f64 {
            return Err(BuildError::PosePriorsContradict { refused, used: refused + used });
        }
        Ok(wrong > 0)
    }

    /// Finds places that are seen again and adjusts the trajectory to them. Loops that contradict the trajectory by more
    /// than its covariance allows are refused at once, those that contradict the others after an adjustment.
    fn close_loops(&mut self, mut bundle: Bundle) -> Result<Bundle, BuildError> {
        let found = self.find_loops(&bundle)?;
        self.report.loops = found.len();
        let mut constraints = self.constraints(&bundle);
        let mut loops =
            constraints.plausible_loops(&self.rig.cameras, &bundle, found.clone(), self.report.sigma_px)?;
        while !loops.is_empty() {
            constraints.relative_poses.clone_from(&loops);
            bundle = self.adjust(&constraints, bundle, 1);
            let count = loops.len();
            loops = consistent(&loops, &bundle.poses);
            if loops.len() == count {
                break;
            }
            constraints = self.constraints(&bundle);
        }
        self.report.refused_loops = self.report.loops - loops.len();
        log_refused(&found, &loops, &bundle.poses);
        Ok(bundle)
    }

    /// Increases the stated noise of the IMU where its readings do not fit the images as it says.
    fn learn_imu_noise(&mut self, bundle: &Bundle) {
        let scale = self.inertial(&bundle.motions).noise_scale(bundle).max(1.0);
        self.report.imu_noise_scale *= scale;
        self.config.imu_noise = self.config.imu_noise.inflated(scale);
    }

    fn matches(&mut self, pairs: &[(ImageId, ImageId)]) -> Result<Vec<FeatureMatch>, BuildError> {
        let independent = &Correlations::Independent;
        let report = &mut self.report;
        match_all(&self.rig, &self.views, pairs, independent, &self.options, report, self.progress)
    }

    fn landmarks(&mut self, matches: &[FeatureMatch]) -> Vec<InverseDepthLandmark> {
        let (matches, tracks) = (matches.to_vec(), self.tracks.clone());
        triangulate_all(
            &self.rig,
            (&self.views, &Correlations::Independent),
            matches,
            tracks,
            &self.options,
            &mut self.report,
            self.progress,
        )
    }

    /// What defines G, the first pose or known ones, and the readings of the IMU, around a bundle.
    fn constraints(&self, bundle: &Bundle) -> Constraints {
        let gauge = if self.known.is_empty() { GAUGE_SIGMAS } else { WIDE_SIGMAS };
        let [sigma_yaw, sigma_tilt, sigma_p] = gauge;
        Constraints {
            priors: vec![PosePrior {
                view: 0,
                pose: self.views[0].prior.pose,
                information: gauge_information(sigma_yaw, sigma_tilt, sigma_p),
            }],
            measured: MeasuredPoses::new(&self.known, &bundle.poses),
            inertial: Some(self.inertial(&bundle.motions)),
            own_frame: self.known.is_empty().then(|| -Vector3::z()),
            ..Constraints::default()
        }
    }

    /// What is used of the recording, without its keyframes.
    pub(super) fn session(&self) -> Session {
        session_of(self.sequence, &self.options)
    }

    /// The readings of the IMU between the views.
    pub(super) fn inertial(&self, motions: &[ViewMotion]) -> InertialChain {
        let stamps_ns: Vec<i64> = self.views.iter().map(|view| view.stamp_ns).collect();
        let imu_from_camera = self.sequence.cameras[0].imu_from_camera;
        inertial_chain(&self.readings, &stamps_ns, motions, imu_from_camera, &self.config)
    }

    /// Refines a bundle, see [`refine_all`].
    pub(super) fn adjust(&mut self, constraints: &Constraints, bundle: Bundle, rounds: usize) -> Bundle {
        refine_all(
            &self.rig.cameras,
            constraints,
            bundle,
            rounds,
            &self.options,
            &mut self.report,
            self.progress,
        )
    }

    fn find_loops(&mut self, bundle: &Bundle) -> Result<Vec<RelativePose>, BuildError> {
        self.set_priors(bundle, LOCAL_SIGMAS);
        let keyframes = self.views.iter().enumerate().filter(|(_, view)| view.is_keyframe());
        let [sigma_theta, sigma_p] = SEARCH_SIGMAS;
        let covariance: Matrix6<f64> = isotropic_covariance(sigma_theta, sigma_p);
        let own = keyframes.map(|(view, _)| (view, covariance)).collect();
        let joint = JointCovariance::of_independent(own);
        let sigma_px = self.options.sigma_px.unwrap_or(FIRST_SIGMA_PX);
        let contents =
            assemble::map_contents(&self.rig, &self.views, bundle, Some(&joint), sigma_px, &self.options)?;
        let gap = self.options.time_neighbours + 1;
        find_loops(contents, &self.rig, &self.views, &bundle.poses, gap, self.progress)
    }

    /// Takes the poses of the views from a bundle.
    fn set_priors(&mut self, bundle: &Bundle, [sigma_theta, sigma_p]: [f64; 2]) {
        for (view, pose) in self.views.iter_mut().zip(&bundle.poses) {
            view.prior = PoseWithCovariance::new(*pose, isotropic_covariance(sigma_theta, sigma_p));
        }
    }
}
