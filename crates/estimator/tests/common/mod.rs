//! A small world for the estimator: a body that moves on a smooth curve, landmarks, and a map of them.
#![allow(dead_code)] // Every test file compiles its own copy and uses a part of it.

use estimator::propagation::ImuState;
use estimator::{
    CalibratedCamera, CloneId, Estimator, EstimatorConfig, ImuSample, InitialState, MapAnswer, MapKeyframe,
    MapReport, MatchedLandmark, TrackObservation,
};
use geometry::{Camera, Distortion, Pose, PoseWithCovariance, rotation};
use nalgebra::{Matrix3, Matrix6, Matrix6xX, Rotation3, Vector2, Vector3, Vector6};
use rand::{RngExt as _, SeedableRng, rngs::StdRng};

/// Nanoseconds between two images, and between two IMU readings.
pub const FRAME_NS: i64 = 100_000_000;
pub const IMU_NS: i64 = 5_000_000;
const PIXEL_SIGMA: f64 = 0.7;
const KEYFRAME_SIGMA: f64 = 0.01;

pub struct World {
    pub calibrated: CalibratedCamera,
    landmarks: Vec<Vector3<f64>>,
    /// True `G_T_L`.
    pub global_from_local: Pose,
}

fn normal(rng: &mut StdRng) -> f64 {
    (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0
}

fn pose_at(stamp_ns: i64) -> Pose {
    let t = stamp_ns as f64 * 1e-9;
    let position = Vector3::new(0.4 * t, 1.5 * (0.6 * t).sin(), 0.3 * (0.9 * t).sin());
    Pose::new(rotation::exp(&Vector3::new(0.0, 0.0, 0.3 * (0.5 * t).sin())), position)
}

pub fn imu_at(stamp_ns: i64) -> ImuSample {
    let t = stamp_ns as f64 * 1e-9;
    let acceleration = Vector3::new(0.0, -0.54 * (0.6 * t).sin(), -0.243 * (0.9 * t).sin());
    let force = pose_at(stamp_ns).rotation.inverse() * (acceleration + Vector3::new(0.0, 0.0, 9.81));
    ImuSample { stamp_ns, gyroscope: Vector3::new(0.0, 0.0, 0.15 * (0.5 * t).cos()), accelerometer: force }
}

impl World {
    pub fn new() -> Self {
        let mut rng = StdRng::seed_from_u64(11);
        let axes = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
        let rotation = geometry::Rotation::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
        let camera = Camera {
            width: 640,
            height: 480,
            focal: [400.0; 2],
            centre: [320.0, 240.0],
            distortion: Distortion::None,
        };
        let landmarks = (0..150).map(|_| {
            let mut draw = |low: f64, high: f64| rng.random_range(low..high);
            Vector3::new(draw(7.0, 16.0), draw(-6.0, 6.0), draw(-3.5, 3.5))
        });
        let landmarks = landmarks.collect();
        let turn = rotation::exp(&Vector3::new(0.1, -0.05, 1.2));
        Self {
            calibrated: CalibratedCamera::new(camera, Pose::new(rotation, Vector3::new(0.1, 0.0, 0.05))),
            landmarks,
            global_from_local: Pose::new(turn, Vector3::new(30.0, -12.0, 2.0)),
        }
    }

    /// A filter that starts from the truth, biases included.
    pub fn estimator(&self, mut config: EstimatorConfig) -> Estimator {
        config.initial = config.initial.with_known_biases();
        let imu = ImuState {
            local_from_imu: pose_at(0),
            velocity: Vector3::new(0.4, 0.9, 0.27),
            gyroscope_bias: Vector3::zeros(),
            accelerometer_bias: Vector3::zeros(),
        };
        let initial = InitialState { stamp_ns: 0, imu, covariance: config.initial.covariance() };
        let mut estimator = Estimator::new(config, vec![self.calibrated.clone()], &initial).unwrap();
        estimator.imu(imu_at(0)).unwrap();
        estimator
    }

    pub fn truth(frame: i64) -> Pose {
        pose_at(frame * FRAME_NS)
    }

    pub fn feed_imu(estimator: &mut Estimator, frame: i64) {
        for k in 1..=FRAME_NS / IMU_NS {
            estimator.imu(imu_at((frame - 1) * FRAME_NS + k * IMU_NS)).unwrap();
        }
    }

    fn see(&self, rng: &mut StdRng, local_from_camera: &Pose, landmark: usize) -> Option<Vector2<f64>> {
        let pixel = self
            .calibrated
            .camera
            .project(&local_from_camera.inverse_transform(&self.landmarks[landmark]))
            .ok()?;
        let noisy = pixel + Vector2::new(normal(rng), normal(rng)) * PIXEL_SIGMA;
        self.calibrated.camera.contains(&noisy).then_some(noisy)
    }

    /// What the front end tracks in an image: the same for everybody who asks.
    pub fn tracks(&self, frame: i64) -> Vec<TrackObservation> {
        let mut rng = StdRng::seed_from_u64(1000 + frame as u64);
        let pose = Self::truth(frame) * self.calibrated.imu_from_camera;
        let mut observation = |k| {
            Some(TrackObservation { camera: 0, feature_id: k as u64, pixel: self.see(&mut rng, &pose, k)? })
        };
        (0..self.landmarks.len()).filter_map(&mut observation).collect()
    }

    /// A whole frame: readings, propagation, tracks.
    pub fn frame(&self, estimator: &mut Estimator, frame: i64) -> CloneId {
        Self::feed_imu(estimator, frame);
        let clone = estimator.time_update(frame * FRAME_NS).unwrap();
        estimator.track_update(&self.tracks(frame)).unwrap();
        clone
    }

    /// What the map has to say about an image: two keyframes, `first` and `first + 1`, that were taken
    /// near the image of `map_frame`. The map is the same whenever it is asked.
    pub fn answer(&self, frame: i64, map_frame: i64, first: u64) -> MapAnswer {
        let mut rng = StdRng::seed_from_u64(2000 + frame as u64);
        let mut map_rng = StdRng::seed_from_u64(first);
        let camera_at = |frame: i64| Self::truth(frame) * self.calibrated.imu_from_camera;
        let transformed = camera_at(frame);
        let offsets = [[0.6, -0.3, -0.8], [-0.5, 0.2, 0.3]].map(Vector3::from);
        let poses =
            offsets.map(|offset| camera_at(map_frame) * Pose::new(rotation::exp(&(0.05 * offset)), offset));
        let keyframes = std::iter::zip(first.., poses).map(|(id, pose)| {
            let error = Vector6::from_fn(|_, _| normal(&mut map_rng) * KEYFRAME_SIGMA);
            MapKeyframe {
                id,
                global_from_keyframe: PoseWithCovariance::new(
                    (self.global_from_local * pose).retract(&error),
                    Matrix6::identity() * KEYFRAME_SIGMA.powi(2),
                ),
                camera: self.calibrated.camera.clone(),
                common_error: Matrix6xX::zeros(0),
                cross_covariances: Vec::new(),
            }
        });
        let keyframes: Vec<MapKeyframe> = keyframes.collect();
        let mut landmarks = Vec::new();
        for (k, landmark) in self.landmarks.iter().enumerate() {
            let anchor = k % 2;
            let observations: Vec<_> = (0..2)
                .filter_map(|j| Some((first + j as u64, self.see(&mut map_rng, &poses[j], k)?)))
                .collect();
            let Some(pixel) = self.see(&mut rng, &transformed, k) else { continue };
            if observations.len() == 2 {
                let position_in_anchor = poses[anchor].inverse_transform(landmark) * 1.01;
                landmarks.push(MatchedLandmark {
                    pixel,
                    anchor: first + anchor as u64,
                    position_in_anchor,
                    observations,
                });
            }
        }
        assert!(landmarks.len() > 20, "{} landmarks", landmarks.len());
        MapAnswer {
            map_version: 1,
            map_identity: 1,
            camera: 0,
            keyframes,
            held_at_query: Vec::new(),
            landmarks,
            gravity_in_global: None,
            sigma_map_px: PIXEL_SIGMA,
            log_odds: 10.0,
            log_prior_odds: 0.0,
        }
    }
}

/// All that the filter says of itself, to compare bit by bit.
pub fn says(estimator: &Estimator) -> String {
    let local = estimator.local_from_imu();
    let parts = (
        estimator.velocity(),
        estimator.biases(),
        estimator.global_from_local(),
        estimator.global_from_imu(),
    );
    format!("{} {local:?} {parts:?}", estimator.stamp_ns())
}

/// Asserts that all of it is a number.
pub fn assert_finite(estimator: &Estimator) {
    let mut poses = vec![estimator.local_from_imu()];
    poses.extend(estimator.global_from_local());
    poses.extend(estimator.global_from_imu());
    for pose in poses {
        assert!(pose.pose.is_finite() && pose.covariance.iter().all(|value| value.is_finite()), "{pose:?}");
        assert!(pose.covariance.diagonal().min() >= 0.0, "{pose:?}");
    }
}

pub fn accepted(report: &MapReport) -> bool {
    report.rejection.is_none()
}
