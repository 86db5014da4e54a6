//! Recordings with images instead of tracks: two flights through a furnished room, rendered.
//!
//! Images are rendered when they are read, so that a recording of minutes fits into memory; [`render_all`] renders them at once
//! on all processors, and [`write_images`] writes them as files.
//!
//! ```
//! use simulation::SimulationOptions;
//! use simulation::images::{ImageOptions, simulate_images};
//!
//! let options = SimulationOptions { duration_s: Some(0.5), ..ImageOptions::simulation() };
//! let recordings = simulate_images(&options, &ImageOptions::default())?;
//! let frame = &recordings.live.frames[0];
//! assert_eq!(frame.images[&0].read()?.width(), 752);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod all;
mod camera;
mod room;

pub use all::{WriteImagesError, render_all, write_images};

use super::random::{Purpose, stream};
use super::run::{self, Kind};
use super::spline::Spline;
use super::{Scenario, SimulatedScenario, SimulationError, SimulationOptions, rig};
use camera::{Cameras, RenderedImage};
use rand::RngExt;
use room::FurnishedRoom;
use sensors::{Frame, ImageData};
use std::f64::consts::TAU;
use std::sync::Arc;

/// How images are made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageOptions {
    /// Time of exposure, during which the camera moves, seconds.
    pub exposure_s: f64,
    /// Change of the gain during a run, as a fraction of its mean.
    pub gain_change: f64,
    /// Standard deviation of a pixel's noise, grey levels.
    pub sigma_noise: f64,
    /// Whether something the size of a man walks through the room.
    pub occluder: bool,
}

impl Default for ImageOptions {
    fn default() -> Self {
        Self { exposure_s: 0.005, gain_change: 0.12, sigma_noise: 2.0, occluder: true }
    }
}

impl ImageOptions {
    /// The usual simulation of flights: half a minute in a room at 20 Hz.
    ///
    /// What [`SimulationOptions`] says of landmarks, tracks and features is not used.
    pub fn simulation() -> SimulationOptions {
        SimulationOptions {
            scenario: Scenario::Flight,
            duration_s: Some(30.0),
            frame_rate_hz: 20.0,
            ..SimulationOptions::default()
        }
    }

    fn check(&self) -> Result<(), SimulationError> {
        let not_negative = [("exposure_s", self.exposure_s), ("sigma_noise", self.sigma_noise)];
        for (name, value) in not_negative {
            if !(value.is_finite() && value >= 0.0) {
                return Err(SimulationError::Option { name, value, wanted: "not negative" });
            }
        }
        if !(0.0..1.0).contains(&self.gain_change) {
            let (name, value) = ("gain_change", self.gain_change);
            return Err(SimulationError::Option { name, value, wanted: "at least 0 and below 1" });
        }
        Ok(())
    }
}

/// A run as its cameras record it.
struct RenderedRun {
    /// What it is called in messages.
    name: &'static str,
    /// Of the noise of its images.
    noise_seed: u64,
    trajectory: Spline,
    room: Arc<FurnishedRoom>,
    cameras: Arc<Cameras>,
    options: ImageOptions,
    /// Phases of the gain and of the occluder, rad.
    phases: [f64; 2],
}

/// Simulates a furnished room and two flights through it, with stereo images.
///
/// The ground truth of both runs is in the room's frame: the middle of the floor, z up. Every image of the map's run has a
/// reference pose, with an independent error of the stated size.
///
/// # Errors
/// [`SimulationError`] for options out of range, and for a trajectory other than [`Scenario::Flight`], which would leave the
/// room.
pub fn simulate_images(
    options: &SimulationOptions,
    images: &ImageOptions,
) -> Result<SimulatedScenario, SimulationError> {
    options.check()?;
    images.check()?;
    let is_given = options.map_trajectory.is_some() || options.live_trajectory.is_some();
    if is_given || options.scenario != Scenario::Flight {
        return Err(SimulationError::NoRoom);
    }
    let trajectories = run::trajectories(options)?;
    let sensors = rig::stereo(options.frame_rate_hz, 0.0, 0.0);
    let room = Arc::new(FurnishedRoom::new(options.seed));
    let cameras = Arc::new(Cameras::new(&sensors));
    let record = |kind: Kind, name: &'static str, trajectory: Spline| {
        let mut rng = stream(options.seed, kind as u64, Purpose::Images);
        let run = Arc::new(RenderedRun {
            name,
            noise_seed: rng.random(),
            phases: [rng.random_range(0.0..TAU), rng.random_range(0.0..TAU)],
            trajectory: trajectory.clone(),
            room: Arc::clone(&room),
            cameras: Arc::clone(&cameras),
            options: *images,
        });
        let image = |camera: usize, stamp_ns: i64| {
            ImageData::Stored(Arc::new(RenderedImage::new(Arc::clone(&run), camera, stamp_ns)))
        };
        let frames = run::frame_stamps(options, &trajectory).map(|stamp_ns| Frame {
            stamp_ns,
            images: [0, 1].map(|camera| (camera, image(camera, stamp_ns))).into(),
            ..Frame::default()
        });
        run::with_readings(options, kind, &trajectory, &sensors, frames.collect())
    };
    Ok(SimulatedScenario {
        map: record(Kind::Map, "map", trajectories.map),
        live: record(Kind::Live, "live", trajectories.live),
    })
}
