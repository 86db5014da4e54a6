//! What a body is started from: rest that the images confirm, or motion that tells its scale.

use estimator::{
    CalibratedCamera, EstimatorConfig, ImuSample, InitMethod, InitStatus, Initialization, Initializer,
    LastTrustedPose, TrackObservation,
};
use geometry::{Camera, Distortion, Pose, PoseWithCovariance, rotation};
use nalgebra::{Matrix6, Vector3};
use rand::{RngExt as _, SeedableRng, rngs::StdRng};

const IMU_NS: i64 = 5_000_000;
const FRAME_NS: i64 = 50_000_000;
/// Tilt of the body.
const TILT: Vector3<f64> = Vector3::new(0.3, -0.2, 0.0);

/// One camera.
fn cameras() -> Vec<CalibratedCamera> {
    let camera = Camera {
        width: 640,
        height: 480,
        focal: [400.0; 2],
        centre: [320.0, 240.0],
        distortion: Distortion::None,
    };
    vec![CalibratedCamera::new(camera, Pose::identity())]
}

/// Several cameras with their optical axes a third of a turn apart.
fn rig() -> Vec<CalibratedCamera> {
    let turned = |k: usize| {
        let rotation = rotation::exp(&Vector3::new(0.0, 2.1 * k as f64, 0.0));
        CalibratedCamera::new(cameras()[0].camera.clone(), Pose::new(rotation, Vector3::zeros()))
    };
    (0..3).map(turned).collect()
}

/// Readings of a body without acceleration and images of one that moves at `velocity` (m/s), until it starts.
fn watch(
    initializer: Initializer,
    velocity: Vector3<f64>,
    seconds: f64,
) -> Result<(f64, Initialization), Vec<InitStatus>> {
    watch_by(initializer, &[velocity], seconds)
}

/// The same with several cameras.
///
/// # Arguments
/// * `velocities`: by which each camera sees its points pass, in its own frame, m/s.
fn watch_by(
    initializer: Initializer,
    velocities: &[Vector3<f64>],
    seconds: f64,
) -> Result<(f64, Initialization), Vec<InitStatus>> {
    watch_with(initializer, velocities, seconds, 0)
}

/// The same with a camera whose clock is behind.
///
/// # Arguments
/// * `behind_ns`: the stamps of the images are so much too early.
fn watch_with(
    mut initializer: Initializer,
    velocities: &[Vector3<f64>],
    seconds: f64,
    behind_ns: i64,
) -> Result<(f64, Initialization), Vec<InitStatus>> {
    let mut rng = StdRng::seed_from_u64(4);
    let mut draw = |low: f64, high: f64| rng.random_range(low..high);
    let points: Vec<Vector3<f64>> =
        (0..60).map(|_| Vector3::new(draw(-3.0, 3.0), draw(-2.0, 2.0), draw(4.0, 8.0))).collect();
    let rotation = rotation::exp(&TILT);
    let mut waited = Vec::new();
    for step in 0..(seconds * 1e9) as i64 / IMU_NS {
        let stamp_ns = step * IMU_NS;
        let shiver = Vector3::repeat(0.002 * (step as f64).sin());
        let force = rotation.inverse() * Vector3::new(0.0, 0.0, 9.81) + shiver;
        initializer.imu(ImuSample { stamp_ns, gyroscope: shiver * 0.1, accelerometer: force }).unwrap();
        if stamp_ns % FRAME_NS != 0 {
            continue;
        }
        let camera = &cameras()[0].camera;
        let mut tracks = Vec::new();
        for (index, velocity) in velocities.iter().enumerate() {
            let at = velocity * (stamp_ns as f64 * 1e-9);
            let see = |(name, point): (usize, &Vector3<f64>)| {
                let pixel = camera.project(&(point - at)).ok()?;
                let noise = nalgebra::Vector2::new(draw(-1.0, 1.0), draw(-1.0, 1.0));
                camera.contains(&pixel).then_some(TrackObservation {
                    camera: index as u8,
                    feature_id: (name * velocities.len() + index) as u64,
                    pixel: pixel + noise,
                })
            };
            tracks.extend(points.iter().enumerate().filter_map(see));
        }
        match initializer.image(stamp_ns - behind_ns, &tracks) {
            Ok(start) => return Ok((stamp_ns as f64 * 1e-9, start)),
            Err(waiting) => waited.push(waiting),
        }
    }
    Err(waited)
}

#[test]
fn a_body_that_stands_starts_after_half_a_second() {
    let (seconds, start) =
        watch(Initializer::new(EstimatorConfig::default(), cameras()), Vector3::zeros(), 3.0).unwrap();
    assert_eq!(start.method, InitMethod::Static);
    assert!(seconds <= 0.55, "{seconds} s");
    let up = start.initial.imu.local_from_imu.rotation * (rotation::exp(&TILT).inverse() * Vector3::z());
    assert!((up - Vector3::z()).norm() < 0.01);
}

#[test]
fn gliding_is_not_rest_and_one_camera_that_glides_never_starts() {
    let glide = Vector3::new(0.4, 0.1, 0.0);
    let waited = watch(Initializer::new(EstimatorConfig::default(), cameras()), glide, 6.0).unwrap_err();
    let last = waited.last().unwrap().to_string();
    assert!(
        last.contains("the features of the images move") && last.contains("dynamic initialization: "),
        "{last}"
    );
}

#[test]
fn one_camera_of_three_neither_keeps_a_rig_from_starting_nor_lets_it_start_while_it_glides() {
    let [still, glide] = [Vector3::zeros(), Vector3::new(0.4, 0.1, 0.0)];
    let initializer = || Initializer::new(EstimatorConfig::default(), rig());
    let (seconds, start) = watch_by(initializer(), &[glide, still, still], 3.0).unwrap();
    assert_eq!(start.method, InitMethod::Static, "the first camera sees something that passes");
    assert!(seconds <= 0.55, "{seconds} s");
    let waited = watch_by(initializer(), &[still, glide, glide], 3.0).unwrap_err();
    let last = waited.last().unwrap().to_string();
    assert!(last.contains("the features of the images move"), "dirt on the first camera: {last}");
}

#[test]
fn the_next_start_takes_position_and_yaw_of_the_last_believed_pose() {
    let turn = rotation::exp(&Vector3::new(0.0, 0.0, 1.2)) * rotation::exp(&TILT);
    let last = LastTrustedPose {
        stamp_ns: 0,
        local_from_imu: PoseWithCovariance::new(
            Pose::new(turn, Vector3::new(5.0, -3.0, 1.0)),
            Matrix6::identity() * 1e-4,
        ),
        velocity: Vector3::new(0.0, 2.0, 0.0),
        gyroscope_bias: Vector3::zeros(),
    };
    let initializer = Initializer::again(EstimatorConfig::default(), cameras(), Some(last), 1_000_000_000);
    let (seconds, start) = watch(initializer, Vector3::zeros(), 3.0).unwrap();
    assert!(seconds >= 1.0, "not before the pause is over");
    let placed = start.initial.imu.local_from_imu;
    assert_eq!(placed.translation, last.local_from_imu.pose.translation);
    // It may have gone on as fast as it was, all the time.
    let elapsed_s = start.initial.stamp_ns as f64 * 1e-9;
    let sigma = start.initial.covariance[(3, 3)].sqrt();
    assert!(sigma > 2.0 * elapsed_s && sigma < 2.0 * elapsed_s + 0.1, "{sigma} m after {elapsed_s} s");
    assert!(rotation::log(&(placed.rotation * turn.inverse())).norm() < 0.01);
}

/// The state is at the time of the image by the clock of the IMU, whatever the clock of the camera says.
#[test]
fn a_stated_offset_of_the_camera_s_clock_holds_at_the_start() {
    let of = |offset_s: f64| {
        let mut config = EstimatorConfig::default();
        config.camera_time_offset_s = offset_s;
        let behind_ns = (offset_s * 1e9) as i64;
        let glide = [Vector3::new(0.4, 0.1, 0.0)];
        let waited = watch_with(Initializer::new(config.clone(), cameras()), &glide, 3.0, behind_ns);
        let rest =
            watch_with(Initializer::new(config, cameras()), &[Vector3::zeros()], 3.0, behind_ns).unwrap();
        (rest.1.initial, waited.unwrap_err())
    };
    let (expected, waited) = of(0.0);
    for offset_s in [0.03, -0.03] {
        let (found, statuses) = of(offset_s);
        assert_eq!(found, expected);
        assert_eq!(statuses, waited);
    }
}
