//! The odometry front end: tracks of the visible landmarks in each stereo pair and single camera, with pixel noise.

use super::SimulationOptions;
use super::exposure::Exposure;
use super::random::{Purpose, normal, stream};
use super::world::Landmark;
use nalgebra::Vector2;
use rand::RngExt;
use rand::rngs::StdRng;
use rand::seq::SliceRandom;
use sensors::{CameraGroup, CameraSensor, TrackObservation, camera_groups};
use std::collections::BTreeMap;

/// Probability that a track is lost, a frame.
const LOSS: f64 = 0.01;
/// Files give pixels to this fraction.
const PIXEL_PARTS: f64 = 1000.0;

/// The front end, between two images.
pub(crate) struct FrontEnd<'a> {
    options: &'a SimulationOptions,
    cameras: &'a [CameraSensor],
    groups: Vec<CameraGroup>,
    rng: StdRng,
    /// Landmark of each track of a pair or single camera that is alive, and the track's id.
    alive: Vec<BTreeMap<usize, u64>>,
    next_id: u64,
}

impl<'a> FrontEnd<'a> {
    pub(crate) fn new(options: &'a SimulationOptions, run: u64, cameras: &'a [CameraSensor]) -> Self {
        let rng = stream(options.seed, run, Purpose::Tracks);
        let groups = camera_groups(cameras);
        let alive = vec![BTreeMap::new(); groups.len()];
        Self { options, cameras, groups, rng, alive, next_id: 0 }
    }

    /// Tracks into the next image. A landmark that comes back after a gap gets a new id, as from a real tracker.
    pub(crate) fn track(&mut self, exposure: &Exposure<'_>, landmarks: &[Landmark]) -> Vec<TrackObservation> {
        let groups = 0..self.groups.len();
        groups.flat_map(|group| self.track_group(group, exposure, landmarks)).collect()
    }

    fn track_group(
        &mut self,
        group: usize,
        exposure: &Exposure<'_>,
        landmarks: &[Landmark],
    ) -> Vec<TrackObservation> {
        let first = &self.cameras[self.groups[group].first];
        let seen = visible(self.options, exposure, first, landmarks);
        let pixels: BTreeMap<usize, Vector2<f64>> = seen.iter().copied().collect();
        let (rng, alive) = (&mut self.rng, &mut self.alive[group]);
        alive.retain(|landmark, _| pixels.contains_key(landmark) && !rng.random_bool(LOSS));
        let mut fresh: Vec<usize> = seen
            .iter()
            .map(|(landmark, _)| *landmark)
            .filter(|landmark| !alive.contains_key(landmark))
            .collect();
        fresh.shuffle(rng);
        fresh.truncate(self.options.max_tracks.saturating_sub(alive.len()));
        for landmark in fresh {
            alive.insert(landmark, self.next_id);
            self.next_id += 1;
        }
        let mut observations = Vec::with_capacity(2 * alive.len());
        for camera in self.groups[group].cameras() {
            let sensor = &self.cameras[camera];
            for (landmark, feature_id) in &*alive {
                let exact = exposure.project(sensor, &landmarks[*landmark].position);
                let noisy = exact.map(|pixel| measured(rng, self.options, pixel));
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
    // Most landmarks of a world are out of sight.
    let camera_from_world = exposure.camera_from_world(sensor);
    landmarks
        .iter()
        .enumerate()
        .filter_map(|(index, landmark)| {
            let point = camera_from_world.transform(&landmark.position);
            let is_in_range = point.z >= near && point.norm_squared() <= far * far;
            let pixel = is_in_range.then(|| exposure.project(sensor, &landmark.position)).flatten();
            pixel.map(|pixel| (index, pixel))
        })
        .collect()
}
