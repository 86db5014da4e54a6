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
//! * What a pixel does not show is stated as uncertain: of points twenty metres away, a shift of a third of a pixel is centimetres.
//! * A window of images at a high rate is shorter than half a second. It shows less, and that is used.

use crate::calibration::CalibratedCamera;
use crate::camera_vote::most_are_still;
use crate::measurement::LinearizedMeasurement;
use crate::odometry::tracks::TrackStore;
use crate::state::{ActiveState, ClonedPose, POSE_DIM};
use geometry::Pose;
use nalgebra::{Vector2, Vector3};
use smallvec::SmallVec;

/// Minimum time between both pixels of a pair, nanoseconds, where the window is long enough.
const MIN_SPAN_NS: i64 = 450_000_000;
/// Part of the window between both pixels of a pair where it is not: times of images jitter.
const PART_OF_WINDOW: f64 = 0.9;
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
/// Standard deviation of the displacement of a stationary body in half a second, metres, beside what the image does not show.
const SIGMA_DISPLACEMENT_M: f64 = 0.01;
/// Distance of a median point from the centre of an image in units of the focal length: motion along the axis of the camera shifts it by
/// this part of what motion across it does.
const OFF_CENTRE: f64 = 0.4;
/// Minimum number of SLAM features whose distances are known, for their median.
const MIN_DISTANCES: usize = 5;
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

/// Time between both pixels of a pair, nanoseconds: half a second, or most of a window that is shorter.
///
/// # Arguments
/// * `window`: clones of the window beside the newest one.
pub fn span_ns(state: &ActiveState, window: usize) -> i64 {
    let clones = &state.clones[state.clones.len().saturating_sub(window + 1)..];
    let [first, .., last] = clones else { return MIN_SPAN_NS };
    let between_two = (last.stamp_ns - first.stamp_ns) as f64 / (clones.len() - 1) as f64;
    MIN_SPAN_NS.min((PART_OF_WINDOW * between_two * window as f64) as i64)
}

/// Whether the tracks of the newest image show that the body has not moved since the images before `span_ns`, by most of the cameras (of
/// a stereo pair the first one) that see enough.
///
/// # Arguments
/// * `sigma_px`: noise of tracked pixels, px.
pub fn is_stationary(state: &ActiveState, tracks: &TrackStore, sigma_px: f64, span_ns: i64) -> bool {
    let cameras = state.calibration.cameras.iter().enumerate();
    most_are_still(cameras.map(|camera| is_still_in(state, tracks, camera, sigma_px, span_ns))) == Some(true)
}

/// Whether the tracks of a camera show that; `None` where they are too few.
fn is_still_in(
    state: &ActiveState,
    tracks: &TrackStore,
    (camera, calibrated): (usize, &CalibratedCamera),
    sigma_px: f64,
    span_ns: i64,
) -> Option<bool> {
    let newest = state.clones.last()?;
    let now = newest.local_from_imu * calibrated.imu_from_camera;
    let mut pairs = SmallVec::<[PixelPair; 400]>::new();
    let mut compensated = SmallVec::<[PixelPair; 400]>::new();
    let mut turned = Values::new();
    for (old, pixel_then, pixel_now) in tracks.pairs_with(newest.id, camera) {
        let Some(index) = state.clone_index(old) else { continue };
        let clone = &state.clones[index];
        if newest.stamp_ns - clone.stamp_ns < span_ns {
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
    geometry::median(values).unwrap_or(f64::INFINITY)
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

/// Standard deviation of a displacement that the tracks do not show, metres: with the distance of the SLAM features, where there are some,
/// that which shifts their pixels by what counts as none.
fn sigma_displacement_m(state: &ActiveState) -> f64 {
    let Some(newest) = state.clones.last() else { return SIGMA_DISPLACEMENT_M };
    let shifts = state.slam_features.iter().filter_map(|feature| {
        let camera = state.calibration.cameras.get(usize::from(feature.camera))?;
        let [fx, fy] = camera.camera.focal;
        let distance = (feature.position - newest.local_from_imu.translation).norm();
        Some(NEGLIGIBLE_SHIFT_PX * distance / (OFF_CENTRE * (0.5 * (fx + fy))))
    });
    let mut shifts: Values = shifts.collect();
    let unseen = if shifts.len() < MIN_DISTANCES { 0.0 } else { median(&mut shifts) };
    SIGMA_DISPLACEMENT_M.hypot(unseen)
}

/// The whitened measurement that the newest clone is where the one before `span_ns` was, into `rows`; `false` without one.
pub fn zero_displacement(state: &ActiveState, span_ns: i64, rows: &mut LinearizedMeasurement) -> bool {
    let Some(newest) = state.clones.last() else { return false };
    let is_older = |clone: &ClonedPose| newest.stamp_ns - clone.stamp_ns >= span_ns;
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
    let sigma = sigma_displacement_m(state);
    for k in 0..3 {
        rows.jacobian[(k, k)] = -1.0 / sigma;
        rows.jacobian[(k, 3 + k)] = 1.0 / sigma;
    }
    let moved = newest.local_from_imu.translation - state.clones[before].local_from_imu.translation;
    rows.residual.clear();
    rows.residual.extend(moved.iter().map(|moved| -moved / sigma));
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::{Calibration, OnlineCalibration};
    use crate::propagation::{ImuState, MotionEstimate};
    use crate::state::{CloneId, ClonedPose, SlamFeature};
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
        is_stationary(&state, &tracks, 1.0, MIN_SPAN_NS)
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
    fn at_a_high_rate_most_of_the_window_is_used() {
        let mut scene = crate::test_scene::scene(false);
        let count = scene.state.clones.len();
        let mut span = |interval_ns: i64, window: usize| {
            for (k, clone) in scene.state.clones.iter_mut().enumerate() {
                clone.stamp_ns = k as i64 * interval_ns;
            }
            span_ns(&scene.state, window)
        };
        // Of 21 clones at 20 Hz, and of those that there are so far.
        for window in [20, count - 1] {
            assert_eq!(span(1_000_000_000 / window as i64, window), MIN_SPAN_NS);
        }
        // Two cameras of 30 Hz each that are triggered apart.
        let span = span(16_666_667, 20);
        assert!((290_000_000..310_000_000).contains(&span), "{span}");
    }

    #[test]
    fn the_further_away_the_features_the_less_is_stated() {
        let mut scene = crate::test_scene::scene(false);
        let feature = |position| SlamFeature {
            feature_id: 0,
            position,
            first_estimate: position,
            gated_in_a_row: 0,
            camera: 0,
            last_seen: CloneId(0),
        };
        let here = scene.state.clones.last().unwrap().local_from_imu.translation;
        let mut sigma = |metres: f64, count: usize| {
            scene.state.slam_features = vec![feature(here + Vector3::x() * metres); count];
            sigma_displacement_m(&scene.state)
        };
        assert!((sigma(40.0, 2) - SIGMA_DISPLACEMENT_M).abs() < 1e-12, "too few to tell");
        assert!(sigma(2.0, 9) < 1.2 * SIGMA_DISPLACEMENT_M);
        assert!((0.02..0.1).contains(&sigma(20.0, 9)));
        assert!(sigma(40.0, 9) > 1.9 * sigma(20.0, 9));
    }

    #[test]
    fn the_displacement_is_linear_in_the_errors_of_two_clones() {
        let mut scene = crate::test_scene::scene(false);
        scene.state.slam_features.clear();
        let mut rows = LinearizedMeasurement::default();
        assert!(!zero_displacement(&scene.state, MIN_SPAN_NS, &mut rows), "all images within half a second");
        for (k, clone) in scene.state.clones.iter_mut().enumerate() {
            clone.stamp_ns = k as i64 * 100_000_000;
        }
        assert!(zero_displacement(&scene.state, MIN_SPAN_NS, &mut rows));
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
        assert!(zero_displacement(&scene.state, MIN_SPAN_NS, &mut rows));
        for (value, expected) in rows.residual.iter().zip(&expected) {
            assert!((value - expected).abs() < 1e-9, "{value} {expected}");
        }
    }
}
