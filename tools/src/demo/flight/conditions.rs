//! What the demo from pixels simulates, and the same in sentences.

use serde::Serialize;
use simulation::SimulationOptions;
use simulation::images::ImageOptions;

/// The conditions of the demo from pixels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FlightConditions {
    /// Determines the room, both flights and all noise.
    pub seed: u64,
    /// Length of the live flight, seconds; that of the map is 5 s longer.
    pub live_s: f64,
    /// White noise of the IMU as a multiple of the one in EuRoC's data sheet, which the robot is not told.
    pub imu_noise_scale: f64,
}

impl FlightConditions {
    /// The demo's conditions for a seed.
    pub fn new(seed: u64) -> Self {
        Self { seed, live_s: 8.0, imu_noise_scale: 2.0 }
    }

    /// The simulation.
    pub(super) fn simulation(&self) -> (SimulationOptions, ImageOptions) {
        let simulation = SimulationOptions {
            seed: self.seed,
            duration_s: Some(self.live_s),
            imu_noise_scale: self.imu_noise_scale,
            ..ImageOptions::simulation()
        };
        (simulation, ImageOptions::default())
    }

    /// The conditions in sentences, one a line.
    pub(super) fn describe(&self, simulation: &SimulationOptions) -> Vec<String> {
        let images = ImageOptions::default();
        vec![
            format!(
                "Images: rendered, stereo, 752 x 480 px at {:.0} Hz with EuRoC's distortion, {:.0} ms of motion blur, noise of {:.0} \
                 grey levels, a gain that changes by {:.0} %; somebody walks through the room.",
                simulation.frame_rate_hz,
                1e3 * images.exposure_s,
                images.sigma_noise,
                100.0 * images.gain_change
            ),
            format!(
                "IMU: {:.0} Hz with {:.0} times the white noise of EuRoC's data sheet; the filter is told the data sheet's. Biases \
                 walk.",
                simulation.imu_rate_hz, self.imu_noise_scale
            ),
            "Map: of a flight by images and IMU alone, without reference poses; the truth is aligned with \
             all of its keyframes, in yaw and position."
                .to_owned(),
            format!(
                "Robot: another flight, seed {}, initialized by itself at rest; each query is an image's features, over \
                 Zenoh on the loopback interface.",
                self.seed
            ),
        ]
    }
}
