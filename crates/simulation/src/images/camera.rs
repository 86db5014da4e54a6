//! One image of a run, rendered when it is read.

use super::RenderedRun;
use geometry::Pose;
use rendering::{CameraRays, Sensor, exposed, render};
use sensors::{CameraSensor, StoredImage};
use std::fmt;
use std::sync::Arc;
use vision::{GrayImage, ImageError};

/// The image moves by so many pixels, at most, between two instants of the exposure.
const BLUR_STEP_PX: f64 = 1.5;
/// Most instants of an exposure.
const MAX_INSTANTS: usize = 4;
/// Distance of what is seen, for the blur of a camera that does not turn, metres.
const USUAL_DISTANCE_M: f64 = 2.5;
/// Seconds in which the gain goes up and down once.
const GAIN_PERIOD_S: f64 = 11.0;
/// The second camera's gain differs by this factor.
const SECOND_GAIN: f64 = 1.03;

/// The cameras, with what is computed once for them.
pub(super) struct Cameras {
    imu_from_camera: Vec<Pose>,
    rays: Vec<Arc<CameraRays>>,
    focal_px: f64,
}

impl Cameras {
    pub(super) fn new(sensors: &[CameraSensor]) -> Self {
        let mut rays: Vec<Arc<CameraRays>> = Vec::new();
        for (index, sensor) in sensors.iter().enumerate() {
            let alike = sensors[..index].iter().position(|other| other.camera == sensor.camera);
            let known = alike.map(|alike| Arc::clone(&rays[alike]));
            rays.push(known.unwrap_or_else(|| Arc::new(CameraRays::new(&sensor.camera))));
        }
        Self {
            imu_from_camera: sensors.iter().map(|sensor| sensor.imu_from_camera).collect(),
            rays,
            focal_px: sensors.first().map_or(0.0, |sensor| sensor.camera.focal[0]),
        }
    }
}

/// An image of a simulated run.
pub(super) struct RenderedImage {
    run: Arc<RenderedRun>,
    camera: usize,
    /// The middle of its exposure.
    stamp_ns: i64,
}

impl RenderedImage {
    pub(super) fn new(run: Arc<RenderedRun>, camera: usize, stamp_ns: i64) -> Self {
        Self { run, camera, stamp_ns }
    }

    fn image(&self) -> GrayImage {
        let run = &self.run;
        let cameras = &run.cameras;
        let seen = exposed(self.instants(), |part| {
            let at_ns = self.stamp_ns + (part * run.options.exposure_s * 1e9) as i64;
            let seconds = (at_ns - run.trajectory.start_ns()) as f64 * 1e-9;
            let bodies = run.room.at(seconds, run.options.occluder.then_some(run.phases[1]));
            let world_from_imu = run.trajectory.at(at_ns).pose;
            let world_from_camera = world_from_imu.compose(&cameras.imu_from_camera[self.camera]);
            render(&bodies, &cameras.rays[self.camera], &world_from_camera)
        });
        let sigma_noise = run.options.sigma_noise as f32;
        let noise_seed = run.noise_seed ^ (self.stamp_ns as u64).rotate_left(1) ^ self.camera as u64;
        Sensor { gain: self.gain() as f32, sigma_noise }.image(&seen, noise_seed)
    }

    fn gain(&self) -> f64 {
        let run = &self.run;
        let seconds = (self.stamp_ns - run.trajectory.start_ns()) as f64 * 1e-9;
        let change = (std::f64::consts::TAU * seconds / GAIN_PERIOD_S + run.phases[0]).sin();
        let own = if self.camera == 0 { 1.0 } else { SECOND_GAIN };
        own * (1.0 + run.options.gain_change * change)
    }

    /// How many instants the motion during the exposure needs.
    fn instants(&self) -> usize {
        let motion = self.run.trajectory.at(self.stamp_ns);
        let rate = motion.angular_velocity.norm() + motion.velocity.norm() / USUAL_DISTANCE_M;
        let blur_px = rate * self.run.options.exposure_s * self.run.cameras.focal_px;
        ((blur_px / BLUR_STEP_PX).ceil() as usize).clamp(1, MAX_INSTANTS)
    }
}

impl fmt::Debug for RenderedImage {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.name())
    }
}

impl StoredImage for RenderedImage {
    fn name(&self) -> String {
        let Self { run, camera, stamp_ns } = self;
        format!("image {stamp_ns} of camera {camera} of the simulated {} run {:x}", run.name, run.noise_seed)
    }

    fn read(&self) -> Result<GrayImage, ImageError> {
        Ok(self.image())
    }
}
