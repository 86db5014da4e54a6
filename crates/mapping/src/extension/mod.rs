//! Extending a map by another recording of the same place.
//!
//! 1. The recording is adjusted by itself, in its own frame with z up.
//! 2. Its keyframes are searched in the map; the places that agree with each other give yaw and position.
//! 3. The map enters as the joint prior of the poses of the keyframes that the places tie to the recording (`stored_poses`), the
//!    recording with all its states; relative poses of the places tie them together.
//! 4. These relative poses are replaced by what they came from: landmarks of the map, each given the map's poses, with the
//!    pixels of the recording. Both are adjusted together, and the joint covariance of all keyframes is computed.
//!
//! With [`MapPoses::Considered`] the poses of the map and their covariances and cross-covariances stay as they are, to the bit, whatever the
//! number of keyframes; what is new is located in them, and its errors are stated in the form of the map (`parts`).
//!
//! Keyframes and landmarks of the map keep their ids. Landmarks that the recording does not see move with their anchors.

mod agreement;
mod assemble;
mod error;
mod fusion;
mod report;

use std::collections::BTreeSet;
use std::time::Instant;

use adjustment::{Bundle, MeasuredPoses, RelativePose, StateCovariance};
use geometry::pose::Pose;
use map::contents::MapContents;
use nalgebra::Vector3;
use sensors::Sequence;

use crate::aliasing::find_aliases;
use crate::error::BuildError;
use crate::feature_source::Extraction;
use crate::joint_covariance::JointCovariance;
use crate::keyframe_view::{image_count, keyframes};
use crate::loop_closure::{consistent, is_kept};
use crate::odometry::Odometry;
use crate::options::{BuildOptions, MapPoses};
use crate::places::{
    Alignment, FoundPlaces, MIN_AGREEING, PlaceQuery, SearchedMap, StoredPlace, align, find_places,
    told_apart_count, view_count,
};
use crate::progress::Progress;
use crate::refinement::{Constraints, ROUNDS, located_covariance, state_covariance, stated_covariance};
use crate::session::check_new_recording;
use crate::stored_landmarks::StoredLandmarks;
use crate::stored_poses::StoredPoses;
use crate::tied_keyframes::{MOST_TIED, choose_places};
use crate::without_references::Builder;
use agreement::OwnPoses;
pub use error::ExtendError;
pub use report::ExtensionReport;

/// Largest angle between the map's direction of gravity and -z (rad).
const MAX_TILT: f64 = 1e-3;

/// Extends a map by another recording of the same place.
///
/// # Arguments
/// * `stored`: whole and valid, in a frame with z up.
/// * `sequence`: with readings of the IMU, and features or images as the map's.
/// * `odometry`: states at its images, in a frame of its own.
/// * `extraction`: how features are extracted from images; `None` takes those that the recording has.
///
/// # Returns
/// The map of both, sorted and valid, with the joint covariance of all keyframes: approximated where there are many (`joint_covariance`), but
/// never what a map states whose poses are [considered](MapPoses::Considered).
///
/// # Errors
/// [`ExtendError`], with what to do.
pub fn extend_map(
    stored: &MapContents,
    sequence: &Sequence,
    odometry: &Odometry,
    extraction: Option<Extraction<'_>>,
    options: &BuildOptions,
    progress: Progress<'_>,
) -> Result<(MapContents, ExtensionReport), ExtendError> {
    extend(stored, None, (sequence, odometry, extraction), options, progress)
}

/// Extends a part of a map, as [`extend_map`] does: places count as told apart where they are in the whole map.
///
/// # Arguments
/// * `part`: as [`part_of`](map::edit::part_of) gives it.
/// * `whole`: the map that it is a part of. It is let go once places are found.
///
/// # Errors
/// As of [`extend_map`].
pub fn extend_part(
    part: &MapContents,
    whole: SearchedMap,
    sequence: &Sequence,
    odometry: &Odometry,
    options: &BuildOptions,
    progress: Progress<'_>,
) -> Result<(MapContents, ExtensionReport), ExtendError> {
    extend(part, Some(whole), (sequence, odometry, None), options, progress)
}

fn extend(
    stored: &MapContents,
    whole: Option<SearchedMap>,
    (sequence, odometry, extraction): (&Sequence, &Odometry, Option<Extraction<'_>>),
    options: &BuildOptions,
    progress: Progress<'_>,
) -> Result<(MapContents, ExtensionReport), ExtendError> {
    let start = Instant::now();
    check_vertical(stored)?;
    check_new_recording(&stored.info, sequence, options)?;
    let mut builder = Builder::new(sequence, odometry, extraction, options, progress)?;
    check_new(stored, &builder)?;
    let (session, of_recording) = builder.build()?;
    let sigma_px = builder.report.sigma_px;
    let own_covariance = state_covariance(&builder.rig.cameras, &of_recording, &session, sigma_px)?;
    let own_poses = OwnPoses::new(&keyframes(&builder.views), &session.poses, &own_covariance);
    builder.options.sigma_px = Some(sigma_px);
    let FoundPlaces { places: found, repeating } =
        places_of(stored, whole.as_ref(), &mut builder, &session.poses)?;
    drop(whole);
    let mut report = ExtensionReport {
        new_keyframes: builder.report.keyframes,
        unreadable_images: builder.report.unreadable_images.clone(),
        loops: builder.report.loops - builder.report.refused_loops,
        imu_noise_scale: builder.report.imu_noise_scale,
        sigma_px,
        stored_keyframes: stored.keyframes.len(),
        places: view_count(&found),
        places_told_apart: told_apart_count(&found),
        repeating,
        ..ExtensionReport::default()
    };
    let mut both = session;
    both.poses.extend(stored.keyframes.iter().map(|keyframe| keyframe.global_from_keyframe.pose));
    let not_connected = |agreeing: usize| ExtendError::NotConnected {
        keyframes: report.new_keyframes,
        found: report.places,
        told_apart: report.places_told_apart,
        agreeing,
        wanted: MIN_AGREEING,
    };
    let alignment = align(&found, &both.poses).ok_or_else(|| not_connected(0))?;
    if view_count(&alignment.agreeing) < MIN_AGREEING {
        return Err(not_connected(view_count(&alignment.agreeing)));
    }
    move_recording(&mut both, builder.views.len(), &alignment);
    let (places, tied) = tied_keyframes(stored, builder.views.len(), alignment.agreeing);
    report.tied_keyframes = tied.len();
    let mut stored_poses =
        StoredPoses::of_map(stored, builder.views.len(), tied).ok_or(ExtendError::Indefinite)?;
    if options.map_poses == MapPoses::Considered {
        stored_poses = stored_poses.considered();
    }
    let (mut both, places) = tie(&mut builder, &stored_poses, both, places)?;
    report.agreeing_places = view_count(&places);
    report.agreeing_told_apart = told_apart_count(&places);
    if report.agreeing_places < MIN_AGREEING {
        return Err(not_connected(report.agreeing_places));
    }
    both.landmarks = fusion::fuse(stored, &builder.rig, &builder.views, &places, both.landmarks);
    let constraints = constraints(&builder, &both, &stored_poses, Vec::new());
    let mut both = builder.adjust(&constraints, both, ROUNDS);
    stored_poses.follow(&mut both.poses);
    let covariance = state_covariance(&builder.rig.cameras, &constraints, &both, sigma_px)?;
    [report.map_chi_square, report.map_freedom] =
        own_poses.moved(&both.poses, &covariance).ok_or(ExtendError::Incomparable)?;
    let joint = joint_covariance(&mut builder, &covariance, &constraints, &both, &stored_poses);
    if options.map_poses == MapPoses::Considered {
        stored_poses.reset(&mut both.poses);
    }
    let mut contents = assemble::extended(stored, &builder, &both, &joint, sigma_px)?;
    find_aliases(&mut contents, builder.progress)?;
    report.cameras = assemble::cameras_of_new(stored, &builder);
    assemble::fill_report(&mut report, stored, &contents, &both);
    report.seconds = start.elapsed().as_secs_f64();
    Ok((contents, report))
}

fn check_vertical(stored: &MapContents) -> Result<(), ExtendError> {
    if stored.keyframes.is_empty() {
        return Err(ExtendError::Empty);
    }
    let gravity = stored.info.gravity_in_global;
    if gravity.is_some_and(|gravity| gravity.angle(&-Vector3::z()) <= MAX_TILT) {
        return Ok(());
    }
    Err(ExtendError::Vertical { gravity: gravity.map(Into::into) })
}

/// Checks that no keyframe of the map is an image of the recording, for what the ledger does not say.
fn check_new(stored: &MapContents, builder: &Builder<'_, '_>) -> Result<(), ExtendError> {
    let stamps: BTreeSet<i64> = builder.views.iter().map(|view| view.stamp_ns).collect();
    match stored.keyframes.iter().find(|keyframe| stamps.contains(&keyframe.stamp_ns)) {
        Some(known) => Err(ExtendError::AlreadyInMap { keyframe: known.id, stamp_ns: known.stamp_ns }),
        None => Ok(()),
    }
}

/// Searches the keyframes of a recording in the map.
fn places_of(
    stored: &MapContents,
    whole: Option<&SearchedMap>,
    builder: &mut Builder<'_, '_>,
    poses: &[Pose],
) -> Result<FoundPlaces, BuildError> {
    let mut queries: Vec<PlaceQuery<'_>> = Vec::new();
    for (view, content) in builder.views.iter().enumerate() {
        queries.extend(content.images.iter().enumerate().map(|(image, of)| PlaceQuery {
            view,
            camera: builder.rig.camera(of.group),
            view_from_camera: builder.rig.mounted(of.group),
            first_feature: content.first_feature(image),
            features: &of.features,
        }));
    }
    find_places(stored, whole, &queries, poses, builder.progress)
}

/// Moves the first views from the frame of the recording to G.
fn move_recording(both: &mut Bundle, views: usize, alignment: &Alignment) {
    let transform = &alignment.global_from_recording;
    for pose in &mut both.poses[..views] {
        *pose = transform.compose(pose);
    }
    for motion in &mut both.motions {
        motion.velocity = transform.rotation * motion.velocity;
    }
}

/// The places that are used, and the keyframes of the map that they tie to the recording: those that they show, and all others
/// that observe what these share with the recording.
fn tied_keyframes(
    stored: &MapContents,
    first: usize,
    places: Vec<StoredPlace>,
) -> (Vec<StoredPlace>, Vec<usize>) {
    let landmarks = StoredLandmarks::of_map(stored);
    let of_place = |place: &StoredPlace| {
        let mut keyframes = landmarks.observers(place.matches.iter().map(|(_, id)| *id));
        keyframes.insert(place.relative.views[0] - first);
        keyframes
    };
    let (places, tied) = choose_places(places, MOST_TIED, of_place);
    (places, tied.into_iter().collect())
}

fn constraints(
    builder: &Builder<'_, '_>,
    both: &Bundle,
    stored: &StoredPoses,
    relative_poses: Vec<RelativePose>,
) -> Constraints {
    Constraints {
        priors: stored.held().collect(),
        measured: MeasuredPoses::default(),
        inertial: Some(builder.inertial(&both.motions)),
        relative_poses,
        stored: vec![stored.prior()],
        ties: Vec::new(),
        own_frame: None,
        scale_floor: None,
    }
}

/// The covariances of the views that become keyframes, and of those of the map.
fn joint_covariance(
    builder: &mut Builder<'_, '_>,
    covariance: &StateCovariance,
    constraints: &Constraints,
    both: &Bundle,
    stored: &StoredPoses,
) -> JointCovariance {
    let mut views = keyframes(&builder.views);
    let new = views.len();
    views.extend(builder.views.len()..both.poses.len());
    match builder.options.map_poses {
        MapPoses::Considered => {
            located_covariance(covariance, constraints, both, (&views, new), stored, builder.progress)
        }
        MapPoses::Adjusted => {
            let all = image_count(&builder.views) + views.len() - new;
            let stored = std::slice::from_ref(stored);
            stated_covariance(covariance, constraints, both, (&views, all), stored, builder.progress)
        }
    }
}

/// Adjusts the recording to the map by the places that neither their covariances nor the others contradict.
///
/// # Arguments
/// * `places`: the first one is taken for true at first.
fn tie(
    builder: &mut Builder<'_, '_>,
    stored: &StoredPoses,
    mut both: Bundle,
    places: Vec<StoredPlace>,
) -> Result<(Bundle, Vec<StoredPlace>), BuildError> {
    let mut relative: Vec<RelativePose> = places.iter().map(|place| place.relative.clone()).collect();
    let first = constraints(builder, &both, stored, relative[..1].to_vec());
    relative = first.plausible_loops(&builder.rig.cameras, &both, relative, builder.report.sigma_px)?;
    while !relative.is_empty() {
        let tied = constraints(builder, &both, stored, relative.clone());
        both = builder.adjust(&tied, both, 1);
        let count = relative.len();
        relative = consistent(&relative, &both.poses);
        if relative.len() == count {
            break;
        }
    }
    let places = places.into_iter().filter(|place| is_kept(&place.relative, &relative)).collect();
    Ok((both, places))
}
