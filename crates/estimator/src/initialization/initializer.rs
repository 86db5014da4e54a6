//! Watches readings and images for a state to start from: at rest, else in motion.
//!
//! Before the first start, and again after the filter diverged. Pure, like the filter; what it keeps is bounded
//! by `MOST_SECONDS_BLIND`. Rest is tried first: it needs no parallax. The tracks must agree: a body that glides reads
//! like one at rest.

use crate::EstimatorError;
use crate::calibration::CalibratedCamera;
use crate::config::EstimatorConfig;
use crate::imu::{ImuBuffer, ImuSample};
use crate::initialization::dynamic::{BiasPrior, InitQuality, NotYet, StartImage, Window, dynamic_start};
use crate::initialization::static_initialization::{InitialState, InitializationError, REST_SECONDS};
use crate::odometry::tracks::TrackObservation;
use geometry::{Pose, rotation};
use nalgebra::Vector3;
use std::collections::{BTreeMap, VecDeque};

/// Length of the window that a start in motion is tried from, seconds. Shorter ones seldom tell the scale; longer
/// ones cost more than they tell.
const WINDOW_SECONDS: [f64; 2] = [1.15, 1.85];
/// How long readings are kept, and how old a state at rest may be at an image, seconds.
const MOST_SECONDS: f64 = 2.5;
/// The same where images are so rare that nothing better will come: the readings carry the state on.
const MOST_SECONDS_BLIND: f64 = 10.0;
/// Images closer to each other than this are left out of the window, nanoseconds: they add cost, not parallax.
const LEAST_IMAGE_GAP_NS: i64 = 80_000_000;
/// Time between two looks at the readings for a rest, seconds.
const REST_STEP: f64 = 0.1;
/// Time between two tries of a start in motion, nanoseconds, at first. A try costs as much as tens of frames.
const TRY_EVERY_NS: i64 = 180_000_000;
/// After so many tries in vain the time between them grows by as much again, up to [`SLOWEST_TRIES`] times: a robot
/// that glides for an hour does not spend it on starting.
const TRIES_AT_ONE_PACE: i64 = 10;
const SLOWEST_TRIES: i64 = 5;
/// Images to compare at rest are at least so far apart, nanoseconds.
const GLIDE_SPAN_NS: i64 = 200_000_000;
/// Fewest tracks to tell gliding from rest by.
const GLIDE_TRACKS: usize = 12;
/// Median displacement of pixels at rest, in units of their noise. Noise alone gives 1.66.
const GLIDE_DISPLACEMENT: f64 = 2.5;

/// How a start was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum InitMethod {
    /// The body stood.
    Rest,
    /// It moved.
    Motion(InitQuality),
}

/// A start.
#[derive(Clone, Debug, PartialEq)]
pub struct Start {
    /// Where the filter begins.
    pub initial: InitialState,
    /// How it was found.
    pub method: InitMethod,
}

/// What the initializer waits for.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum InitStatus {
    /// Nothing arrived yet.
    #[error("waiting for readings of the IMU and images")]
    Data,
    /// The filter diverged a short time ago, more than once.
    #[error("waiting {seconds:.0} s before it is started again: the last starts did not last")]
    Pause {
        /// Seconds left.
        seconds: f64,
    },
    /// The images are too few to start in motion.
    #[error("watching for {need:.1} s before a start in motion ({have:.1} s so far); at rest: {rest}")]
    Watching {
        /// Seconds at hand.
        have: f64,
        /// Seconds needed.
        need: f64,
        /// Why it does not start at rest.
        rest: InitializationError,
    },
    /// No start in motion.
    #[error("no start in motion: {motion}; no start at rest: {rest}")]
    Moving {
        /// Why not in motion.
        motion: NotYet,
        /// Why not at rest.
        rest: InitializationError,
    },
}

/// Where L was when the filter was last believed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LastTrustedPose {
    /// Time, nanoseconds.
    pub stamp_ns: i64,
    /// The body in L.
    pub local_from_imu: Pose,
    /// Bias of the gyroscope, rad/s; turns on until the next start.
    pub gyroscope_bias: Vector3<f64>,
}

/// Looks for a start.
#[derive(Clone, Debug)]
pub struct Initializer {
    config: EstimatorConfig,
    rig: Vec<CalibratedCamera>,
    imu: ImuBuffer,
    images: VecDeque<StartImage>,
    /// The newest state at rest.
    rest: Option<InitialState>,
    no_rest: InitializationError,
    next_rest_ns: Option<i64>,
    next_try_ns: i64,
    tries: i64,
    not_before_ns: i64,
    no_motion: Option<NotYet>,
    last: Option<LastTrustedPose>,
}

impl Initializer {
    /// A initializer for the first start.
    pub fn new(config: EstimatorConfig, rig: Vec<CalibratedCamera>) -> Self {
        Self {
            config,
            rig,
            imu: ImuBuffer::default(),
            images: VecDeque::new(),
            rest: None,
            no_rest: InitializationError::TooShort { have: 0.0, need: REST_SECONDS },
            next_rest_ns: None,
            next_try_ns: i64::MIN,
            tries: 0,
            not_before_ns: i64::MIN,
            no_motion: None,
            last: None,
        }
    }

    /// A initializer for the next start: L goes on.
    ///
    /// # Arguments
    /// * `last`: the pose whose position and yaw the new start takes. The yaw is turned on with the gyroscope by the
    ///   readings from then on; the way in between is not known and left out.
    /// * `not_before_ns`: no start before this time.
    pub fn again(
        config: EstimatorConfig,
        rig: Vec<CalibratedCamera>,
        last: Option<LastTrustedPose>,
        not_before_ns: i64,
    ) -> Self {
        Self { not_before_ns, last, ..Self::new(config, rig) }
    }

    /// Takes a reading, in the order of time.
    ///
    /// # Errors
    /// [`EstimatorError::BadImu`]: it was dropped.
    pub fn imu(&mut self, sample: ImuSample) -> Result<(), EstimatorError> {
        let previous = self.imu.newest();
        self.imu.push(sample)?;
        self.turn_on(previous, &sample);
        let step_ns = (REST_STEP * 1e9) as i64;
        let next_ns = *self.next_rest_ns.get_or_insert(sample.stamp_ns + (REST_SECONDS * 1e9) as i64);
        if sample.stamp_ns >= next_ns {
            self.next_rest_ns = Some(next_ns.max(sample.stamp_ns - step_ns) + step_ns);
            self.look_for_rest(sample.stamp_ns);
        }
        self.forget();
        Ok(())
    }

    /// Turns the last believed pose on.
    fn turn_on(&mut self, previous: Option<ImuSample>, sample: &ImuSample) {
        let (Some(last), Some(previous)) = (&mut self.last, previous) else { return };
        let seconds = (sample.stamp_ns - previous.stamp_ns.max(last.stamp_ns)) as f64 * 1e-9;
        if seconds > 0.0 {
            let rate = 0.5 * (previous.gyroscope + sample.gyroscope) - last.gyroscope_bias;
            last.local_from_imu.rotation *= rotation::exp(&(rate * seconds));
            last.stamp_ns = sample.stamp_ns;
        }
    }

    fn look_for_rest(&mut self, now_ns: i64) {
        let from_ns = now_ns - (REST_SECONDS * 1e9) as i64;
        let newest: Vec<ImuSample> =
            self.imu.readings().filter(|reading| reading.stamp_ns >= from_ns).copied().collect();
        match InitialState::from_rest(&newest, &self.config) {
            Ok(state) => self.rest = Some(state),
            Err(why) => self.no_rest = why,
        }
    }

    /// Forgets what is too old to start from.
    fn forget(&mut self) {
        let Some(newest_ns) = self.imu.newest().map(|sample| sample.stamp_ns) else { return };
        let blind_ns = newest_ns - (MOST_SECONDS_BLIND * 1e9) as i64;
        self.rest = self.rest.take().filter(|rest| rest.stamp_ns >= blind_ns);
        let window_ns = newest_ns - (WINDOW_SECONDS[1] * 1e9) as i64;
        while self.images.front().is_some_and(|image| image.stamp_ns < window_ns) {
            self.images.pop_front();
        }
        let oldest_ns = newest_ns - (MOST_SECONDS * 1e9) as i64;
        self.imu.forget_before(self.rest.as_ref().map_or(oldest_ns, |rest| rest.stamp_ns.min(oldest_ns)));
    }

    /// Takes an image's tracks, after the readings up to the first one behind it.
    ///
    /// # Returns
    /// A start at this image, or a short time before it.
    ///
    /// # Errors
    /// [`InitStatus`] says what for.
    pub fn image(&mut self, stamp_ns: i64, tracks: &[TrackObservation]) -> Result<Start, InitStatus> {
        if stamp_ns < self.not_before_ns {
            return Err(InitStatus::Pause { seconds: (self.not_before_ns - stamp_ns) as f64 * 1e-9 });
        }
        let spaced = self.images.back().is_none_or(|last| stamp_ns - last.stamp_ns >= LEAST_IMAGE_GAP_NS);
        if spaced {
            self.images.push_back(StartImage { stamp_ns, tracks: tracks.to_vec() });
        }
        let start = match self.at_rest(stamp_ns, tracks) {
            Some(initial) => Ok(Start { initial, method: InitMethod::Rest }),
            None if spaced => self.in_motion(stamp_ns),
            None => Err(self.waiting(stamp_ns)),
        };
        start.map(|start| Start { initial: self.placed(&start.initial), ..start })
    }

    fn at_rest(&mut self, stamp_ns: i64, tracks: &[TrackObservation]) -> Option<InitialState> {
        let blind = self.images.len() < 2;
        let oldest_ns = stamp_ns - (if blind { MOST_SECONDS_BLIND } else { MOST_SECONDS } * 1e9) as i64;
        let rest = self.rest.as_ref().filter(|rest| (oldest_ns..=stamp_ns).contains(&rest.stamp_ns))?;
        let glides = glides(&self.images, rest.stamp_ns, tracks, self.config.sigma_track_px);
        if glides {
            self.no_rest = InitializationError::Gliding;
            self.rest = None;
        }
        self.rest.clone()
    }

    fn in_motion(&mut self, stamp_ns: i64) -> Result<Start, InitStatus> {
        let long_enough = self.seconds(stamp_ns) >= WINDOW_SECONDS[0];
        if !long_enough || stamp_ns < self.next_try_ns {
            return Err(self.waiting(stamp_ns));
        }
        self.next_try_ns = stamp_ns + TRY_EVERY_NS * (1 + self.tries / TRIES_AT_ONE_PACE).min(SLOWEST_TRIES);
        self.tries += 1;
        let found = Window::new(self.images.make_contiguous(), &self.imu, &self.rig)
            .and_then(|window| dynamic_start(&window, &self.rig, &self.config, &BiasPrior::default()));
        match found {
            Ok((initial, init_quality)) => Ok(Start { initial, method: InitMethod::Motion(init_quality) }),
            Err(why) => {
                self.no_motion = Some(why);
                Err(self.waiting(stamp_ns))
            }
        }
    }

    /// Length of the window, seconds.
    fn seconds(&self, stamp_ns: i64) -> f64 {
        self.images.front().map_or(0.0, |first| (stamp_ns - first.stamp_ns) as f64 * 1e-9)
    }

    fn waiting(&self, stamp_ns: i64) -> InitStatus {
        let rest = self.no_rest;
        match self.no_motion {
            Some(motion) => InitStatus::Moving { motion, rest },
            None => InitStatus::Watching { have: self.seconds(stamp_ns), need: WINDOW_SECONDS[0], rest },
        }
    }

    /// The start at the position and with the yaw that L goes on with.
    fn placed(&self, initial: &InitialState) -> InitialState {
        let Some(last) = &self.last else { return initial.clone() };
        let apart = last.local_from_imu.rotation * initial.imu.local_from_imu.rotation.inverse();
        // The part of a rotation about z is what is left of its quaternion without x and y.
        let yaw = 2.0 * apart.k.atan2(apart.w);
        let turn = rotation::exp(&Vector3::new(0.0, 0.0, yaw));
        initial.seen_from(&Pose::new(turn, last.local_from_imu.translation))
    }

    /// Forgets a rest that was seen so far: after a divergence only what comes from now on counts.
    pub fn forget_rest(&mut self) {
        self.rest = None;
    }

    /// Readings that the filter needs from its start on.
    pub fn readings_for(&self, start: &InitialState) -> impl Iterator<Item = &ImuSample> {
        let first = self.imu.readings().take_while(|reading| reading.stamp_ns <= start.stamp_ns).count();
        self.imu.readings().skip(first.saturating_sub(1))
    }
}

/// Whether the tracks move although the readings say that the body stands. False where they do not tell.
fn glides(images: &VecDeque<StartImage>, rest_ns: i64, tracks: &[TrackObservation], sigma_px: f64) -> bool {
    let Some(newest_ns) = images.back().map(|image| image.stamp_ns) else { return false };
    let begin_ns = rest_ns - (REST_SECONDS * 1e9) as i64;
    let mut before = images
        .iter()
        .filter(|image| image.stamp_ns >= begin_ns && newest_ns - image.stamp_ns >= GLIDE_SPAN_NS);
    let now: BTreeMap<u64, _> = tracks
        .iter()
        .filter(|track| track.camera == 0)
        .map(|track| (track.feature_id, track.pixel))
        .collect();
    let displacements = before.find_map(|image| {
        let shared: Vec<f64> = image
            .tracks
            .iter()
            .filter(|track| track.camera == 0)
            .filter_map(|track| Some((now.get(&track.feature_id)? - track.pixel).norm()))
            .collect();
        (shared.len() >= GLIDE_TRACKS).then_some(shared)
    });
    displacements.is_some_and(|mut displacements| {
        displacements.sort_by(f64::total_cmp);
        displacements[displacements.len() / 2] > GLIDE_DISPLACEMENT * sigma_px
    })
}
