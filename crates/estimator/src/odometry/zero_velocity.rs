//! Zero-velocity update, triggered by tracks that do not move.
//!
//! A stationary body has no parallax, so its tracks cannot be triangulated and its velocity drifts with the accelerometer
//! bias. Its tracks show the lack of motion: pixels from half a second ago, rotated by the rotation between both images,
//! are still in the same place.
//!
//! * Rotation in place has zero velocity, too: the estimated rotation is compensated first. While the gyroscope bias is
//!   not yet known (0.02 rad/s move a pixel by 5 px in half a second), the compensated pixels move; pixels that do not move
//!   without compensation show a stationary body as well.
//! * Slow translation is told apart as long as some features are near enough to move by more than their noise within a
//!   track; and the estimated velocity must pass a chi-square test.

use crate::calibration::CalibratedCamera;
use crate::measurement::LinearizedMeasurement;
use crate::odometry::tracks::TrackStore;
use crate::propagation::VELOCITY;
use crate::state::ActiveState;
use geometry::Pose;
use nalgebra::{Vector2, Vector3};
use smallvec::SmallVec;

/// Minimum time between both pixels of a pair, nanoseconds.
const MIN_SPAN_NS: i64 = 450_000_000;
/// Minimum number of tracks.
const MIN_TRACKS: usize = 12;
/// Maximum median displacement in units of the pixel noise. Noise alone gives 1.66: both pixels of a pair
/// have it, and the median of a squared length in two dimensions is 1.39 variances.
const MAX_DISPLACEMENT: f64 = 2.0;
/// Standard deviation of the velocity of a stationary body, m/s: the displacement of a point five metres away that is below
/// the pixel noise in half a second.
const SIGMA_VELOCITY_M_S: f64 = 0.02;

/// One displacement per track, px. Those of 400 tracks are stored without heap allocation.
type Lengths = SmallVec<[f64; 400]>;

/// Whether the tracks of the newest image show that the body has not moved for at least half a second.
///
/// # Arguments
/// * `sigma_px`: noise of tracked pixels, px.
pub fn is_stationary(state: &ActiveState, tracks: &TrackStore, sigma_px: f64) -> bool {
    let Some(newest) = state.clones.last() else { return false };
    let Some(calibrated) = state.calibration.cameras.first() else { return false };
    let now = newest.local_from_imu * calibrated.imu_from_camera;
    let (mut compensated, mut uncompensated) = (Lengths::new(), Lengths::new());
    for (old, pixel_then, pixel_now) in tracks.pairs_with(newest.id) {
        let Some(index) = state.clone_index(old) else { continue };
        let clone = &state.clones[index];
        if newest.stamp_ns - clone.stamp_ns < MIN_SPAN_NS {
            continue;
        }
        let then = clone.local_from_imu * calibrated.imu_from_camera;
        // A point that rotates out of the image is no stationary point.
        compensated
            .push(displacement(calibrated, &then, &now, &pixel_then, &pixel_now).unwrap_or(f64::INFINITY));
        uncompensated.push((pixel_then - pixel_now).norm());
    }
    if compensated.len() < MIN_TRACKS {
        return false;
    }
    [compensated, uncompensated].into_iter().any(|mut lengths| {
        let middle = lengths.len() / 2;
        let (_, median, _) = lengths.select_nth_unstable_by(middle, f64::total_cmp);
        *median < MAX_DISPLACEMENT * sigma_px
    })
}

/// Distance of a pixel from its prediction by the rotation alone, px.
fn displacement(
    calibrated: &CalibratedCamera,
    then: &Pose,
    now: &Pose,
    pixel_then: &Vector2<f64>,
    pixel_now: &Vector2<f64>,
) -> Option<f64> {
    let seen = calibrated.camera.unproject(pixel_then).ok()?;
    let ray = now.rotation.inverse() * (then.rotation * Vector3::new(seen.x, seen.y, 1.0));
    Some((calibrated.camera.project(&ray).ok()? - pixel_now).norm())
}

/// The whitened measurement `v = 0`, into `rows`.
pub fn zero_velocity(state: &ActiveState, rows: &mut LinearizedMeasurement) {
    rows.blocks.keyframes.clear();
    rows.blocks.active.clear();
    rows.blocks.active.push(VELOCITY..VELOCITY + 3);
    rows.upper_triangular = true;
    rows.jacobian.reset(3, 3);
    for k in 0..3 {
        rows.jacobian[(k, k)] = 1.0 / SIGMA_VELOCITY_M_S;
    }
    rows.residual.clear();
    rows.residual.extend(state.imu.velocity.iter().map(|velocity| -velocity / SIGMA_VELOCITY_M_S));
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

    /// Whether a second of images is stationary, from poses `at(seconds)` of points 2 to 10 m away, with 1 px of noise.
    fn stationary(count: usize, at: impl Fn(f64) -> Pose) -> bool {
        stationary_with_bias(count, at, 0.0)
    }

    /// The same with an unknown gyroscope bias about y, rad/s.
    fn stationary_with_bias(count: usize, at: impl Fn(f64) -> Pose, bias: f64) -> bool {
        let mut rng = StdRng::seed_from_u64(3);
        let camera = Camera {
            width: 752,
            height: 480,
            focal: [458.0, 458.0],
            centre: [375.5, 239.5],
            distortion: Distortion::None,
        };
        let cameras = [CalibratedCamera { camera, imu_from_camera: Pose::identity() }];
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
                    let pixel = cameras[0].camera.project(&pose.inverse_transform(point)).ok()?;
                    let pixel = pixel + Vector2::new(noise(), noise());
                    Some(TrackObservation { camera: 0, feature_id: feature_id as u64, pixel })
                })
                .collect();
            tracks.add(id, &seen, |_| false);
            let stamp_ns = k as i64 * 100_000_000;
            let drift = rotation::exp(&Vector3::new(0.0, bias * k as f64 * 0.1, 0.0));
            let estimated = Pose { rotation: drift * pose.rotation, ..pose };
            clones.push(ClonedPose {
                id,
                stamp_ns,
                local_from_imu: estimated,
                first_estimate: estimated,
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
        let calibration = Calibration::new(cameras.to_vec(), 0.0, OnlineCalibration::default());
        let state = ActiveState {
            stamp_ns: 1_000_000_000,
            imu,
            first_motion,
            calibration,
            transform: None,
            slam_features: Vec::new(),
            clones,
        };
        is_stationary(&state, &tracks, 1.0)
    }

    #[test]
    fn a_body_is_stationary_when_only_its_rotation_moves_the_image() {
        assert!(stationary(80, |_| Pose::identity()));
        let rotating = |seconds: f64| {
            Pose::new(rotation::exp(&Vector3::new(0.1, 0.3, 0.2).scale(seconds)), Vector3::zeros())
        };
        assert!(stationary(80, rotating), "rotation in place has zero velocity");
        let translating =
            |seconds: f64| Pose::new(geometry::Rotation::identity(), Vector3::new(0.05 * seconds, 0.0, 0.0));
        assert!(!stationary(80, translating), "5 cm/s along a wall is motion");
        let curve = |seconds: f64| Pose { rotation: rotating(seconds).rotation, ..translating(seconds) };
        assert!(!stationary(80, curve));
        assert!(stationary_with_bias(80, |_| Pose::identity(), 0.04), "stationary with a biased gyroscope");
        assert!(!stationary_with_bias(80, translating, 0.04));
        assert!(!stationary(5, |_| Pose::identity()), "five tracks are not enough");
    }
}
