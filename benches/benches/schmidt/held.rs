//! An estimator that holds many keyframes of a map, and sees any three of them again.

use geometry::{Camera, Distortion, Pose, PoseWithCovariance, rotation};
use nalgebra::{Matrix3, Matrix6, Rotation3, UnitQuaternion, Vector3};
use onboard::estimator::propagation::ImuState;
use onboard::estimator::{
    CloneId, Estimator, EstimatorConfig, ImuSample, InitialSigmas, InitialState, MapAnswer, MapKeyframe,
    MatchedLandmark, RigCamera,
};
use rand::{RngExt, SeedableRng, rngs::StdRng};

/// Time between two images and between two readings, nanoseconds.
const FRAME_NS: i64 = 100_000_000;
const IMU_NS: i64 = 5_000_000;
/// Landmarks of an answer.
const LANDMARKS: usize = 36;
/// Keyframes that are matched at once.
const MATCHED: usize = 3;
/// Keyframes that an answer brings while the map is being pulled in.
const PULLED: usize = 30;
/// Standard deviation of a keyframe, rad and metres.
const KEYFRAME_SIGMA: f64 = 0.01;

/// A body at rest that looks at points, and keyframes around it that saw the same points.
pub struct Holder {
    estimator: Estimator,
    eye: RigCamera,
    points: Vec<Vector3<f64>>,
    keyframes: Vec<Pose>,
    stamp_ns: i64,
    newest: CloneId,
    rng: StdRng,
}

impl Holder {
    /// Holds `count` keyframes, with a full window of clones.
    pub fn new(count: usize) -> Self {
        let mut rng = StdRng::seed_from_u64(5);
        let axes = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
        let forward = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
        let camera = Camera {
            width: 752,
            height: 480,
            focal: [458.0; 2],
            centre: [375.5, 239.5],
            distortion: Distortion::None,
        };
        let eye = RigCamera { camera, imu_from_camera: Pose::new(forward, Vector3::new(0.1, 0.0, 0.0)) };
        let mut draw = |half: f64| rng.random_range(-half..half);
        let points = (0..LANDMARKS).map(|_| Vector3::new(12.0 + draw(4.0), draw(4.0), draw(2.5))).collect();
        let near = |_| {
            let turn = Vector3::new(draw(0.05), draw(0.05), draw(0.05));
            Pose::new(rotation::exp(&turn), Vector3::new(draw(1.0), draw(1.0), draw(0.5)))
                * eye.imu_from_camera
        };
        let keyframes = (0..count).map(near).collect();
        let imu = ImuState {
            local_from_imu: Pose::identity(),
            velocity: Vector3::zeros(),
            gyroscope_bias: Vector3::zeros(),
            accelerometer_bias: Vector3::zeros(),
        };
        let upright = Pose::identity();
        let gravity = -Vector3::z();
        let initial =
            InitialState::from_truth(0, &upright, &imu.velocity, &gravity, InitialSigmas::default());
        let mut estimator = Estimator::new(EstimatorConfig::default(), vec![eye.clone()], &initial).unwrap();
        estimator.imu(at_rest(0)).unwrap();
        let newest = estimator.time_update(0).unwrap();
        let mut holder = Self { estimator, eye, points, keyframes, stamp_ns: 0, newest, rng };
        for first in (0..count).step_by(PULLED) {
            holder.frame();
            let pulled: Vec<usize> = (first..count.min(first + PULLED)).collect();
            holder.take(&pulled);
        }
        assert_eq!(holder.estimator.held_keyframes().len(), count);
        (0..EstimatorConfig::default().window).for_each(|_| holder.frame());
        holder
    }

    /// The next image, without tracks.
    pub fn frame(&mut self) {
        for _ in 0..FRAME_NS / IMU_NS {
            self.stamp_ns += IMU_NS;
            self.estimator.imu(at_rest(self.stamp_ns)).unwrap();
        }
        self.newest = self.estimator.time_update(self.stamp_ns).unwrap();
        self.estimator.track_update(&[]).unwrap();
    }

    /// An answer with any three of the held keyframes.
    pub fn map_update(&mut self) {
        let count = self.keyframes.len();
        let first = self.rng.random_range(0..count);
        let matched: Vec<usize> = (0..MATCHED).map(|k| (first + k * count / MATCHED) % count).collect();
        self.take(&matched);
    }

    /// Each landmark is seen by up to three of the keyframes; the first one anchors them all.
    fn take(&mut self, keyframes: &[usize]) {
        let camera_at_rest = self.eye.imu_from_camera;
        let pixel = |camera: &Pose, point: &Vector3<f64>| {
            self.eye.camera.project(&camera.inverse_transform(point)).unwrap()
        };
        let landmarks = self.points.iter().enumerate().map(|(k, point)| {
            let others = keyframes.len() - 1;
            let further =
                (0..others.min(MATCHED - 1)).map(|j| keyframes[1 + (k * (MATCHED - 1) + j) % others]);
            let observers: Vec<usize> = std::iter::once(keyframes[0]).chain(further).collect();
            MatchedLandmark {
                pixel: pixel(&camera_at_rest, point),
                anchor: keyframes[0] as u64,
                position_in_anchor: self.keyframes[keyframes[0]].inverse_transform(point),
                observations: observers
                    .iter()
                    .map(|&seen_by| (seen_by as u64, pixel(&self.keyframes[seen_by], point)))
                    .collect(),
            }
        });
        let stated = keyframes.iter().map(|&keyframe| MapKeyframe {
            id: keyframe as u64,
            global_from_keyframe: PoseWithCovariance::new(
                self.keyframes[keyframe],
                Matrix6::identity() * KEYFRAME_SIGMA.powi(2),
            ),
            camera: self.eye.camera.clone(),
            cross_covariances: Vec::new(),
        });
        let answer = MapAnswer {
            map_version: 1,
            keyframes: stated.collect(),
            asked_with: Vec::new(),
            landmarks: landmarks.collect(),
            gravity_in_global: Some(-Vector3::z()),
            sigma_map_px: 1.0,
        };
        let report = self.estimator.map_update(self.newest, &answer).unwrap();
        assert_eq!(report.rejection, None);
    }
}

fn at_rest(stamp_ns: i64) -> ImuSample {
    ImuSample { stamp_ns, gyroscope: Vector3::zeros(), accelerometer: Vector3::new(0.0, 0.0, 9.81) }
}
