//! Standing still: recognized by tracks that do not move, and told to the filter as zero velocity.
//!
//! A body that stands gives a single camera no parallax, so its tracks cannot be triangulated and its
//! velocity drifts with the accelerometer's bias. What the tracks do say is that nothing moved: pixels
//! seen half a second and more ago, turned by the rotation between both images, are still where they were.
//!
//! * Turning is not mistaken for standing, nor the other way round: the rotation is taken out first. A filter that
//!   does not know its gyroscope's bias yet (0.02 rad/s move a pixel by 5 px in half a second) believes that it turns;
//!   pixels that do not move at all say that it stands, whatever it believes.
//! * Gliding is not either, as long as something is near enough to move by more than its noise in the time
//!   that a track lives; and the filter's own velocity must agree by a chi-square test.

use crate::calibration::CalibratedCamera;
use crate::measurement::LinearizedMeasurement;
use crate::odometry::tracks::TrackStore;
use crate::propagation::VELOCITY;
use crate::state::ActiveState;
use geometry::Pose;
use nalgebra::{Vector2, Vector3};
use smallvec::SmallVec;

/// Tracks must reach back this far, nanoseconds.
const LEAST_SPAN_NS: i64 = 450_000_000;
/// Fewest tracks to judge by.
const LEAST_TRACKS: usize = 12;
/// Largest median displacement in units of the pixel noise. Noise alone gives 1.66: both pixels of a pair
/// have it, and the median of a squared length in two dimensions is 1.39 variances.
const LARGEST_DISPLACEMENT: f64 = 2.0;
/// What a body that seems to stand may still do, m/s: a displacement that hides in the noise, of a point
/// five metres away, in half a second.
const SIGMA_VELOCITY: f64 = 0.02;

/// One length a track, px. Those of 400 tracks need no memory from the heap.
type Lengths = SmallVec<[f64; 400]>;

/// Whether the newest image shows that the body has not moved for at least half a second.
///
/// # Arguments
/// * `sigma_px`: noise of tracked pixels, px.
pub fn stands_still(state: &ActiveState, tracks: &TrackStore, sigma_px: f64) -> bool {
    let Some(newest) = state.clones.last() else { return false };
    let Some(eye) = state.calibration.rig.first() else { return false };
    let now = newest.local_from_imu * eye.imu_from_camera;
    let (mut displacements, mut as_they_are) = (Lengths::new(), Lengths::new());
    for (old, pixel_then, pixel_now) in tracks.pairs_with(newest.id) {
        let Some(place) = state.place_of(old) else { continue };
        let clone = &state.clones[place];
        if newest.stamp_ns - clone.stamp_ns < LEAST_SPAN_NS {
            continue;
        }
        let then = clone.local_from_imu * eye.imu_from_camera;
        // A point that turns out of view did not stand still.
        displacements.push(displacement(eye, &then, &now, &pixel_then, &pixel_now).unwrap_or(f64::INFINITY));
        as_they_are.push((pixel_then - pixel_now).norm());
    }
    if displacements.len() < LEAST_TRACKS {
        return false;
    }
    [displacements, as_they_are].into_iter().any(|mut lengths| {
        let middle = lengths.len() / 2;
        let (_, median, _) = lengths.select_nth_unstable_by(middle, f64::total_cmp);
        *median < LARGEST_DISPLACEMENT * sigma_px
    })
}

/// How far a pixel is from where the rotation alone would have brought it, px.
fn displacement(
    eye: &CalibratedCamera,
    then: &Pose,
    now: &Pose,
    pixel_then: &Vector2<f64>,
    pixel_now: &Vector2<f64>,
) -> Option<f64> {
    let seen = eye.camera.unproject(pixel_then).ok()?;
    let ray = now.rotation.inverse() * (then.rotation * Vector3::new(seen.x, seen.y, 1.0));
    Some((eye.camera.project(&ray).ok()? - pixel_now).norm())
}

/// `v = 0`, whitened.
pub fn zero_velocity(state: &ActiveState, rows: &mut LinearizedMeasurement) {
    rows.blocks.keyframes.clear();
    rows.blocks.active.clear();
    rows.blocks.active.push(VELOCITY..VELOCITY + 3);
    rows.upper_triangular = true;
    rows.jacobian.reset(3, 3);
    for k in 0..3 {
        rows.jacobian[(k, k)] = 1.0 / SIGMA_VELOCITY;
    }
    rows.residual.clear();
    rows.residual.extend(state.imu.velocity.iter().map(|velocity| -velocity / SIGMA_VELOCITY));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::{Calibration, OnlineCalibration};
    use crate::odometry::tracks::TrackObservation;
    use crate::propagation::{ImuState, MotionEstimate};
    use crate::state::{CloneId, ClonedPose};
    use geometry::{Camera, Distortion, rotation};
    use rand::{RngExt as _, SeedableRng, rngs::StdRng};

    /// A second of images from poses `at(seconds)` of points 2 to 10 m away, with 1 px of noise.
    fn judged(count: usize, at: impl Fn(f64) -> Pose) -> bool {
        judged_by(count, at, 0.0)
    }

    /// The same by a filter that believes to turn by `bias` rad/s more than it does.
    fn judged_by(count: usize, at: impl Fn(f64) -> Pose, bias: f64) -> bool {
        let mut rng = StdRng::seed_from_u64(3);
        let camera = Camera {
            width: 752,
            height: 480,
            focal: [458.0, 458.0],
            centre: [375.5, 239.5],
            distortion: Distortion::None,
        };
        let rig = [CalibratedCamera { camera, imu_from_camera: Pose::identity() }];
        let points: Vec<Vector3<f64>> = (0..count)
            .map(|_| {
                let depth = rng.random_range(2.0..10.0);
                Vector3::new(rng.random_range(-0.5..0.5) * depth, rng.random_range(-0.3..0.3) * depth, depth)
            })
            .collect();
        let mut noise = || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
        let mut tracks = TrackStore::default();
        let mut clones = Vec::new();
        for k in 0..=10_u64 {
            let pose = at(k as f64 * 0.1);
            let id = CloneId(k);
            let seen: Vec<TrackObservation> = points
                .iter()
                .enumerate()
                .filter_map(|(feature_id, point)| {
                    let pixel = rig[0].camera.project(&pose.inverse_transform(point)).ok()?;
                    let pixel = pixel + Vector2::new(noise(), noise());
                    Some(TrackObservation { camera: 0, feature_id: feature_id as u64, pixel })
                })
                .collect();
            tracks.add(id, &seen, |_| false);
            let stamp_ns = k as i64 * 100_000_000;
            let drift = rotation::exp(&Vector3::new(0.0, bias * k as f64 * 0.1, 0.0));
            let believed = Pose { rotation: drift * pose.rotation, ..pose };
            clones.push(ClonedPose {
                id,
                stamp_ns,
                local_from_imu: believed,
                first_estimate: believed,
                pinned: false,
            });
        }
        let imu = ImuState {
            local_from_imu: at(1.0),
            velocity: Vector3::zeros(),
            gyroscope_bias: Vector3::zeros(),
            accelerometer_bias: Vector3::zeros(),
        };
        let first_motion = MotionEstimate { position: Vector3::zeros(), velocity: Vector3::zeros() };
        let calibration = Calibration::new(rig.to_vec(), 0.0, OnlineCalibration::default());
        let state = ActiveState {
            stamp_ns: 1_000_000_000,
            imu,
            first_motion,
            calibration,
            transform: None,
            landmarks: Vec::new(),
            clones,
        };
        stands_still(&state, &tracks, 1.0)
    }

    #[test]
    fn a_body_stands_when_nothing_but_its_rotation_moves_the_image() {
        assert!(judged(80, |_| Pose::identity()));
        let turning = |seconds: f64| {
            Pose::new(rotation::exp(&Vector3::new(0.1, 0.3, 0.2).scale(seconds)), Vector3::zeros())
        };
        assert!(judged(80, turning), "it turns on the spot: its velocity is zero");
        let gliding =
            |seconds: f64| Pose::new(geometry::Rotation::identity(), Vector3::new(0.05 * seconds, 0.0, 0.0));
        assert!(!judged(80, gliding), "5 cm/s along a wall is not standing");
        let curve = |seconds: f64| Pose { rotation: turning(seconds).rotation, ..gliding(seconds) };
        assert!(!judged(80, curve));
        assert!(judged_by(80, |_| Pose::identity(), 0.04), "it stands, whatever its gyroscope says");
        assert!(!judged_by(80, gliding, 0.04));
        assert!(!judged(5, |_| Pose::identity()), "five tracks are not enough to judge by");
    }
}
