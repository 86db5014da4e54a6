//! An estimator that holds many keyframes of a map, and sees any three of them again.
//!
//! Its body swings from side to side before a wall of points, so that the state is as large as on a robot: 20 clones and
//! 30 SLAM features.

use estimator::propagation::ImuState;
use estimator::{
    CalibratedCamera, ChangeSize, CloneId, Estimator, EstimatorConfig, ImuSample, InitialSigmas,
    InitialState, MapAnswer, MapKeyframe, MapRevision, MatchedLandmark, RevisionEffect, TrackObservation,
};
use geometry::{Camera, Distortion, Pose, PoseWithCovariance, rotation};
use nalgebra::{Matrix3, Matrix6, Matrix6xX, Rotation3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng, rngs::StdRng};
use std::time::{Duration, Instant};

/// Time between two images and between two readings, nanoseconds.
const FRAME_NS: i64 = 100_000_000;
const IMU_NS: i64 = 5_000_000;
/// Landmarks of a query result.
const LANDMARKS: usize = 36;
/// Keyframes that are matched at once.
const MATCHED: usize = 3;
/// Images from one map update to the next, as at 20 images and 5 updates a second.
pub const FRAMES_BETWEEN: usize = 4;
/// Keyframes inserted by one map update at the start.
const PULLED: usize = 6;
/// Standard deviation of a keyframe, rad and metres.
const KEYFRAME_SIGMA: f64 = 0.01;
/// Points that are tracked, the landmarks of the query results among them.
const POINTS: usize = 100;
/// Images after which the track of any other point ends and a new one begins.
const TRACK_LENGTH: usize = 12;
/// The swing: metres, rad/s.
const AMPLITUDE: f64 = 0.5;
const RATE: f64 = 1.0;

/// A body that looks at points, and keyframes around it that saw the same points.
pub struct Holder {
    estimator: Estimator,
    eye: CalibratedCamera,
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
        let eye = CalibratedCamera::new(camera, Pose::new(forward, Vector3::new(0.1, 0.0, 0.0)));
        let mut draw = |half: f64| rng.random_range(-half..half);
        let points = (0..POINTS).map(|_| Vector3::new(12.0 + draw(4.0), draw(4.0), draw(2.5))).collect();
        let near = |_| {
            let turn = Vector3::new(draw(0.05), draw(0.05), draw(0.05));
            Pose::new(rotation::exp(&turn), Vector3::new(draw(1.0), draw(1.0), draw(0.5)))
                * eye.imu_from_camera
        };
        let keyframes = (0..count).map(near).collect();
        let imu = ImuState {
            local_from_imu: Pose::identity(),
            velocity: Vector3::new(0.0, AMPLITUDE * RATE, 0.0),
            gyroscope_bias: Vector3::zeros(),
            accelerometer_bias: Vector3::zeros(),
        };
        let upright = Pose::identity();
        let gravity = -Vector3::z();
        let initial =
            InitialState::from_truth(0, &upright, &imu.velocity, &gravity, InitialSigmas::default());
        let mut config = EstimatorConfig::default();
        config.max_held_keyframes = 2 * count.max(100);
        let mut estimator = Estimator::new(config, vec![eye.clone()], &initial).unwrap();
        estimator.imu(reading(0)).unwrap();
        let newest = estimator.time_update(0).unwrap();
        let mut holder = Self { estimator, eye, points, keyframes, stamp_ns: 0, newest, rng };
        for first in (0..count).step_by(PULLED) {
            holder.frames();
            let pulled: Vec<usize> = (first..count.min(first + PULLED)).collect();
            holder.take(&pulled);
        }
        assert_eq!(holder.estimator.held_keyframes().len(), count);
        (0..EstimatorConfig::default().window).for_each(|_| holder.frame());
        holder
    }

    /// Bytes for each held keyframe.
    pub fn bytes_each(&self) -> usize {
        self.estimator.held_bytes() / self.keyframes.len()
    }

    /// The images until the next map update.
    pub fn frames(&mut self) {
        (0..FRAMES_BETWEEN).for_each(|_| self.frame());
    }

    /// The next image.
    pub fn frame(&mut self) {
        for _ in 0..FRAME_NS / IMU_NS {
            self.stamp_ns += IMU_NS;
            self.estimator.imu(reading(self.stamp_ns)).unwrap();
        }
        self.newest = self.estimator.time_update(self.stamp_ns).unwrap();
        let (camera, frame) = (self.camera(), (self.stamp_ns / FRAME_NS) as usize);
        let tracks: Vec<TrackObservation> = self
            .points
            .iter()
            .enumerate()
            .map(|(k, point)| {
                // Tracks of different points end in different images.
                let generation = if k < LANDMARKS { 0 } else { (frame + k) / TRACK_LENGTH };
                let pixel = self.eye.camera.project(&camera.inverse_transform(point)).unwrap();
                TrackObservation { feature_id: (k + generation * POINTS) as u64, camera: 0, pixel }
            })
            .collect();
        self.estimator.track_update(&tracks).unwrap();
    }

    /// A map update with three of the held keyframes, drawn at random.
    pub fn map_update(&mut self) {
        let count = self.keyframes.len();
        let mut matched: Vec<usize> = Vec::with_capacity(MATCHED);
        while matched.len() < MATCHED {
            let any = self.rng.random_range(0..count);
            if !matched.contains(&any) {
                matched.push(any);
            }
        }
        self.take(&matched);
    }

    /// Time in which a copy invalidates all its keyframes.
    pub fn invalidate_all(&self) -> Duration {
        let mut estimator = self.estimator.clone();
        let changed = MapRevision {
            from_version: 1,
            version: 2,
            changed_keyframes: estimator.held_keyframes(),
            size: Some(ChangeSize { sigma_rotation_rad: 1e-3, sigma_position_m: 1e-2 }),
            keyframe_motions: Vec::new(),
        };
        let begin = Instant::now();
        let effect = estimator.map_changed(&changed);
        let duration = begin.elapsed();
        assert_eq!((effect, estimator.held_keyframes().len()), (RevisionEffect::CarriedOver, 0));
        duration
    }

    fn camera(&self) -> Pose {
        body_at(self.stamp_ns) * self.eye.imu_from_camera
    }

    /// Each landmark is seen by up to three of the keyframes; the first one anchors them all.
    fn take(&mut self, keyframes: &[usize]) {
        let camera_now = self.camera();
        let pixel = |camera: &Pose, point: &Vector3<f64>| {
            self.eye.camera.project(&camera.inverse_transform(point)).unwrap()
        };
        let landmarks = self.points[..LANDMARKS].iter().enumerate().map(|(k, point)| {
            let others = keyframes.len() - 1;
            let further =
                (0..others.min(MATCHED - 1)).map(|j| keyframes[1 + (k * (MATCHED - 1) + j) % others]);
            let observers: Vec<usize> = std::iter::once(keyframes[0]).chain(further).collect();
            MatchedLandmark {
                pixel: pixel(&camera_now, point),
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
            common_error: Matrix6xX::zeros(0),
            cross_covariances: Vec::new(),
        });
        let answer = MapAnswer {
            map_version: 1,
            map_identity: 1,
            camera: 0,
            keyframes: stated.collect(),
            held_at_query: Vec::new(),
            landmarks: landmarks.collect(),
            gravity_in_global: Some(-Vector3::z()),
            sigma_map_px: 1.0,
            log_odds: 10.0,
            log_prior_odds: 0.0,
        };
        let report = self.estimator.map_update(self.newest, &answer).unwrap();
        assert_eq!(report.rejection, None);
    }
}

fn body_at(stamp_ns: i64) -> Pose {
    let phase = RATE * stamp_ns as f64 * 1e-9;
    Pose::new(rotation::exp(&Vector3::zeros()), Vector3::new(0.0, AMPLITUDE * phase.sin(), 0.0))
}

fn reading(stamp_ns: i64) -> ImuSample {
    let phase = RATE * stamp_ns as f64 * 1e-9;
    let sideways = -AMPLITUDE * RATE * RATE * phase.sin();
    ImuSample { stamp_ns, gyroscope: Vector3::zeros(), accelerometer: Vector3::new(0.0, sideways, 9.81) }
}
