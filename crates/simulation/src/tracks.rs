//! The odometry front end: tracks of the visible landmarks in both cameras, with pixel noise.

use super::SimulationOptions;
use super::exposure::Exposure;
use super::random::{Purpose, normal, stream};
use super::world::Landmark;
use nalgebra::Vector2;
use rand::RngExt;
use rand::rngs::StdRng;
use rand::seq::SliceRandom;
use sensors::{CameraSensor, TrackObservation};
use std::collections::BTreeMap;

/// Probability that a track is lost, a frame.
const LOSS: f64 = 0.01;
/// Files give pixels to this fraction.
const PIXEL_PARTS: f64 = 1000.0;

/// The front end, between two images.
pub(crate) struct FrontEnd<'a> {
    options: &'a SimulationOptions,
    rng: StdRng,
    /// Landmark of each track that is alive, and the track's id.
    alive: BTreeMap<usize, u64>,
    next_id: u64,
}

impl<'a> FrontEnd<'a> {
    pub(crate) fn new(options: &'a SimulationOptions, run: u64) -> Self {
        let rng = stream(options.seed, run, Purpose::Tracks);
        Self { options, rng, alive: BTreeMap::new(), next_id: 0 }
    }

    /// Tracks into the next image. A landmark that comes back after a gap gets a new id, as from a real tracker.
    pub(crate) fn track(
        &mut self,
        exposure: &Exposure<'_>,
        cameras: &[CameraSensor],
        landmarks: &[Landmark],
    ) -> Vec<TrackObservation> {
        let seen = visible(self.options, exposure, &cameras[0], landmarks);
        let pixels: BTreeMap<usize, Vector2<f64>> = seen.iter().copied().collect();
        let rng = &mut self.rng;
        self.alive.retain(|landmark, _| pixels.contains_key(landmark) && !rng.random_bool(LOSS));
        let mut fresh: Vec<usize> = seen
            .iter()
            .map(|(landmark, _)| *landmark)
            .filter(|landmark| !self.alive.contains_key(landmark))
            .collect();
        fresh.shuffle(&mut self.rng);
        fresh.truncate(self.options.max_tracks.saturating_sub(self.alive.len()));
        for landmark in fresh {
            self.alive.insert(landmark, self.next_id);
            self.next_id += 1;
        }
        let mut observations = Vec::with_capacity(2 * self.alive.len());
        for (camera, sensor) in cameras.iter().enumerate() {
            for (landmark, feature_id) in &self.alive {
                let exact = exposure.project(sensor, &landmarks[*landmark].position);
                let noisy = exact.map(|pixel| measured(&mut self.rng, self.options, pixel));
                if let Some(pixel) = noisy.filter(|pixel| sensor.camera.contains(pixel)) {
                    observations.push(TrackObservation {
                        camera: camera as u8,
                        feature_id: *feature_id,
                        pixel,
                    });
                }
            }
        }
        observations
    }
}

/// A measured pixel: with noise, or an outlier.
fn measured(rng: &mut StdRng, options: &SimulationOptions, pixel: Vector2<f64>) -> Vector2<f64> {
    let mut noise = Vector2::new(normal(rng), normal(rng)) * options.sigma_track_px;
    if options.outlier_fraction > 0.0 && rng.random_bool(options.outlier_fraction) {
        let (angle, far) = (rng.random_range(0.0..std::f64::consts::TAU), rng.random_range(10.0..50.0));
        noise += Vector2::new(angle.cos(), angle.sin()) * far;
    }
    rounded(pixel + noise)
}

/// To the precision of a file, so that a run in memory and one from disk are the same.
pub(crate) fn rounded(pixel: Vector2<f64>) -> Vector2<f64> {
    pixel.map(|value| (value * PIXEL_PARTS).round() / PIXEL_PARTS)
}

/// The landmarks that a camera sees, with their exact pixels.
pub(crate) fn visible(
    options: &SimulationOptions,
    exposure: &Exposure<'_>,
    sensor: &CameraSensor,
    landmarks: &[Landmark],
) -> Vec<(usize, Vector2<f64>)> {
    let [near, far] = options.sight_m;
    landmarks
        .iter()
        .enumerate()
        .filter_map(|(index, landmark)| {
            let point = exposure.in_camera(sensor, &landmark.position);
            let is_in_range = point.z >= near && point.norm_squared() <= far * far;
            let pixel = is_in_range.then(|| exposure.project(sensor, &landmark.position)).flatten();
            pixel.map(|pixel| (index, pixel))
        })
        .collect()
}
