//! The stages of map building.

use std::collections::HashSet;
use std::time::Instant;

use adjustment::{Bundle, InverseDepthLandmark, ViewPose, parallel};
use map::contents::MapContents;
use sensors::{ReferencePose, Sequence};

use super::accelerometer_check::check_accelerations;
use super::aliasing::find_aliases;
use super::assemble;
use super::camera::Rig;
use super::correlations::Correlations;
use super::error::BuildError;
use super::feature_source::{Extraction, FeatureSource};
use super::gyroscope_check::check_turns;
use super::keyframe_selection::select_keyframes;
use super::keyframe_view::{FeatureId, KeyframeView, image_count, keyframes};
use super::matching::{self, FeatureMatch, ImageId};
use super::options::{BuildOptions, FIRST_SIGMA_PX, StoredPoses};
use super::progress::{Progress, Stage};
use super::readings::buffered;
use super::reference_gravity::gravity_of;
use super::refinement::{Constraints, ROUNDS, covariance_of, refine_all};
use super::report::BuildReport;
use super::session::{enter, session_of};
use super::still_views::make_still;
use super::tracks;
use super::triangulation::{Scene, triangulate};

/// Tracks that one thread triangulates before it takes others.
const TRIANGULATION_RUN: usize = 256;

/// Builds a map.
///
/// # Arguments
/// * `sequence`: its cameras, and the features or images of its frames are used.
/// * `references`: poses of the IMU in G with sigmas; those of images between two of them are interpolated.
/// * `extraction`: how features are extracted from images; `None` takes those that the recording has.
/// * `progress`: called with the stage and its steps.
///
/// # Returns
/// The map, sorted and valid, and statistics of it.
///
/// # Errors
/// [`BuildError`], with what to do.
pub fn build_map(
    sequence: &Sequence,
    references: &[ReferencePose],
    extraction: Option<Extraction<'_>>,
    options: &BuildOptions,
    progress: Progress<'_>,
) -> Result<(MapContents, BuildReport), BuildError> {
    check(options)?;
    check_turns(&sequence.imu_samples, references, options.sigma_theta_rad)?;
    check_accelerations(&sequence.imu_samples, references)?;
    let mut options = options.clone();
    options.gravity_in_global =
        options.gravity_in_global.or_else(|| gravity_of(&sequence.imu_samples, references));
    let options = &options;
    let start = Instant::now();
    let used = extraction.as_ref().map_or(sequence.cameras.len(), |extraction| extraction.cameras);
    let rig = Rig::new(&sequence.cameras, used);
    let cameras = &rig.cameras;
    let mut source = FeatureSource::new(extraction, &rig);
    let mut views = select_keyframes(sequence, references, &mut source, options, progress)?;
    make_still(&mut views, &sequence.cameras, &rig, &buffered(&sequence.imu_samples), |_| None);
    let mut report = BuildReport::of_views(&views, source.unreadable);
    let pairs = matching::pairs(&rig, &views, options);
    let independent = &Correlations::Independent;
    let matches = match_all(&rig, &views, &pairs, independent, options, &mut report, progress)?;
    let landmarks =
        triangulate_all(&rig, (&views, independent), matches, Vec::new(), options, &mut report, progress);
    let constraints = Constraints::of_references(&views);
    let poses = views.iter().map(|view| view.prior.pose).collect();
    let mut bundle = Bundle { poses, motions: Vec::new(), landmarks };
    report.sigma_px = options.sigma_px.unwrap_or(FIRST_SIGMA_PX);
    if options.refine_poses {
        bundle = refine_all(cameras, &constraints, bundle, ROUNDS, options, &mut report, progress);
    }
    let joint = (options.refine_poses && options.stored_poses == StoredPoses::Refined)
        .then(|| {
            let stated = (&keyframes(&views)[..], image_count(&views));
            covariance_of(cameras, &constraints, &bundle, stated, &[], report.sigma_px, progress)
        })
        .transpose()?;
    let mut contents =
        assemble::map_contents(&rig, &views, &bundle, joint.as_ref(), report.sigma_px, options)?;
    enter(&mut contents.info, session_of(sequence, options), report.sigma_px, &contents.keyframes);
    contents.count_sessions();
    find_aliases(&mut contents, progress)?;
    assemble::fill_report(&mut report, cameras, &views, &bundle, &contents);
    report.seconds = start.elapsed().as_secs_f64();
    Ok((contents, report))
}

pub(super) fn check(options: &BuildOptions) -> Result<(), BuildError> {
    for sigma in [options.sigma_theta_rad, options.sigma_p_m].into_iter().flatten() {
        if !(sigma.is_finite() && sigma >= 0.0) {
            return Err(BuildError::PoseSigma { sigma });
        }
    }
    if let Some(sigma_px) = options.sigma_px.filter(|sigma| !(sigma.is_finite() && *sigma > 0.0)) {
        return Err(BuildError::PixelSigma { sigma_px });
    }
    if options.min_observations < 2 {
        return Err(BuildError::MinObservations { min_observations: options.min_observations });
    }
    Ok(())
}

/// Matches pairs of images.
pub(super) fn match_all(
    rig: &Rig,
    views: &[KeyframeView<'_>],
    pairs: &[(ImageId, ImageId)],
    correlations: &Correlations<'_>,
    options: &BuildOptions,
    report: &mut BuildReport,
    progress: Progress<'_>,
) -> Result<Vec<FeatureMatch>, BuildError> {
    let sigma_px = options.sigma_px.unwrap_or(FIRST_SIGMA_PX);
    report.pairs += pairs.len();
    let mut matches = Vec::new();
    let of_pair =
        |pair: usize| matching::match_pair(rig, views, pairs[pair], correlations, sigma_px, options);
    let show = |done| progress(Stage::Matching, done, pairs.len());
    for of_pair in parallel::map(pairs.len(), of_pair, show) {
        matches.extend(of_pair?);
    }
    report.matches += matches.len();
    Ok(matches)
}

/// Joins matches into tracks and triangulates each. Features that are dropped from a track may be of another landmark, so
/// their matches are joined and triangulated once more.
///
/// # Arguments
/// * `tracked`: further tracks, of points without descriptors.
pub(super) fn triangulate_all(
    rig: &Rig,
    (views, correlations): (&[KeyframeView<'_>], &Correlations<'_>),
    matches: Vec<FeatureMatch>,
    tracked: Vec<Vec<FeatureId>>,
    options: &BuildOptions,
    report: &mut BuildReport,
    progress: Progress<'_>,
) -> Vec<InverseDepthLandmark> {
    let of_view = |view: &KeyframeView<'_>| view.images.iter().map(|image| image.features.len()).collect();
    let counts: Vec<Vec<usize>> = views.iter().map(of_view).collect();
    let poses: Vec<ViewPose> = views.iter().map(|view| ViewPose::from(&view.prior.pose)).collect();
    let sigma_px = options.sigma_px.unwrap_or(FIRST_SIGMA_PX);
    let scene = Scene { rig, views, poses: &poses, correlations, sigma_px };
    let mut tracks = tracks::chain(&counts, matches.clone());
    tracks.extend(tracks::stereo_singles(views, &tracks));
    tracks.extend(tracked);
    let mut landmarks = Vec::new();
    let mut dropped: HashSet<FeatureId> = HashSet::new();
    let runs: Vec<&[Vec<FeatureId>]> = tracks.chunks(TRIANGULATION_RUN).collect();
    let of_run = |run: usize| -> Vec<_> {
        runs[run].iter().map(|track| triangulate(&scene, track, options.min_observations)).collect()
    };
    let show = |done: usize| {
        progress(Stage::Triangulation, (done * TRIANGULATION_RUN).min(tracks.len()), tracks.len());
    };
    for (landmark, outliers) in parallel::map(runs.len(), of_run, show).into_iter().flatten() {
        landmarks.extend(landmark);
        dropped.extend(outliers);
    }
    let among_dropped =
        |found: &FeatureMatch| dropped.contains(&found.first) && dropped.contains(&found.second);
    let leftovers = matches.into_iter().filter(among_dropped).collect();
    for track in tracks::chain(&counts, leftovers) {
        let (landmark, _) = triangulate(&scene, &track, options.min_observations);
        landmarks.extend(landmark);
    }
    progress(Stage::Triangulation, tracks.len(), tracks.len());
    let kept: usize = landmarks.iter().map(InverseDepthLandmark::image_count).sum();
    report.dropped_observations = tracks.iter().map(Vec::len).sum::<usize>().saturating_sub(kept);
    landmarks
}
