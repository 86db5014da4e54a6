//! Zero-velocity update, triggered by tracks that do not move: the displacement in half a second is zero.
//!
//! A stationary body has no parallax, so its tracks cannot be triangulated and its velocity drifts with the accelerometer
//! bias. Its tracks show the lack of motion: half a second later, their pixels are still in the same place.
//!
//! * A body that starts gently moves the image by less than the noise of a pixel at first, but it moves all pixels together:
//!   the median shift and the median expansion of the image are compared with the accuracy of a median, which the pixels'
//!   own spread shows.
//! * What the tracks show is stated, a displacement. The velocity of a body that starts is up to twice its mean: stated as
//!   zero it becomes an error of the accelerometer bias.
//! * Rotation in place has zero velocity, too: where the image turned, the same is asked of pixels that are compensated by the
//!   estimated rotation. It is not asked of those that did not move in the first place, since a gyroscope bias that is not yet
//!   known (0.02 rad/s move a pixel by 5 px in half a second) moves compensated ones.
//! * The estimated displacement must pass a chi-square test.
//! * Images within half a second show the same lack of motion, so the update is made once in that time.

use crate::calibration::CalibratedCamera;
use crate::camera_vote::most_are_still;
use crate::measurement::LinearizedMeasurement;
use crate::odometry::tracks::TrackStore;
use crate::state::{ActiveState, ClonedPose, POSE_DIM};
use geometry::Pose;
use nalgebra::{Vector2, Vector3};
use smallvec::SmallVec;

/// Minimum time between both pixels of a pair, nanoseconds.
pub const MIN_SPAN_NS: i64 = 450_000_000;
/// Minimum number of tracks.
const MIN_TRACKS: usize = 12;
/// Maximum median displacement in units of the pixel noise. Noise alone gives 1.66: both pixels of a pair
/// have it, and the median of a squared length in two dimensions is 1.39 variances.
const MAX_DISPLACEMENT: f64 = 2.0;
/// Maximum median shift and expansion of the image in standard deviations of a median.
const MAX_SHIFT_SIGMAS: f64 = 4.0;
/// Shift and expansion that count as none, px: trackers drift by a tenth of a pixel. Of a point five metres away it is 3 mm.
const NEGLIGIBLE_SHIFT_PX: f64 = 0.3;
/// Standard deviation of a median of normal values, in units of theirs divided by the root of their number.
const MEDIAN_SIGMA: f64 = 1.2533;
/// Standard deviation of normal values in units of their median absolute deviation.
const SIGMA_PER_MAD: f64 = 1.4826;
/// Standard deviation of the displacement of a stationary body in half a second, metres: that of a point five metres away is
/// a pixel.
const SIGMA_DISPLACEMENT_M: f64 = 0.01;
/// Begin of the position in the error of a pose.
const POSITION: usize = 3;

/// One value per track, px. Those of 400 tracks are stored without heap allocation.
type Values = SmallVec<[f64; 400]>;

/// Pixels of a track then and now, px.
#[derive(Clone, Copy)]
struct PixelPair {
    then: Vector2<f64>,
    now: Vector2<f64>,
}

/// Whether the tracks of the newest image show that the body has not moved for at least half a second, by most of the cameras (of a
/// stereo pair the first one) that see enough.
///
/// # Arguments
/// * `sigma_px`: noise of tracked pixels, px.
pub fn is_stationary(state: &ActiveState, tracks: &TrackStore, sigma_px: f64) -> bool {
    let cameras = state.calibration.cameras.iter().enumerate();
    most_are_still(cameras.map(|camera| is_still_in(state, tracks, camera, sigma_px))) == Some(true)
}

/// Whether the tracks of a camera show that; `None` where they are too few.
fn is_still_in(
    state: &ActiveState,
    tracks: &TrackStore,
    (camera, calibrated): (usize, &CalibratedCamera),
    sigma_px: f64,
) -> Option<bool> {
    let newest = state.clones.last()?;
    let now = newest.local_from_imu * calibrated.imu_from_camera;
    let mut pairs = SmallVec::<[PixelPair; 400]>::new();
    let mut compensated = SmallVec::<[PixelPair; 400]>::new();
    let mut turned = Values::new();
    for (old, pixel_then, pixel_now) in tracks.pairs_with(newest.id, camera) {
        let Some(index) = state.clone_index(old) else { continue };
        let clone = &state.clones[index];
        if newest.stamp_ns - clone.stamp_ns < MIN_SPAN_NS {
            continue;
        }
        let then = clone.local_from_imu * calibrated.imu_from_camera;
        pairs.push(PixelPair { then: pixel_then, now: pixel_now });
        if let Some(expected) = rotated(calibrated, &then, &now, &pixel_then) {
            compensated.push(PixelPair { then: expected, now: pixel_now });
            turned.push((expected - pixel_then).norm());
        }
    }
    if pairs.len() < MIN_TRACKS {
        return None;
    }
    let limit = MAX_DISPLACEMENT * sigma_px;
    let mut turned_still =
        || 2 * turned.len() > pairs.len() && median(&mut turned) > limit && is_still(&compensated, limit);
    Some(is_still(&pairs, limit) || turned_still())
}

/// Whether an image neither moves nor expands.
///
/// # Arguments
/// * `limit_px`: maximum median displacement of a pixel, px.
fn is_still(pairs: &[PixelPair], limit_px: f64) -> bool {
    if pairs.len() < MIN_TRACKS {
        return false;
    }
    let centre = pairs.iter().map(|pair| pair.then).sum::<Vector2<f64>>() / pairs.len() as f64;
    let mut lengths: Values = pairs.iter().map(|pair| (pair.now - pair.then).norm()).collect();
    let of = |value: &dyn Fn(&PixelPair) -> f64| is_negligible(pairs.iter().map(value).collect());
    median(&mut lengths) < limit_px
        && of(&|pair| pair.now.x - pair.then.x)
        && of(&|pair| pair.now.y - pair.then.y)
        && of(&|pair| {
            let away = pair.then - centre;
            away.dot(&(pair.now - pair.then)) / away.norm().max(1.0)
        })
}

/// Whether the median of displacements is zero as far as their spread lets one tell.
fn is_negligible(mut values: Values) -> bool {
    let middle = median(&mut values);
    let count = values.len() as f64;
    for value in &mut values {
        *value = (*value - middle).abs();
    }
    let sigma = MEDIAN_SIGMA * SIGMA_PER_MAD * median(&mut values) / count.sqrt();
    middle.abs() < (MAX_SHIFT_SIGMAS * sigma).max(NEGLIGIBLE_SHIFT_PX)
}

/// The median of some values, whose order changes; infinite without any.
fn median(values: &mut [f64]) -> f64 {
    if values.is_empty() {
        return f64::INFINITY;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Where a pixel would be if the camera had rotated only, px.
fn rotated(
    calibrated: &CalibratedCamera,
    then: &Pose,
    now: &Pose,
    pixel_then: &Vector2<f64>,
) -> Option<Vector2<f64>> {
    let seen = calibrated.camera.unproject(pixel_then).ok()?;
    let ray = now.rotation.inverse() * (then.rotation * Vector3::new(seen.x, seen.y, 1.0));
    calibrated.camera.project(&ray).ok()
}

/// The whitened measurement that the newest clone is where the one of half a second ago was, into `rows`; `false` without one.
pub fn zero_displacement(state: &ActiveState, rows: &mut LinearizedMeasurement) -> bool {
    let Some(newest) = state.clones.last() else { return false };
    let is_older = |clone: &ClonedPose| newest.stamp_ns - clone.stamp_ns >= MIN_SPAN_NS;
    let Some(before) = state.clones.iter().rposition(is_older) else { return false };
    let position = |index: usize| {
        let begin = state.clones_begin() + POSE_DIM * index + POSITION;
        begin..begin + 3
    };
    rows.blocks.keyframes.clear();
    rows.blocks.active.clear();
    rows.blocks.active.extend([position(before), position(state.clones.len() - 1)]);
    rows.upper_triangular = false;
    rows.jacobian.reset(3, 6);
    for k in 0..3 {
        rows.jacobian[(k, k)] = -1.0 / SIGMA_DISPLACEMENT_M;
        rows.jacobian[(k, 3 + k)] = 1.0 / SIGMA_DISPLACEMENT_M;
    }
    let moved = newest.local_from_imu.translation - state.clones[before].local_from_imu.translation;
    rows.residual.clear();
    rows.residual.extend(moved.iter().map(|moved| -moved / SIGMA_DISPLACEMENT_M));
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::{Calibration, OnlineCalibration};
    use crate::propagation::{ImuState, MotionEstimate};
    use crate::state::{CloneId, ClonedPose};
    use geometry::{Camera, Distortion, rotation};
    use nalgebra::DVector;
    use rand::{RngExt as _, SeedableRng, rngs::StdRng};
    use types::TrackObservation;

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
        let cameras = [CalibratedCamera::new(camera, Pose::identity())];
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
                pins: 0,
                motion: None,
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
            wheels: None,
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

    #[test]
    fn a_gentle_start_is_motion_although_each_pixel_moves_by_less_than_its_noise() {
        let started = |axis: Vector3<f64>, metres: f64| {
            move |seconds: f64| {
                let since = (seconds - 0.7).max(0.0) / 0.3;
                Pose::new(geometry::Rotation::identity(), axis * (metres * since * since))
            }
        };
        assert!(!stationary(150, started(Vector3::x(), 0.012)), "a quarter of a metre per second squared");
        assert!(!stationary(150, started(Vector3::z(), 0.06)), "forward the image expands");
        assert!(stationary(150, started(Vector3::x(), 0.001)));
    }

    #[test]
    fn the_displacement_is_linear_in_the_errors_of_two_clones() {
        let mut scene = crate::test_scene::scene(false);
        let mut rows = LinearizedMeasurement::default();
        assert!(!zero_displacement(&scene.state, &mut rows), "all images within half a second");
        for (k, clone) in scene.state.clones.iter_mut().enumerate() {
            clone.stamp_ns = k as i64 * 100_000_000;
        }
        assert!(zero_displacement(&scene.state, &mut rows));
        let before = rows.residual.clone();
        let error = DVector::from_fn(scene.state.dim(), |k, _| 0.01 * (k as f64).sin());
        let mut expected = before.clone();
        for (active, columns) in rows.blocks.ranges() {
            for (index, column) in active.zip(columns) {
                for (row, value) in expected.iter_mut().enumerate() {
                    *value -= rows.jacobian[(row, column)] * error[index];
                }
            }
        }
        let two = [2, 7].map(|index: usize| scene.state.clones_begin() + POSE_DIM * index + POSITION);
        assert_eq!(
            rows.blocks.active,
            two.map(|begin| begin..begin + 3),
            "the newest and the one 0.5 s before"
        );
        scene.state.retract(&error);
        assert!(zero_displacement(&scene.state, &mut rows));
        for (value, expected) in rows.residual.iter().zip(&expected) {
            assert!((value - expected).abs() < 1e-9, "{value} {expected}");
        }
    }
}
