//! Whether the images of a body move, whose IMU cannot tell uniform motion from rest.

use crate::camera_vote::most_are_still;
use crate::initialization::dynamic::WindowImage;
use crate::initialization::static_init::REST_SECONDS;
use geometry::median;
use nalgebra::Vector2;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use types::TrackObservation;

/// Minimum time between the images that confirm the rest, nanoseconds.
const MOTION_CHECK_SPAN_NS: i64 = 200_000_000;
/// Minimum number of tracks of a camera that these images share.
const MOTION_CHECK_MIN_TRACKS: usize = 12;
/// Maximum median displacement of pixels at rest, in units of their noise. Noise alone gives 1.66.
const MOTION_CHECK_MAX_DISPLACEMENT: f64 = 2.5;

/// The features of an image: pixel and camera; those that several cameras see are those of the first of them.
type Seen = BTreeMap<u64, (u8, Vector2<f64>)>;

/// Whether the tracks of most cameras move although the IMU is at rest. False where all cameras have too few.
///
/// # Arguments
/// * `images`: oldest first.
/// * `rest_ns`: when the IMU was found to be at rest, nanoseconds.
/// * `tracks`: of the newest image.
/// * `sigma_px`: noise of a pixel, px.
pub(super) fn tracks_stand(
    images: &VecDeque<WindowImage>,
    rest_ns: i64,
    tracks: &[TrackObservation],
    sigma_px: f64,
) -> Option<bool> {
    let newest_ns = images.back()?.stamp_ns;
    let begin_ns = rest_ns - (REST_SECONDS * 1e9) as i64;
    let is_earlier = |image: &&WindowImage| {
        image.stamp_ns >= begin_ns && newest_ns - image.stamp_ns >= MOTION_CHECK_SPAN_NS
    };
    let earlier: Vec<Seen> = images.iter().filter(is_earlier).map(|image| seen(&image.tracks)).collect();
    let now = seen(tracks);
    let cameras: BTreeSet<u8> = now.values().map(|(camera, _)| *camera).collect();
    let is_still = |camera: u8| {
        let mut displacements = earlier.iter().map(|image| displacements(image, &now, camera));
        let mut lengths = displacements.find(|lengths| lengths.len() >= MOTION_CHECK_MIN_TRACKS)?;
        Some(median(&mut lengths)? <= MOTION_CHECK_MAX_DISPLACEMENT * sigma_px)
    };
    most_are_still(cameras.into_iter().map(is_still))
}

fn seen(tracks: &[TrackObservation]) -> Seen {
    let mut seen = Seen::new();
    for track in tracks {
        let first = seen.entry(track.feature_id).or_insert((track.camera, track.pixel));
        if track.camera < first.0 {
            *first = (track.camera, track.pixel);
        }
    }
    seen
}

/// How far the pixels of a camera moved, px.
fn displacements(then: &Seen, now: &Seen, camera: u8) -> Vec<f64> {
    let moved = |(feature, (seen_by, pixel)): (&u64, &(u8, Vector2<f64>))| {
        let (seen_by_now, now) = now.get(feature)?;
        (*seen_by == camera && *seen_by_now == camera).then(|| (now - pixel).norm())
    };
    then.iter().filter_map(moved).collect()
}
