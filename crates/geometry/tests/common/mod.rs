//! Seeded random scenes that the tests of this crate share.
#![allow(dead_code, clippy::unreadable_literal)]

use geometry::{Camera, Distortion, Pose, rotation};
use nalgebra::{SVector, Vector2, Vector3};
use rand::rngs::Xoshiro256PlusPlus;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;

/// A generator of random numbers for tests.
pub struct Random(Xoshiro256PlusPlus);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(Xoshiro256PlusPlus::seed_from_u64(seed))
    }

    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        self.0.random_range(low..high)
    }

    pub fn index(&mut self, count: usize) -> usize {
        self.0.random_range(0..count)
    }

    pub fn normal(&mut self) -> f64 {
        self.0.sample(StandardNormal)
    }

    pub fn normal_vector<const N: usize>(&mut self) -> SVector<f64, N> {
        SVector::from_fn(|_, _| self.normal())
    }

    pub fn vector(&mut self, size: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.uniform(-size, size))
    }

    /// Any orientation, a position within `size` metres.
    pub fn pose(&mut self, size: f64) -> Pose {
        Pose::new(rotation::exp(&self.vector(2.0)), self.vector(size))
    }

    /// A pixel of the image.
    pub fn pixel(&mut self, camera: &Camera) -> Vector2<f64> {
        Vector2::new(self.uniform(0.0, f64::from(camera.width)), self.uniform(0.0, f64::from(camera.height)))
    }

    /// A point in the camera frame that the camera sees, at a depth (metres) in the range.
    pub fn visible_point(&mut self, camera: &Camera, near: f64, far: f64) -> Vector3<f64> {
        let normalized = loop {
            // The corners of a fisheye image see nothing.
            if let Ok(normalized) = camera.unproject(&self.pixel(camera)) {
                break normalized;
            }
        };
        Vector3::new(normalized.x, normalized.y, 1.0) * self.uniform(near, far)
    }
}

/// cam0 of the EuRoC recordings.
pub fn euroc() -> Camera {
    Camera {
        width: 752,
        height: 480,
        focal: [458.654, 457.296],
        centre: [367.215, 248.375],
        distortion: Distortion::RadialTangential([-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]),
    }
}

/// A wide camera with the FOV model.
pub fn fov() -> Camera {
    Camera {
        width: 640,
        height: 480,
        focal: [257.67, 257.67],
        centre: [319.5, 239.5],
        distortion: Distortion::Fov(0.932),
    }
}

/// A fisheye camera of the TUM-VI kind.
pub fn fisheye() -> Camera {
    Camera {
        width: 512,
        height: 512,
        focal: [190.978, 190.973],
        centre: [254.93, 256.897],
        distortion: Distortion::Equidistant([0.003482389, 0.000715034, -0.002053236, 0.000202937]),
    }
}

/// A camera without distortion.
pub fn pinhole() -> Camera {
    Camera {
        width: 640,
        height: 480,
        focal: [500.0, 510.0],
        centre: [320.0, 240.0],
        distortion: Distortion::None,
    }
}

fn square(focal: f64, distortion: Distortion) -> Camera {
    Camera { width: 512, height: 512, focal: [focal, focal + 0.4], centre: [254.96, 256.89], distortion }
}

/// A webcam with k3.
pub fn webcam() -> Camera {
    let distortion = Distortion::from_opencv(&[0.1147, -0.2327, 0.0007, -0.0003, 0.1094]).unwrap();
    Camera { width: 1280, height: 720, focal: [910.2, 909.8], centre: [641.7, 359.1], distortion }
}

/// A time-of-flight camera, with the rational model.
pub fn time_of_flight() -> Camera {
    let coefficients = [4.4437, 2.6371, 2.1e-5, 4.1e-5, 0.1350, 4.7707, 3.9256, 0.6871];
    let distortion = Distortion::from_opencv(&coefficients).unwrap();
    Camera { width: 640, height: 576, focal: [504.1, 504.2], centre: [321.4, 331.2], distortion }
}

/// All twelve coefficients of OpenCV.
pub fn thin_prism() -> Camera {
    let k = [-0.21, 0.05, 1e-3, -7e-4, -0.004, 0.02, 0.01, 0.003, 1.2e-3, -4e-4, 8e-4, 3e-4];
    Camera { distortion: Distortion::Rational(k), ..euroc() }
}

/// COLMAP's fisheye with a thin prism.
pub fn thin_prism_fisheye() -> Camera {
    let k = [-0.0402, 0.0116, 2.1e-4, -3.9e-4, -0.0043, 0.0008, 6.1e-4, -9.3e-4];
    square(190.9, Distortion::ThinPrismFisheye(k))
}

/// A fisheye of the TUM-VI kind with the double sphere model.
pub fn double_sphere() -> Camera {
    square(158.28, Distortion::DoubleSphere { xi: -0.172, alpha: 0.593 })
}

/// The same with the extended unified model.
pub fn eucm() -> Camera {
    square(190.9, Distortion::Eucm { alpha: 0.629, beta: 1.045 })
}

/// A wide-angle camera as Kalibr calibrates it with the omnidirectional model.
pub fn omni() -> Camera {
    let distortion = Distortion::Omni { xi: 1.8476, distortion: [-0.0655, 0.4195, -0.0012, 0.0008] };
    Camera { width: 752, height: 480, focal: [1333.3, 1332.1], centre: [343.9, 221.3], distortion }
}

/// One camera of each model.
pub fn cameras() -> [Camera; 11] {
    [
        pinhole(),
        euroc(),
        fisheye(),
        fov(),
        webcam(),
        time_of_flight(),
        thin_prism(),
        thin_prism_fisheye(),
        double_sphere(),
        eucm(),
        omni(),
    ]
}
