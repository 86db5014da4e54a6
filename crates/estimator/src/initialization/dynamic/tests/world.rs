//! A simulated body that oscillates before a wall of landmarks.

use crate::calibration::CalibratedCamera;
use crate::config::EstimatorConfig;
use crate::imu::ImuBuffer;
use crate::initialization::dynamic::{Window, WindowImage};
use crate::propagation::ImuState;
use geometry::rotation::{exp, log};
use geometry::{Camera, Distortion, Pose};
use nalgebra::{Vector2, Vector3};
use rand::{RngExt as _, SeedableRng, rngs::StdRng};
use types::{ImuSample, TrackObservation};

const IMU_NS: i64 = 5_000_000;
const IMAGE_NS: i64 = 100_000_000;
const SECONDS: f64 = 1.8;

/// What one run of the world is like.
#[derive(Clone, Copy)]
pub struct Run {
    pub seed: u64,
    pub stereo: bool,
    /// Size of the accelerations, m/s^2; 0 is constant velocity.
    pub shaken: f64,
    /// Size of the noise of pixels, readings and biases; 0 is none.
    pub noise: f64,
    /// Part of the pixels that are 10 to 50 px off.
    pub outliers: f64,
    /// The biases are as large as unknown ones.
    pub unknown_biases: bool,
    /// One more camera, the first one, sees nothing: it is covered.
    pub covered_first: bool,
}

pub const USUAL: Run = Run {
    seed: 1,
    stereo: false,
    shaken: 1.5,
    noise: 1.0,
    outliers: 0.0,
    unknown_biases: false,
    covered_first: false,
};

pub fn normal(rng: &mut StdRng) -> f64 {
    (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0
}

pub fn vector(rng: &mut StdRng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| normal(rng))
}

pub fn calibrated_cameras(stereo: bool) -> Vec<CalibratedCamera> {
    let camera = Camera {
        width: 752,
        height: 480,
        focal: [458.0, 457.0],
        centre: [370.0, 245.0],
        distortion: Distortion::RadialTangential([-0.28, 0.07, 2e-4, 2e-5]),
    };
    let turn = exp(&Vector3::new(0.1, -0.2, 1.5));
    let calibrated =
        |x: f64| CalibratedCamera::new(camera.clone(), Pose::new(turn, Vector3::new(x, 0.02, 0.01)));
    if stereo { vec![calibrated(-0.02), calibrated(0.09)] } else { vec![calibrated(-0.02)] }
}

/// A motion, its readings and what it sees.
pub struct World {
    pub window: Window,
    pub cameras: Vec<CalibratedCamera>,
    pub config: EstimatorConfig,
    /// At the newest image, in axes with z up.
    pub truth: ImuState,
    /// At the first image, body and velocity.
    pub first: ImuState,
}

/// The body in axes with z up.
struct Motion {
    turn: Vector3<f64>,
    swing: Vector3<f64>,
    velocity: Vector3<f64>,
    shake: Vector3<f64>,
    phase: Vector3<f64>,
}

/// Angular frequency of the motion, rad/s.
const RATE: f64 = 2.2;

impl Motion {
    fn pose(&self, t: f64) -> Pose {
        let angles =
            self.turn + self.swing.zip_map(&self.phase, |size, phase| size * (RATE * t + phase).sin());
        let shake =
            self.shake.zip_map(&self.phase, |size, phase| -size / RATE.powi(2) * (RATE * t + phase).sin());
        Pose::new(exp(&angles), self.velocity * t + shake)
    }

    fn velocity(&self, t: f64) -> Vector3<f64> {
        self.velocity + self.shake.zip_map(&self.phase, |size, phase| -size / RATE * (RATE * t + phase).cos())
    }

    fn reading(&self, stamp_ns: i64, gravity: f64) -> ImuSample {
        let t = stamp_ns as f64 * 1e-9;
        let acceleration = self.shake.zip_map(&self.phase, |size, phase| size * (RATE * t + phase).sin());
        let rotation = self.pose(t).rotation;
        let h = 1e-4;
        let gyroscope = log(&(self.pose(t - h).rotation.inverse() * self.pose(t + h).rotation)) / (2.0 * h);
        let force = rotation.inverse() * (acceleration + Vector3::new(0.0, 0.0, gravity));
        ImuSample { stamp_ns, gyroscope, accelerometer: force }
    }
}

pub fn world(run: Run) -> World {
    let mut rng = StdRng::seed_from_u64(run.seed);
    let mut config = EstimatorConfig::default();
    if !run.unknown_biases {
        config.initial = config.initial.with_known_biases();
    }
    let motion = Motion {
        turn: vector(&mut rng) * 0.5,
        swing: vector(&mut rng) * 0.15,
        velocity: vector(&mut rng).normalize(),
        shake: vector(&mut rng) * run.shaken,
        phase: vector(&mut rng) * 3.0,
    };
    let gyroscope_bias = vector(&mut rng) * (config.initial.sigma_gyroscope_bias_rad_s * run.noise);
    let accelerometer_bias = vector(&mut rng) * (config.initial.sigma_accelerometer_bias_m_s2 * run.noise);
    let mut imu = ImuBuffer::default();
    let per_reading = run.noise / (IMU_NS as f64 * 1e-9).sqrt();
    for k in -2..=((SECONDS * 1e9) as i64 / IMU_NS + 2) {
        let clean = motion.reading(k * IMU_NS, config.gravity);
        let noise = &config.imu_noise;
        imu.push(ImuSample {
            stamp_ns: clean.stamp_ns,
            gyroscope: clean.gyroscope + gyroscope_bias + vector(&mut rng) * (noise.gyroscope * per_reading),
            accelerometer: clean.accelerometer
                + accelerometer_bias
                + vector(&mut rng) * (noise.accelerometer * per_reading),
        })
        .unwrap();
    }
    let mut cameras = calibrated_cameras(run.stereo);
    let middle = motion.pose(0.5 * SECONDS) * cameras[0].imu_from_camera;
    let covered = usize::from(run.covered_first);
    if run.covered_first {
        let turned = Pose::new(exp(&Vector3::new(0.0, 2.0, 0.0)), Vector3::zeros());
        cameras.insert(0, CalibratedCamera::new(cameras[0].camera.clone(), turned));
    }
    let points: Vec<Vector3<f64>> = (0..120)
        .map(|_| {
            let z = rng.random_range(3.0..9.0);
            middle.transform(&Vector3::new(
                rng.random_range(-0.7..0.7) * z,
                rng.random_range(-0.45..0.45) * z,
                z,
            ))
        })
        .collect();
    let mut images = Vec::new();
    for k in 0..=((SECONDS * 1e9) as i64 / IMAGE_NS) {
        let body = motion.pose((k * IMAGE_NS) as f64 * 1e-9);
        let mut tracks = Vec::new();
        for (camera, calibrated) in cameras.iter().enumerate().skip(covered) {
            for (name, point) in points.iter().enumerate() {
                let Ok(pixel) =
                    calibrated.camera.project(&(body * calibrated.imu_from_camera).inverse_transform(point))
                else {
                    continue;
                };
                let mut pixel = pixel + Vector2::new(normal(&mut rng), normal(&mut rng)) * run.noise;
                if rng.random::<f64>() < run.outliers {
                    let angle: f64 = rng.random_range(0.0..std::f64::consts::TAU);
                    pixel += Vector2::new(angle.cos(), angle.sin()) * rng.random_range(10.0..50.0);
                }
                if calibrated.camera.contains(&pixel) {
                    tracks.push(TrackObservation { camera: camera as u8, feature_id: name as u64, pixel });
                }
            }
        }
        images.push(WindowImage { stamp_ns: k * IMAGE_NS, tracks });
    }
    let state = |t: f64| ImuState {
        local_from_imu: motion.pose(t),
        velocity: motion.velocity(t),
        gyroscope_bias,
        accelerometer_bias,
    };
    let window = Window::new(&images, &imu, &cameras).unwrap();
    World { window, cameras, config, truth: state(SECONDS), first: state(0.0) }
}
