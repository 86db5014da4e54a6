//! From light to grey levels.

use rand::SeedableRng;
use rand::rngs::StdRng;
use rand_distr::{Distribution, StandardNormal};
use vision::GrayImage;

/// What falls on the pixels of a sensor, in grey levels at a gain of one, not rounded.
#[derive(Clone, Debug, PartialEq)]
pub struct Radiance {
    width: usize,
    height: usize,
    /// Row after row.
    pub(crate) values: Vec<f32>,
}

impl Radiance {
    pub(crate) fn black(width: usize, height: usize) -> Self {
        Self { width, height, values: vec![0.0; width * height] }
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// The value in column `x` and row `y`.
    ///
    /// # Panics
    /// If the pixel lies outside the image.
    pub fn at(&self, x: usize, y: usize) -> f32 {
        assert!(x < self.width && y < self.height, "({x}, {y}) is outside of the image");
        self.values[y * self.width + x]
    }
}

/// What a camera that moves during the exposure sees: the mean of some instants.
///
/// # Arguments
/// * `instants`: number of instants, spread evenly over the exposure; at least one is taken.
/// * `render`: what is seen at a part of the exposure, from -0.5 (begin) to 0.5 (end).
///
/// # Example
/// ```
/// # use geometry::{Camera, Distortion, Pose};
/// # use rendering::{Body, CameraRays, PlacedBody};
/// # let room = Body::room([2.0, 2.0, 2.0], 1);
/// # let camera = Camera { width: 16, height: 16, focal: [8.0; 2], centre: [8.0; 2], distortion: Distortion::None };
/// # let rays = CameraRays::new(&camera);
/// # let scene = [PlacedBody { world_from_body: Pose::identity(), body: &room }];
/// let start = Pose::identity();
/// let end = Pose::new(start.rotation, nalgebra::Vector3::new(0.01, 0.0, 0.0));
/// let blurred =
///     rendering::exposed(3, |part| rendering::render(&scene, &rays, &start.interpolate(&end, part + 0.5)));
/// ```
pub fn exposed(instants: usize, mut render: impl FnMut(f64) -> Radiance) -> Radiance {
    let instants = instants.max(1);
    let part = |instant: usize| (instant as f64 + 0.5) / instants as f64 - 0.5;
    let mut sum = render(part(0));
    for instant in 1..instants {
        let next = render(part(instant));
        for (sum, value) in sum.values.iter_mut().zip(&next.values) {
            *sum += value;
        }
    }
    let share = 1.0 / instants as f32;
    for value in &mut sum.values {
        *value *= share;
    }
    sum
}

/// An image sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensor {
    /// Factor on what falls on the pixels: exposure and gain.
    pub gain: f32,
    /// Standard deviation of a pixel's noise, grey levels.
    pub sigma_noise: f32,
}

impl Default for Sensor {
    /// A gain of one, and noise of two grey levels.
    fn default() -> Self {
        Self { gain: 1.0, sigma_noise: 2.0 }
    }
}

impl Sensor {
    /// The image: amplified, with noise, in grey levels from 0 to 255.
    ///
    /// # Arguments
    /// * `noise_seed`: of this image; the same seed gives the same noise.
    pub fn image(&self, seen: &Radiance, noise_seed: u64) -> GrayImage {
        let mut rng = StdRng::seed_from_u64(noise_seed);
        let mut grey = |value: f32| {
            let noise: f32 = StandardNormal.sample(&mut rng);
            (self.gain * value + self.sigma_noise * noise).round().clamp(0.0, 255.0) as u8
        };
        GrayImage::from_fn(seen.width, seen.height, |x, y| grey(seen.values[y * seen.width + x]))
    }
}
