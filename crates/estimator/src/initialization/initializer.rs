//! Finds the initial state from IMU samples and tracks: static initialization at rest, else dynamic initialization in motion.
//!
//! Used before the filter starts and again after it diverged. Memory is bounded by `MAX_SECONDS_WITHOUT_IMAGES`. The static
//! initialization is tried first, since it needs no parallax. It is confirmed by the tracks, because the IMU cannot tell
//! uniform motion from rest.

use crate::calibration::CalibratedCamera;
use crate::config::EstimatorConfig;
use crate::imu::{BadImuSample, ImuBuffer};
use crate::initialization::continuation::{Continuation, LastTrustedPose};
use crate::initialization::dynamic::{
    BiasPrior, DynamicInitError, InitQuality, Window, WindowImage, initialize_dynamic,
};
use crate::initialization::image_motion::tracks_stand;
use crate::initialization::static_init::{InitialState, REST_SECONDS, StaticInitError};
use std::collections::VecDeque;
use types::{ImuSample, TrackObservation};

/// Minimum and maximum duration of the window of a dynamic initialization, seconds. Shorter ones seldom determine the scale;
/// longer ones cost more than they gain.
const WINDOW_SECONDS: [f64; 2] = [1.15, 1.85];
/// Duration of the stored samples, and maximum age of a static initialization at an image, seconds.
const MAX_SECONDS: f64 = 2.5;
/// The same where there are no images for a dynamic initialization: the state is propagated by the samples.
const MAX_SECONDS_WITHOUT_IMAGES: f64 = 10.0;
/// Minimum time between images of the window, nanoseconds: closer ones add cost, but no parallax.
const MIN_IMAGE_INTERVAL_NS: i64 = 80_000_000;
/// Time between two static initializations, seconds.
const STATIC_PERIOD_S: f64 = 0.1;
/// Initial time between two dynamic initializations, nanoseconds. One costs as much as tens of images.
const DYNAMIC_PERIOD_NS: i64 = 180_000_000;
/// After so many failed attempts the time between them is increased by its initial value, up to [`MAX_PERIOD_FACTOR`] times:
/// limits the load of a robot in uniform motion.
const ATTEMPTS_PER_PERIOD: i64 = 10;
/// Maximum factor on the time between two dynamic initializations.
const MAX_PERIOD_FACTOR: i64 = 5;

/// How the initial state was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum InitMethod {
    /// At rest.
    Static,
    /// In motion.
    Dynamic(InitQuality),
}

/// A successful initialization.
#[derive(Clone, Debug, PartialEq)]
pub struct Initialization {
    /// Initial state of the filter.
    pub initial: InitialState,
    /// How it was found.
    pub method: InitMethod,
}

/// Why the initializer has no initial state yet.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum InitStatus {
    /// Nothing arrived yet.
    #[error("waiting for IMU samples and images")]
    NoData,
    /// The filter diverged repeatedly within a short time.
    #[error("waiting {seconds:.0} s before the next initialization: the filter diverged repeatedly")]
    Paused {
        /// Time left, seconds.
        seconds: f64,
    },
    /// The window is too short for a dynamic initialization.
    #[error(
        "collecting images for a dynamic initialization ({have:.1} of {need:.1} s); static initialization: {rest}"
    )]
    Collecting {
        /// Duration of the window, seconds.
        have: f64,
        /// Duration needed, seconds.
        need: f64,
        /// Why the static initialization failed.
        rest: StaticInitError,
    },
    /// Both initializations failed.
    #[error("dynamic initialization: {motion}; static initialization: {rest}")]
    NotInitialized {
        /// Why the dynamic initialization failed.
        motion: DynamicInitError,
        /// Why the static initialization failed.
        rest: StaticInitError,
    },
}

/// Finds the initial state of a filter, at rest or in motion.
///
/// Feed it like the filter, with [`Self::imu`] and [`Self::image`], until the latter returns an [`Initialization`]; then
/// give the filter the samples of [`Self::readings_for`].
///
/// ```
/// use estimator::{CalibratedCamera, Estimator, EstimatorConfig, ImuSample, InitMethod, Initializer};
/// use geometry::{Camera, Distortion, Pose};
/// use nalgebra::Vector3;
///
/// let camera = Camera {
///     width: 640,
///     height: 480,
///     focal: [400.0; 2],
///     centre: [320.0, 240.0],
///     distortion: Distortion::None,
/// };
/// let cameras = vec![CalibratedCamera::new(camera, Pose::identity())];
/// let config = EstimatorConfig::default();
/// let mut initializer = Initializer::new(config.clone(), cameras.clone());
/// for k in 0..=200 {
///     initializer.imu(ImuSample {
///         stamp_ns: k * 5_000_000,
///         gyroscope: Vector3::zeros(),
///         accelerometer: Vector3::new(0.0, 0.0, 9.81),
///     })?;
/// }
/// let found = initializer.image(1_000_000_000, &[])?;
/// assert_eq!(found.method, InitMethod::Static);
///
/// let mut estimator = Estimator::new(config, cameras, &found.initial)?;
/// for sample in initializer.readings_for(&found.initial) {
///     estimator.imu(*sample)?;
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct Initializer {
    config: EstimatorConfig,
    cameras: Vec<CalibratedCamera>,
    imu: ImuBuffer,
    images: VecDeque<WindowImage>,
    /// The newest static initialization.
    rest: Option<InitialState>,
    static_error: StaticInitError,
    next_static_ns: Option<i64>,
    next_dynamic_ns: i64,
    attempts: i64,
    not_before_ns: i64,
    dynamic_error: Option<DynamicInitError>,
    continuation: Option<Continuation>,
}

impl Initializer {
    /// An initializer for the first initialization.
    pub fn new(config: EstimatorConfig, cameras: Vec<CalibratedCamera>) -> Self {
        Self {
            cameras: config.with_readout_times(cameras),
            config,
            imu: ImuBuffer::default(),
            images: VecDeque::new(),
            rest: None,
            static_error: StaticInitError::TooShort { have: 0.0, need: REST_SECONDS },
            next_static_ns: None,
            next_dynamic_ns: i64::MIN,
            attempts: 0,
            not_before_ns: i64::MIN,
            dynamic_error: None,
            continuation: None,
        }
    }

    /// An initializer after a divergence: L is continued.
    ///
    /// # Arguments
    /// * `last`: the pose whose position and yaw the new initial state takes. Its rotation is propagated with the gyroscope
    ///   from then on; the translation in between is unknown and left out.
    /// * `not_before_ns`: no initialization before this time.
    pub fn again(
        config: EstimatorConfig,
        cameras: Vec<CalibratedCamera>,
        last: Option<LastTrustedPose>,
        not_before_ns: i64,
    ) -> Self {
        Self {
            not_before_ns,
            continuation: last.as_ref().map(Continuation::of),
            ..Self::new(config, cameras)
        }
    }

    /// Adds an IMU sample, in the order of time.
    ///
    /// # Errors
    /// [`BadImuSample`]: it was dropped.
    pub fn imu(&mut self, sample: ImuSample) -> Result<(), BadImuSample> {
        let previous = self.imu.newest();
        self.imu.push(sample)?;
        if let (Some(continuation), Some(previous)) = (&mut self.continuation, previous) {
            continuation.propagate(&previous, &sample);
        }
        let step_ns = (STATIC_PERIOD_S * 1e9) as i64;
        let next_ns = *self.next_static_ns.get_or_insert(sample.stamp_ns + (REST_SECONDS * 1e9) as i64);
        if sample.stamp_ns >= next_ns {
            self.next_static_ns = Some(next_ns.max(sample.stamp_ns - step_ns) + step_ns);
            self.initialize_static(sample.stamp_ns);
        }
        self.remove_old();
        Ok(())
    }

    fn initialize_static(&mut self, now_ns: i64) {
        let from_ns = now_ns - (REST_SECONDS * 1e9) as i64;
        let newest: Vec<ImuSample> =
            self.imu.readings().filter(|reading| reading.stamp_ns >= from_ns).copied().collect();
        match InitialState::from_rest(&newest, &self.config) {
            Ok(state) => self.rest = Some(state),
            Err(why) => self.static_error = why,
        }
    }

    /// Removes samples, images and static initializations that are too old.
    fn remove_old(&mut self) {
        let Some(newest_ns) = self.imu.newest().map(|sample| sample.stamp_ns) else { return };
        let oldest_static_ns = newest_ns - (MAX_SECONDS_WITHOUT_IMAGES * 1e9) as i64;
        self.rest = self.rest.take().filter(|rest| rest.stamp_ns >= oldest_static_ns);
        let window_ns = newest_ns - (WINDOW_SECONDS[1] * 1e9) as i64;
        while self.images.front().is_some_and(|image| image.stamp_ns < window_ns) {
            self.images.pop_front();
        }
        let oldest_ns = newest_ns - (MAX_SECONDS * 1e9) as i64;
        self.imu.remove_before(self.rest.as_ref().map_or(oldest_ns, |rest| rest.stamp_ns.min(oldest_ns)));
    }

    /// Adds the tracks of an image, after the IMU samples up to the first one later than it by the clock of the IMU
    /// ([`EstimatorConfig::imu_stamp_ns`]).
    ///
    /// # Arguments
    /// * `stamp_ns`: by the camera's clock, nanoseconds.
    ///
    /// # Returns
    /// An initial state at this image, or a short time before it.
    ///
    /// # Errors
    /// [`InitStatus`]: why there is none yet.
    pub fn image(
        &mut self,
        stamp_ns: i64,
        tracks: &[TrackObservation],
    ) -> Result<Initialization, InitStatus> {
        // From here on by the clock of the IMU.
        let stamp_ns = self.config.imu_stamp_ns(stamp_ns);
        if stamp_ns < self.not_before_ns {
            return Err(InitStatus::Paused { seconds: (self.not_before_ns - stamp_ns) as f64 * 1e-9 });
        }
        let spaced = self.images.back().is_none_or(|last| stamp_ns - last.stamp_ns >= MIN_IMAGE_INTERVAL_NS);
        if spaced {
            self.images.push_back(WindowImage { stamp_ns, tracks: tracks.to_vec() });
        }
        let found = match self.at_rest(stamp_ns, tracks) {
            Some(initial) => Ok(Initialization { initial, method: InitMethod::Static }),
            None if spaced => self.in_motion(stamp_ns),
            None => Err(self.status(stamp_ns)),
        };
        found.map(|found| Initialization { initial: self.continue_local(&found.initial), ..found })
    }

    fn at_rest(&mut self, stamp_ns: i64, tracks: &[TrackObservation]) -> Option<InitialState> {
        let without_images = self.images.len() < 2;
        let oldest_ns =
            stamp_ns - (if without_images { MAX_SECONDS_WITHOUT_IMAGES } else { MAX_SECONDS } * 1e9) as i64;
        let rest = self.rest.as_ref().filter(|rest| (oldest_ns..=stamp_ns).contains(&rest.stamp_ns))?;
        match tracks_stand(&self.images, rest.stamp_ns, tracks, self.config.sigma_track_px) {
            Some(false) => {
                self.static_error = StaticInitError::UniformMotion;
                self.rest = None;
            }
            // What the filter lost may have been the tracks of a robot that drives on.
            None if self.continuation.is_some() => {
                self.static_error = StaticInitError::RestUnseen;
                return None;
            }
            _ => {}
        }
        self.rest.clone()
    }

    fn in_motion(&mut self, stamp_ns: i64) -> Result<Initialization, InitStatus> {
        let long_enough = self.seconds(stamp_ns) >= WINDOW_SECONDS[0];
        if !long_enough || stamp_ns < self.next_dynamic_ns {
            return Err(self.status(stamp_ns));
        }
        self.next_dynamic_ns =
            stamp_ns + DYNAMIC_PERIOD_NS * (1 + self.attempts / ATTEMPTS_PER_PERIOD).min(MAX_PERIOD_FACTOR);
        self.attempts += 1;
        let found = Window::new(self.images.make_contiguous(), &self.imu, &self.cameras).and_then(|window| {
            initialize_dynamic(&window, &self.cameras, &self.config, &BiasPrior::default())
        });
        match found {
            Ok((initial, init_quality)) => {
                Ok(Initialization { initial, method: InitMethod::Dynamic(init_quality) })
            }
            Err(why) => {
                self.dynamic_error = Some(why);
                Err(self.status(stamp_ns))
            }
        }
    }

    /// Duration of the window, seconds.
    fn seconds(&self, stamp_ns: i64) -> f64 {
        self.images.front().map_or(0.0, |first| (stamp_ns - first.stamp_ns) as f64 * 1e-9)
    }

    fn status(&self, stamp_ns: i64) -> InitStatus {
        let rest = self.static_error;
        match self.dynamic_error {
            Some(motion) => InitStatus::NotInitialized { motion, rest },
            None => InitStatus::Collecting { have: self.seconds(stamp_ns), need: WINDOW_SECONDS[0], rest },
        }
    }

    /// The initial state with position and yaw of the last trusted pose.
    fn continue_local(&self, initial: &InitialState) -> InitialState {
        self.continuation.as_ref().map_or_else(|| initial.clone(), |continuation| continuation.place(initial))
    }

    /// Discards the static initialization found so far: after a divergence only later samples are used.
    pub fn discard_rest(&mut self) {
        self.rest = None;
    }

    /// The IMU samples that the filter needs from its initial state on.
    pub fn readings_for(&self, start: &InitialState) -> impl Iterator<Item = &ImuSample> {
        let first = self.imu.readings().take_while(|reading| reading.stamp_ns <= start.stamp_ns).count();
        self.imu.readings().skip(first.saturating_sub(1))
    }
}
