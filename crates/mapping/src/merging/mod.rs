//! Merging two maps of places that overlap.
//!
//! 1. The keyframes of the second map are searched in the first one, by what their landmarks look like; the places that
//!    agree with each other give yaw and position.
//! 2. Both maps enter as the joint priors of the poses of the keyframes that the places tie together (`stored_poses`), the second
//!    one's without its yaw and position; relative poses of the places tie them.
//! 3. These relative poses are replaced by the landmarks that both maps have, each given the poses of its map. Together
//!    this is what the maps were made of, so that no measurement is counted twice.
//!
//! The result is in the frame of the first map, whose ids stay.

mod assemble;
mod error;
mod landmarks;
mod same_images;

use std::collections::BTreeSet;
use std::time::Instant;

use adjustment::{Bundle, LandmarkTie, RelativePose};
use geometry::pose::Pose;
use geometry::rotation::exp;
use map::FeatureKind;
use map::contents::MapContents;
use nalgebra::Vector3;
use serde::Serialize;

use crate::aliasing::find_aliases;
use crate::assemble::sigma_scale;
use crate::error::BuildError;
use crate::joint_covariance::{SCALE_SIGMA, ScaleFloor};
use crate::loop_closure::{consistent, is_kept};
use crate::map_frame::map_in_frame;
use crate::options::BuildOptions;
use crate::places::{MIN_AGREEING, PlaceQuery, StoredPlace, align, find_places, view_count};
use crate::progress::Progress;
use crate::refinement::{Constraints, covariance_of, refine_all};
use crate::report::BuildReport;
use crate::stored_landmarks::StoredLandmarks;
use crate::stored_poses::StoredPoses;
use crate::tied_keyframes::{MOST_TIED, choose_places};
pub use error::MergeError;
use landmarks::KeyframeFeatures;
use same_images::check_images;

/// Largest angle between a map's direction of gravity and -z (rad).
const MAX_TILT: f64 = 1e-3;
/// How often the second map is aligned by the landmarks that both have: the first time its yaw is known to a degree or so.
const ALIGNMENTS: usize = 2;
/// Maps are refused where more than this part of the landmarks that look alike contradict each other.
const MAX_CONTRADICTING: f64 = 0.5;
/// Least variance of a position by which positions are averaged (m^2): that of one that is known exactly.
const LEAST_VARIANCE: f64 = 1e-10;

/// Statistics of a run of [`merge_maps`].
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct MergeReport {
    /// Keyframes of the two maps.
    pub keyframes: [usize; 2],
    /// Landmarks of the two maps.
    pub landmarks: [usize; 2],
    /// Keyframes of the second map that show a place of the first one.
    pub places: usize,
    /// Those of them that agree with each other.
    pub agreeing_places: usize,
    /// Keyframes of the two maps that these places tie to the other map; all others follow by their correlations with these.
    pub tied_keyframes: [usize; 2],
    /// Landmarks that both maps have.
    pub common_landmarks: usize,
    /// Landmarks that look alike and lie elsewhere.
    pub refused_landmarks: usize,
    /// The second map's frame in the first one's: yaw (deg), x, y, z (m).
    pub first_from_second: [f64; 4],
    /// Rotation of the first map's keyframes, root mean square per axis (deg).
    pub moved_deg: f64,
    /// The same for their positions (m).
    pub moved_m: f64,
    /// Standard deviation of the first map's positions before, root mean square per axis (m).
    pub sigma_before_m: f64,
    /// ... and after.
    pub sigma_after_m: f64,
    /// Time taken (s).
    pub seconds: f64,
}

/// Merges two maps of places that overlap.
///
/// # Arguments
/// * `first`, `second`: whole and valid, in frames with z up, made of different recordings.
/// * `progress`: called with the stage and its steps.
///
/// # Returns
/// The map of both in the first one's frame, sorted and valid, with the joint covariance of all keyframes.
///
/// # Errors
/// [`MergeError`], with what to do.
pub fn merge_maps(
    first: &MapContents,
    second: &MapContents,
    progress: Progress<'_>,
) -> Result<(MapContents, MergeReport), MergeError> {
    let start = Instant::now();
    check(first, second)?;
    let mut report = MergeReport {
        keyframes: [first, second].map(|map| map.keyframes.len()),
        landmarks: [first, second].map(|map| map.landmarks.len()),
        ..MergeReport::default()
    };
    let features = KeyframeFeatures::of_map(second);
    let mut poses: Vec<Pose> = poses_of(second).collect();
    let queries: Vec<PlaceQuery<'_>> = features.iter().map(KeyframeFeatures::query).collect();
    let found = find_places(first, None, &queries, &poses, progress)?.places;
    report.places = view_count(&found);
    poses.extend(poses_of(first));
    let alignment = align(&found, &poses).ok_or_else(|| not_connected(&report))?;
    report.agreeing_places = view_count(&alignment.agreeing);
    if report.agreeing_places < MIN_AGREEING {
        return Err(not_connected(&report));
    }
    let mut to_first = alignment.global_from_recording;
    let mut aligned = map_in_frame(second, &to_first);
    copy_poses(&aligned, &mut poses);
    let (places, tied) = tied_keyframes(first, second, &features, alignment.agreeing);
    report.tied_keyframes = [tied[1].len(), tied[0].len()];
    let mut adjuster = Adjuster::new(first, &aligned, tied, progress)?;
    let bundle = Bundle { poses, motions: Vec::new(), landmarks: Vec::new() };
    let (mut bundle, places) = adjuster.tie_places(bundle, places)?;
    report.agreeing_places = view_count(&places);
    if report.agreeing_places < MIN_AGREEING {
        return Err(not_connected(&report));
    }
    let mut constraints = Constraints::default();
    for _ in 0..ALIGNMENTS {
        to_first = aligned_better(&aligned, &bundle.poses).compose(&to_first);
        aligned = map_in_frame(second, &to_first);
        copy_poses(&aligned, &mut bundle.poses);
        adjuster.stored = Adjuster::stored_poses(first, &aligned, &adjuster.tied)?;
        let ties = landmarks::ties(first, &aligned, &features, &places, &bundle.poses);
        let alike = ties.len();
        (bundle, constraints) = adjuster.tie_landmarks(bundle, ties);
        report.common_landmarks = constraints.ties.len();
        report.refused_landmarks = alike - constraints.ties.len();
        if report.refused_landmarks as f64 > MAX_CONTRADICTING * alike as f64 {
            return Err(MergeError::Contradiction { alike, refused: report.refused_landmarks });
        }
    }
    let all: Vec<usize> = (0..bundle.poses.len()).collect();
    let sigma_px = adjuster.sigma_px();
    constraints.scale_floor = Some(scale_floor(first, second));
    let joint = covariance_of(
        &[],
        &constraints,
        &bundle,
        (&all, all.len()),
        &adjuster.stored,
        sigma_px,
        adjuster.progress,
    )?;
    let mut contents = assemble::merged(first, &aligned, &bundle.poses, &constraints.ties, &joint)?;
    find_aliases(&mut contents, adjuster.progress)?;
    assemble::fill_report(&mut report, first, &contents, &to_first);
    report.seconds = start.elapsed().as_secs_f64();
    Ok((contents, report))
}

/// Checks what can be seen without adjusting anything.
fn check(first: &MapContents, second: &MapContents) -> Result<(), MergeError> {
    if first.keyframes.is_empty() || second.keyframes.is_empty() {
        return Err(MergeError::Empty);
    }
    for (map, which) in [(first, "first"), (second, "second")] {
        let gravity = map.info.gravity_in_global;
        if gravity.is_none_or(|gravity| gravity.angle(&-Vector3::z()) > MAX_TILT) {
            return Err(MergeError::Vertical { which, gravity: gravity.map(Into::into) });
        }
    }
    let kinds = |contents: &MapContents| contents.feature_kinds().collect::<Vec<_>>();
    let (of_first, of_second) = (kinds(first), kinds(second));
    for (at, kind) in of_second.iter().enumerate() {
        let is_same = |known: &&FeatureKind| at == 0 || known.extractor == kind.extractor;
        let known = of_first.iter().find(is_same);
        if let Some(known) =
            known.filter(|known| (known.format(), &known.extractor) != (kind.format(), &kind.extractor))
        {
            let name = |of: &FeatureKind| {
                format!("{} ({}, {} bytes)", of.extractor, of.descriptor_kind.label(), of.descriptor_width)
            };
            return Err(MergeError::Extractors { first: name(known), second: name(kind) });
        }
    }
    for session in &second.info.sessions {
        first.info.check_new_session(session)?;
    }
    check_images(first, second)
}

/// How well the scale of both together may be known: as well as by the better one of them. They are often made with one rig, whose baseline
/// is off in both, and then they are wrong by the same.
fn scale_floor(first: &MapContents, second: &MapContents) -> ScaleFloor {
    let sigma = [first, second].into_iter().filter_map(sigma_scale).fold(SCALE_SIGMA, f64::min);
    let (mut sum, mut weights) = (Vector3::zeros(), 0.0);
    for keyframe in &first.keyframes {
        let pose = &keyframe.global_from_keyframe;
        let weight = pose.sigma_p_m().powi(2).max(LEAST_VARIANCE).recip();
        sum += pose.pose.translation * weight;
        weights += weight;
    }
    ScaleFloor { sigma, centre: sum / weights }
}

fn not_connected(report: &MergeReport) -> MergeError {
    MergeError::NotConnected {
        keyframes: report.keyframes[1],
        found: report.places,
        agreeing: report.agreeing_places,
        wanted: MIN_AGREEING,
    }
}

fn poses_of(map: &MapContents) -> impl Iterator<Item = Pose> {
    map.keyframes.iter().map(|keyframe| keyframe.global_from_keyframe.pose)
}

/// The places that are used, and the positions in the second and in the first map of the keyframes that they tie together: those that
/// they show, and all others that observe the landmarks that look alike there.
fn tied_keyframes(
    first: &MapContents,
    second: &MapContents,
    features: &[KeyframeFeatures<'_>],
    places: Vec<StoredPlace>,
) -> (Vec<StoredPlace>, [Vec<usize>; 2]) {
    let count = second.keyframes.len();
    let [of_first, of_second] = [first, second].map(StoredLandmarks::of_map);
    let views_of = |place: &StoredPlace| {
        let shown = features[place.relative.views[1]].landmarks();
        let in_first = of_first.observers(place.matches.iter().map(|(_, id)| *id));
        let in_second = of_second.observers(place.matches.iter().map(|(feature, _)| shown[*feature]));
        let mut views: BTreeSet<usize> = in_first.into_iter().map(|keyframe| count + keyframe).collect();
        views.extend(in_second);
        views.extend(place.relative.views);
        views
    };
    let (places, tied) = choose_places(places, MOST_TIED, views_of);
    let (of_second, of_first): (Vec<usize>, Vec<usize>) = tied.into_iter().partition(|view| *view < count);
    (places, [of_second, of_first.into_iter().map(|view| view - count).collect()])
}

/// Sets the first poses to those of a map.
fn copy_poses(map: &MapContents, poses: &mut [Pose]) {
    for (pose, of_map) in poses.iter_mut().zip(poses_of(map)) {
        *pose = of_map;
    }
}

/// The rotation about z and the translation by which the keyframes of a map were adjusted on average.
fn aligned_better(map: &MapContents, poses: &[Pose]) -> Pose {
    let count = map.keyframes.len() as f64;
    let pairs = || poses_of(map).zip(poses);
    let turn = pairs().map(|(before, after)| before.local(after).z).sum::<f64>() / count;
    let rotation = exp(&Vector3::new(0.0, 0.0, turn));
    let apart = pairs().map(|(before, after)| after.translation - rotation * before.translation);
    Pose::new(rotation, apart.sum::<Vector3<f64>>() / count)
}

/// Adjusts the poses of both maps: those of the second one come first.
struct Adjuster<'p> {
    /// The poses of the second map, and of the first one.
    stored: [StoredPoses; 2],
    /// Positions in both of the keyframes that are tied.
    tied: [Vec<usize>; 2],
    options: BuildOptions,
    report: BuildReport,
    progress: Progress<'p>,
}

impl<'p> Adjuster<'p> {
    fn new(
        first: &MapContents,
        second: &MapContents,
        tied: [Vec<usize>; 2],
        progress: Progress<'p>,
    ) -> Result<Adjuster<'p>, MergeError> {
        let sigma_px = Some(first.info.sigma_px.max(second.info.sigma_px));
        let options = BuildOptions { sigma_px, ..BuildOptions::default() };
        let stored = Self::stored_poses(first, second, &tied)?;
        Ok(Adjuster { stored, tied, options, report: BuildReport::default(), progress })
    }

    /// The maps as they are in the first one's frame. That of the second one is linear in its yaw, so that it must be aligned well.
    fn stored_poses(
        first: &MapContents,
        second: &MapContents,
        tied: &[Vec<usize>; 2],
    ) -> Result<[StoredPoses; 2], MergeError> {
        let relative = StoredPoses::of_map(second, 0, tied[0].clone()).and_then(StoredPoses::without_frame);
        let own = StoredPoses::of_map(first, second.keyframes.len(), tied[1].clone());
        relative.zip(own).map(<[StoredPoses; 2]>::from).ok_or(MergeError::Indefinite)
    }

    fn sigma_px(&self) -> f64 {
        self.options.sigma_px.unwrap_or(1.0)
    }

    fn constraints(&self, relative_poses: Vec<RelativePose>, ties: Vec<LandmarkTie>) -> Constraints {
        let priors = self.stored.iter().flat_map(StoredPoses::held).collect();
        let stored = self.stored.iter().map(StoredPoses::prior).collect();
        Constraints { priors, relative_poses, stored, ties, ..Constraints::default() }
    }

    fn adjust(&mut self, constraints: &Constraints, bundle: Bundle) -> Bundle {
        let mut bundle =
            refine_all(&[], constraints, bundle, 1, &self.options, &mut self.report, self.progress);
        for stored in &self.stored {
            stored.follow(&mut bundle.poses);
        }
        bundle
    }

    /// Adjusts both maps by the places that neither their covariances nor the others contradict.
    ///
    /// # Arguments
    /// * `places`: the first one is taken for true at first.
    fn tie_places(
        &mut self,
        mut bundle: Bundle,
        places: Vec<StoredPlace>,
    ) -> Result<(Bundle, Vec<StoredPlace>), BuildError> {
        let mut relative: Vec<RelativePose> = places.iter().map(|place| place.relative.clone()).collect();
        let first = self.constraints(relative[..1].to_vec(), Vec::new());
        relative = first.plausible_loops(&[], &bundle, relative, self.sigma_px())?;
        while !relative.is_empty() {
            bundle = self.adjust(&self.constraints(relative.clone(), Vec::new()), bundle);
            let count = relative.len();
            relative = consistent(&relative, &bundle.poses);
            if relative.len() == count {
                break;
            }
        }
        let places = places.into_iter().filter(|place| is_kept(&place.relative, &relative)).collect();
        Ok((bundle, places))
    }

    /// Adjusts both maps by the landmarks that they share, and leaves out those that are two.
    fn tie_landmarks(&mut self, mut bundle: Bundle, ties: Vec<LandmarkTie>) -> (Bundle, Constraints) {
        let mut constraints = self.constraints(Vec::new(), ties);
        while !constraints.ties.is_empty() {
            bundle = self.adjust(&constraints, bundle);
            let count = constraints.ties.len();
            constraints.ties.retain(|tie| tie.is_consistent(&bundle.poses));
            if constraints.ties.len() == count {
                break;
            }
        }
        (bundle, constraints)
    }
}
