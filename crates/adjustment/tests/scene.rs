//! A small random place.

use adjustment::{
    InverseDepthLandmark, LandmarkObservation, Loss, MAPPED_INVERSE_DEPTHS, MountedCamera, PixelModel,
};
use geometry::camera::{Camera, Distortion};
use geometry::{Pose, rotation};
use nalgebra::{Vector2, Vector3};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

pub const SIGMA_PX: f64 = 1.5;

pub fn camera() -> Camera {
    let distortion = Distortion::RadialTangential([-0.28, 0.07, 2e-4, 2e-5]);
    Camera { width: 752, height: 480, focal: [458.0, 457.0], centre: [367.0, 248.0], distortion }
}

pub fn vector(rng: &mut StdRng, size: f64) -> Vector3<f64> {
    Vector3::from_fn(|_, _| size * rng.random_range(-1.0..1.0))
}

pub fn pose(rng: &mut StdRng, angle: f64, distance: f64) -> Pose {
    Pose::new(rotation::exp(&vector(rng, angle)), vector(rng, distance))
}

/// Two cameras on a body, neither of them in its origin.
pub fn cameras(rng: &mut StdRng) -> Vec<MountedCamera> {
    (0..2).map(|_| MountedCamera::new(camera(), &pose(rng, 0.1, 0.1))).collect()
}

pub fn pixel_model(loss: Loss) -> PixelModel {
    PixelModel {
        sigma_px: SIGMA_PX,
        loss,
        depth_information: 1e-6,
        inverse_depths: MAPPED_INVERSE_DEPTHS,
        landmark_steps: 0,
    }
}

/// Views of a wall, and its landmarks with exact pixels in both cameras. Each landmark is anchored in another observation.
pub struct Scene {
    pub cameras: Vec<MountedCamera>,
    pub poses: Vec<Pose>,
    pub landmarks: Vec<InverseDepthLandmark>,
}

impl Scene {
    pub fn new(seed: u64, views: usize, landmarks: usize) -> Scene {
        let mut rng = StdRng::seed_from_u64(seed);
        let cameras = cameras(&mut rng);
        let poses: Vec<Pose> = (0..views).map(|_| pose(&mut rng, 0.1, 0.8)).collect();
        let landmark = |index: usize| {
            let point = Vector3::new(
                rng.random_range(-1.5..1.5),
                rng.random_range(-1.0..1.0),
                rng.random_range(4.0..8.0),
            );
            let seen = |number: usize| {
                let (view, camera) = (number / cameras.len(), number % cameras.len());
                let MountedCamera { camera: lens, rotation, offset, .. } = &cameras[camera];
                let in_camera = rotation * poses[view].inverse_transform(&point) + offset;
                let pixel = lens.project(&in_camera).unwrap();
                (
                    LandmarkObservation { feature: (view, index), camera, is_second: camera > 0, pixel },
                    in_camera,
                )
            };
            let all: Vec<_> = (0..views * cameras.len()).map(seen).collect();
            let anchor = index % all.len();
            let p = all[anchor].1;
            InverseDepthLandmark {
                anchor,
                ray: Vector2::new(p.x / p.z, p.y / p.z),
                inverse_depth: p.z.recip(),
                observations: all.into_iter().map(|(observation, _)| observation).collect(),
                prior: None,
            }
        };
        let landmarks = (0..landmarks).map(landmark).collect();
        Scene { cameras, poses, landmarks }
    }

    /// With noise of the pixels, in standard deviations of a pixel: uniform, with the same variance.
    pub fn noisy(mut self, seed: u64, sigmas: f64) -> Scene {
        let mut rng = StdRng::seed_from_u64(seed);
        for observation in self.landmarks.iter_mut().flat_map(|landmark| &mut landmark.observations) {
            observation.pixel += vector(&mut rng, sigmas * SIGMA_PX * 3_f64.sqrt()).xy();
        }
        self
    }
}
