//! What the demo simulates, and the same in sentences for its table and its picture.

use crate::demo::{CREATED_BY, GRAVITY_IN_GLOBAL};
use mapping::{BuildOptions, StoredPoses};
use sensors::ImuNoise;
use serde::Serialize;
use simulation::SimulationOptions;

/// The conditions under which the variants are compared.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Conditions {
    /// First seed. A seed determines the world, both trajectories, all noise and the drop-outs.
    pub first_seed: u64,
    /// Number of seeds behind each figure.
    pub seeds: u64,
    /// Standard deviation of the map's keyframe positions, metres an axis.
    pub sigma_keyframe_p_m: f64,
    /// Standard deviation of the map's keyframe rotations, degrees an axis.
    pub sigma_keyframe_theta_deg: f64,
    /// Fraction of the live run without matches, in three stretches.
    pub dropout_fraction: f64,
    /// Noise of the gyroscope as a multiple of the one in EuRoC's data sheet.
    pub gyroscope_noise_factor: f64,
    /// Tracks in an image, at most.
    pub max_tracks: usize,
}

impl Conditions {
    /// The demo's conditions for some seeds.
    pub fn new(first_seed: u64, seeds: u64) -> Self {
        let paper = SimulationOptions::default();
        Self {
            first_seed,
            seeds,
            sigma_keyframe_p_m: paper.sigma_reference_p_m,
            sigma_keyframe_theta_deg: paper.sigma_reference_theta_rad.to_degrees(),
            dropout_fraction: 0.5,
            gyroscope_noise_factor: 10.0,
            max_tracks: 40,
        }
    }

    /// The seeds.
    pub fn seed_range(&self) -> std::ops::Range<u64> {
        self.first_seed..self.first_seed.saturating_add(self.seeds)
    }

    /// The conditions in sentences, one a line.
    pub fn describe(&self) -> Vec<String> {
        let last = self.first_seed + self.seeds.saturating_sub(1);
        vec![
            format!(
                "Map: as it was surveyed, not refined: every keyframe is off by {:.1} m and {:.1} deg (1 sigma an \
                 axis), and states so.",
                self.sigma_keyframe_p_m, self.sigma_keyframe_theta_deg
            ),
            format!(
                "Robot: stereo at 10 Hz, {} tracks an image, a gyroscope with {:.0} times the noise of EuRoC's; one \
                 query a second, no matches in {:.0} % of the run.",
                self.max_tracks,
                self.gyroscope_noise_factor,
                100.0 * self.dropout_fraction
            ),
            format!(
                "Figures: over {} simulated towns (seeds {} to {last}); every variant gets the same recordings and \
                 starts from the true state.",
                self.seeds, self.first_seed
            ),
        ]
    }

    /// The simulation of one seed.
    pub(super) fn simulation(&self, seed: u64) -> SimulationOptions {
        let mut imu_noise = ImuNoise::default();
        imu_noise.gyroscope *= self.gyroscope_noise_factor;
        imu_noise.gyroscope_walk *= self.gyroscope_noise_factor;
        SimulationOptions {
            seed,
            imu_noise,
            max_tracks: self.max_tracks,
            dropout_fraction: self.dropout_fraction,
            sigma_reference_p_m: self.sigma_keyframe_p_m,
            sigma_reference_theta_rad: self.sigma_keyframe_theta_deg.to_radians(),
            ..SimulationOptions::default()
        }
    }
}

/// How the map is built: the poses that the survey gave are stated with their independent errors.
pub(super) fn build_options() -> BuildOptions {
    let mut options = BuildOptions::default();
    options.created_by = String::from(CREATED_BY);
    options.gravity_in_global = Some(GRAVITY_IN_GLOBAL);
    options.stored_poses = StoredPoses::Given;
    options
}
