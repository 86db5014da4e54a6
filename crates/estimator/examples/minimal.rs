//! The filter on simulated measurements: a camera with an IMU drives on a circle within a ring of landmarks, and a map
//! with one keyframe localizes it. Prints position errors beside the standard deviations that the filter states.
//!
//! `cargo run -p driftless-estimator --example minimal`

use estimator::{
    CalibratedCamera, Estimator, EstimatorConfig, ImuSample, InitialSigmas, InitialState, MapAnswer,
    MapKeyframe, MatchedLandmark, TrackObservation,
};
use geometry::{Camera, Distortion, Pose, PoseWithCovariance, Rotation, rotation};
use nalgebra::{Matrix3, Matrix6, Matrix6xX, Rotation3, Vector2, Vector3};
use rand::{RngExt as _, SeedableRng, rngs::StdRng};

const RADIUS_M: f64 = 2.0;
const RATE_RAD_S: f64 = 0.5;
const IMAGE_NS: i64 = 100_000_000;

/// True pose in L: on a circle, x forward, y to its centre.
fn truth(stamp_ns: i64) -> Pose {
    let angle = RATE_RAD_S * stamp_ns as f64 * 1e-9;
    let position = Vector3::new(RADIUS_M * angle.sin(), RADIUS_M * (1.0 - angle.cos()), 0.0);
    Pose::new(rotation::exp(&Vector3::new(0.0, 0.0, angle)), position)
}

/// Pixels, with 1 px of noise, of the landmarks that the camera sees.
fn observe(
    at: &CalibratedCamera,
    stamp_ns: i64,
    world: &[Vector3<f64>],
    rng: &mut StdRng,
) -> Vec<(usize, Vector2<f64>)> {
    let mut normal = || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
    let pixels = world.iter().enumerate().filter_map(|(k, point)| {
        let pixel = at.predict(&truth(stamp_ns), point)?;
        at.camera.contains(&pixel).then(|| (k, pixel + Vector2::new(normal(), normal())))
    });
    pixels.collect()
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut rng = StdRng::seed_from_u64(1);
    let world: Vec<Vector3<f64>> = (0..400)
        .map(|k| {
            let (angle, away) = (f64::from(k) * 0.1, rng.random_range(5.0..8.0));
            Vector3::new(away * angle.cos(), RADIUS_M + away * angle.sin(), rng.random_range(-2.0..2.0))
        })
        .collect();
    let axes = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
    let forward = Rotation::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    let camera = CalibratedCamera::new(
        Camera {
            width: 640,
            height: 480,
            focal: [400.0; 2],
            centre: [319.5, 239.5],
            distortion: Distortion::None,
        },
        Pose::new(forward, Vector3::new(0.1, 0.0, 0.0)),
    );

    let velocity = Vector3::new(RADIUS_M * RATE_RAD_S, 0.0, 0.0);
    let sigmas = InitialSigmas::default();
    let initial = InitialState::from_truth(0, &truth(0), &velocity, &-Vector3::z(), sigmas);
    let mut estimator = Estimator::new(EstimatorConfig::default(), vec![camera.clone()], &initial)?;

    // A map whose frame G is L rotated by 1.2 rad and moved, with one keyframe known to 1 cm and 0.06 degrees.
    let global_from_local = Pose::new(rotation::exp(&(Vector3::z() * 1.2)), Vector3::new(30.0, -12.0, 2.0));
    let local_from_keyframe = truth(0) * camera.imu_from_camera;
    let mut covariance = Matrix6::identity() * 1e-6;
    covariance.fixed_view_mut::<3, 3>(3, 3).fill_diagonal(1e-4);
    let keyframe = MapKeyframe {
        id: 1,
        global_from_keyframe: PoseWithCovariance::new(global_from_local * local_from_keyframe, covariance),
        camera: camera.camera.clone(),
        common_error: Matrix6xX::zeros(0),
        cross_covariances: Vec::new(),
    };
    let in_keyframe = observe(&camera, 0, &world, &mut rng);

    println!("time   error, sigma in the local frame   error, sigma in the map (m)");
    for stamp_ns in (0..=26_000_000_000).step_by(5_000_000) {
        let accelerometer = Vector3::new(0.0, RADIUS_M * RATE_RAD_S.powi(2), 9.81);
        estimator.imu(ImuSample { stamp_ns, gyroscope: Vector3::z() * RATE_RAD_S, accelerometer })?;
        if stamp_ns % IMAGE_NS != 0 {
            continue;
        }
        let clone = estimator.time_update(stamp_ns)?;
        let pixels = observe(&camera, stamp_ns, &world, &mut rng);
        let track = |&(k, pixel): &(usize, _)| TrackObservation { camera: 0, feature_id: k as u64, pixel };
        estimator.track_update(&pixels.iter().map(track).collect::<Vec<_>>())?;

        // The map answers to every image with the landmarks that the keyframe sees, too.
        let matched = |&(k, pixel): &(usize, Vector2<f64>)| {
            let (_, pixel_there) = in_keyframe.iter().find(|(other, _)| *other == k)?;
            let position_in_anchor = local_from_keyframe.inverse_transform(&world[k]);
            Some(MatchedLandmark {
                pixel,
                anchor: 1,
                position_in_anchor,
                observations: vec![(1, *pixel_there)],
            })
        };
        let answer = MapAnswer {
            map_version: 1,
            map_identity: 1,
            camera: 0,
            keyframes: vec![keyframe.clone()],
            held_at_query: estimator.held_keyframes(),
            landmarks: pixels.iter().filter_map(matched).collect(),
            gravity_in_global: Some(-Vector3::z()),
            sigma_map_px: 1.0,
            log_odds: 10.0,
            log_prior_odds: 0.0,
        };
        estimator.map_update(clone, &answer)?;

        if stamp_ns % 2_000_000_000 == 0 {
            let line = |estimate: Option<PoseWithCovariance>, truth: Pose| {
                let Some(estimate) = estimate else { return "unknown".to_owned() };
                let error = (estimate.pose.translation - truth.translation).norm();
                let sigma = estimate.covariance.fixed_view::<3, 3>(3, 3).trace().sqrt();
                format!("{error:.3} {sigma:.3}")
            };
            let (local, global) = (estimator.local_from_imu(), estimator.global_from_imu());
            let local = line(Some(local), truth(stamp_ns));
            let global = line(global, global_from_local * truth(stamp_ns));
            println!("{:>3} s  {local:<33} {global}", stamp_ns / 1_000_000_000);
        }
    }
    println!("{}", estimator.status().reason);
    Ok(())
}
