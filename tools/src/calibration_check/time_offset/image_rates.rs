//! Rotation rates that the images show by themselves.

use estimator::TrackObservation;
use geometry::rotation::log;
use geometry::{Camera, Rotation};
use nalgebra::Vector3;
use odometry::FrontEnd;
use sensors::Sequence;
use std::collections::HashMap;
use vision::tracking::{BearingPair, OutlierOptions, TrackerError, TrackerOptions, find_outliers};

/// Points that a rotation is taken from at least.
const MIN_POINTS: usize = 15;
/// Images further apart show no rate at a time.
const MAX_INTERVAL_NS: i64 = 300_000_000;

/// Mean rotation rate between two images.
#[derive(Clone, Copy, Debug)]
pub(super) struct ImageRate {
    /// Times of the images by the clock of the cameras, nanoseconds.
    pub(super) from_ns: i64,
    pub(super) to_ns: i64,
    /// Of the body, in the IMU frame, rad/s.
    pub(super) rate: Vector3<f64>,
}

/// Rates between successive images of camera 0, from tracks that no gyroscope predicted, or from the recorded tracks.
///
/// # Arguments
/// * `progress`: called with the number of frames done.
///
/// # Errors
/// The tracker refuses the camera.
pub(super) fn image_rates(
    sequence: &Sequence,
    mut progress: impl FnMut(usize),
) -> Result<Vec<ImageRate>, TrackerError> {
    let Some(sensor) = sequence.cameras.first() else { return Ok(Vec::new()) };
    let mut front_end = if sequence.contents().tracks {
        None
    } else {
        Some(FrontEnd::new(std::slice::from_ref(sensor), &TrackerOptions::default())?)
    };
    let mut rates = Vec::new();
    let mut previous: Option<(i64, HashMap<u64, Vector3<f64>>)> = None;
    for (index, frame) in sequence.frames.iter().enumerate() {
        progress(index);
        let current = match &mut front_end {
            // Odometry names the images that cannot be used.
            Some(front_end) => {
                front_end.track_frame(frame, &[]).map(|tracks| bearings(&sensor.camera, &tracks))
            }
            None => Ok(bearings(&sensor.camera, &frame.tracks)),
        };
        let Some(current) = current.ok().filter(|current| !current.is_empty()) else { continue };
        if let Some((from_ns, before)) = &previous {
            let (from_ns, to_ns) = (*from_ns, frame.stamp_ns);
            let turned = rotation_between(before, &current).filter(|_| to_ns - from_ns <= MAX_INTERVAL_NS);
            rates.extend(turned.map(|current_from_previous| {
                let seconds = (to_ns - from_ns) as f64 * 1e-9;
                let rate = -(sensor.imu_from_camera.rotation * log(&current_from_previous)) / seconds;
                ImageRate { from_ns, to_ns, rate }
            }));
        }
        previous = Some((frame.stamp_ns, current.into_iter().collect()));
    }
    Ok(rates)
}

/// Points of camera 0 with their bearings.
fn bearings(camera: &Camera, tracks: &[TrackObservation]) -> Vec<(u64, Vector3<f64>)> {
    let of_first = tracks.iter().filter(|track| track.camera == 0);
    let bearing = |track: &TrackObservation| {
        let ray = camera.unproject(&track.pixel).ok()?;
        Some((track.feature_id, ray.push(1.0).normalize()))
    };
    of_first.filter_map(bearing).collect()
}

/// Rotation of the camera, `current_from_previous`; `None` where too few points agree on one.
fn rotation_between(
    before: &HashMap<u64, Vector3<f64>>,
    current: &[(u64, Vector3<f64>)],
) -> Option<Rotation> {
    let pair = |(id, bearing): &(u64, Vector3<f64>)| {
        Some(BearingPair { previous: *before.get(id)?, current: *bearing })
    };
    let pairs: Vec<BearingPair> = current.iter().filter_map(pair).collect();
    if pairs.len() < MIN_POINTS {
        return None;
    }
    let consensus = find_outliers(&pairs, None, &OutlierOptions::default())?;
    let inliers = consensus.inliers.iter().filter(|is_inlier| **is_inlier).count();
    (2 * inliers >= pairs.len()).then_some(consensus.pose.current_from_previous)
}
