//! The filter of a robot from start to start: it looks for a state to start from, runs, and when it diverges
//! looks again.
//!
//! L goes on from start to start (REP-105: the odometry frame is continuous): the new start takes position and yaw
//! of the last pose that was believed. The place in the map is not taken along; a new filter asks for it.

use estimator::{
    CalibratedCamera, Estimator, EstimatorConfig, EstimatorError, ImuSample, InitMethod, InitStatus,
    Initialization, Initializer, LastTrustedPose, Localization, Status, TrackObservation,
};

/// A filter that lived shorter than this was started badly, nanoseconds.
const SHORT_LIFE_NS: i64 = 10_000_000_000;
/// Longest pause before the next start, seconds. Pauses double with each bad start from one second on, so that a
/// robot whose sensors are broken does not spend its time on starting.
const LONGEST_PAUSE: f64 = 30.0;

/// How long a start may take before it is said what is waited for, and how often then, nanoseconds.
const FIRST_WARNING_NS: i64 = 2_000_000_000;
const WARN_EVERY_NS: i64 = 10_000_000_000;

/// What the filter is at.
#[derive(Debug)]
enum Phase {
    Initializing(Box<Initializer>),
    Running(Box<Estimator>),
}

/// The filter, or the search for its start.
#[derive(Debug)]
pub struct EstimatorSupervisor {
    config: EstimatorConfig,
    rig: Vec<CalibratedCamera>,
    phase: Phase,
    /// Time of the newest start, nanoseconds.
    started_ns: i64,
    last: Option<LastTrustedPose>,
    bad_starts: i32,
    /// Why the last filter was given up.
    gave_up: Option<String>,
    waiting: InitStatus,
    /// When it is said next that there is no start, nanoseconds.
    next_warning_ns: Option<i64>,
}

impl EstimatorSupervisor {
    /// A filter that runs already, from its present state on.
    pub fn running(estimator: Estimator, rig: Vec<CalibratedCamera>) -> Self {
        let mut estimator_supervisor = Self::searching(estimator.config().clone(), rig);
        estimator_supervisor.started_ns = estimator.stamp_ns();
        estimator_supervisor.phase = Phase::Running(Box::new(estimator));
        estimator_supervisor
    }

    /// A filter whose start is still to be found.
    pub fn searching(config: EstimatorConfig, rig: Vec<CalibratedCamera>) -> Self {
        let initializer = Initializer::new(config.clone(), rig.clone());
        Self {
            config,
            rig,
            phase: Phase::Initializing(Box::new(initializer)),
            started_ns: i64::MAX,
            last: None,
            bad_starts: 0,
            gave_up: None,
            waiting: InitStatus::NoData,
            next_warning_ns: None,
        }
    }

    /// Settings of the filter.
    pub fn config(&self) -> &EstimatorConfig {
        &self.config
    }

    /// The filter; none while a start is looked for.
    pub fn estimator(&self) -> Option<&Estimator> {
        match &self.phase {
            Phase::Running(estimator) => Some(estimator),
            Phase::Initializing(_) => None,
        }
    }

    /// The same, to be changed.
    pub fn estimator_mut(&mut self) -> Option<&mut Estimator> {
        match &mut self.phase {
            Phase::Running(estimator) => Some(estimator),
            Phase::Initializing(_) => None,
        }
    }

    /// The filter, where it already was there at the time of an image: a newer one does not know that image.
    pub fn estimator_since(&mut self, stamp_ns: i64) -> Option<&mut Estimator> {
        let known = stamp_ns >= self.started_ns;
        self.estimator_mut().filter(|_| known)
    }

    /// Whether an image lies before a start that was known beforehand.
    pub fn begins_after(&self, stamp_ns: i64) -> bool {
        self.estimator().is_some_and(|estimator| stamp_ns < estimator.stamp_ns())
            && stamp_ns < self.started_ns
    }

    /// Takes a reading.
    ///
    /// # Errors
    /// [`EstimatorError::BadImu`]: it was dropped.
    pub fn imu(&mut self, sample: ImuSample) -> Result<(), EstimatorError> {
        match &mut self.phase {
            Phase::Initializing(initializer) => Ok(initializer.imu(sample)?),
            Phase::Running(estimator) => estimator.imu(sample),
        }
    }

    /// Looks for a start at an image, where one is looked for.
    ///
    /// # Returns
    /// How the filter was started now; `None` where it runs already, or still waits.
    ///
    /// # Errors
    /// [`EstimatorError::Config`] names the setting that cannot work.
    pub fn try_start(
        &mut self,
        stamp_ns: i64,
        tracks: &[TrackObservation],
    ) -> Result<Option<InitMethod>, EstimatorError> {
        let Phase::Initializing(initializer) = &mut self.phase else { return Ok(None) };
        let Initialization { initial, method } = match initializer.image(stamp_ns, tracks) {
            Ok(start) => start,
            Err(waiting) => {
                self.wait(stamp_ns, waiting);
                return Ok(None);
            }
        };
        self.next_warning_ns = None;
        let mut estimator = Estimator::new(self.config.clone(), self.rig.clone(), &initial)?;
        for reading in initializer.readings_for(&initial) {
            estimator.imu(*reading)?;
        }
        self.started_ns = initial.stamp_ns;
        self.phase = Phase::Running(Box::new(estimator));
        Ok(Some(method))
    }

    /// Remembers what is waited for, and says so when it takes long.
    fn wait(&mut self, stamp_ns: i64, waiting: InitStatus) {
        self.waiting = waiting;
        let due_ns = *self.next_warning_ns.get_or_insert(stamp_ns + FIRST_WARNING_NS);
        if stamp_ns >= due_ns {
            tracing::warn!(%waiting, "no pose: the robot has no start yet");
            self.next_warning_ns = Some(stamp_ns + WARN_EVERY_NS);
        }
    }

    /// Remembers the newest pose, where it can be believed.
    pub fn remember(&mut self) {
        let Phase::Running(estimator) = &self.phase else { return };
        if !estimator.is_suspicious() {
            self.last = Some(LastTrustedPose {
                stamp_ns: estimator.stamp_ns(),
                local_from_imu: estimator.local_from_imu().pose,
                gyroscope_bias: estimator.biases().0,
            });
        }
    }

    /// From when on [`EstimatorSupervisor::give_up`] would need the readings, nanoseconds; none while a start is looked for.
    pub fn believed_ns(&self) -> Option<i64> {
        self.estimator().and(self.last).map(|last| last.stamp_ns)
    }

    /// Gives the filter up and looks for the next start.
    ///
    /// # Arguments
    /// * `readings`: those up to now, from [`EstimatorSupervisor::believed_ns`] on, by which the yaw is turned on.
    pub fn give_up(&mut self, now_ns: i64, why: &EstimatorError, readings: &[ImuSample]) {
        let short = now_ns - self.started_ns < SHORT_LIFE_NS;
        self.bad_starts = if short { self.bad_starts + 1 } else { 0 };
        let pause = if short { 2_f64.powi(self.bad_starts - 1).min(LONGEST_PAUSE) } else { 0.0 };
        let not_before_ns = now_ns + (pause * 1e9) as i64;
        let mut initializer =
            Initializer::again(self.config.clone(), self.rig.clone(), self.last, not_before_ns);
        let from_ns = self.last.map_or(now_ns, |last| last.stamp_ns);
        let first = readings.partition_point(|reading| reading.stamp_ns < from_ns).saturating_sub(1);
        for reading in &readings[first.min(readings.len())..] {
            // A reading that the filter would not take is not taken here either.
            let _ = initializer.imu(*reading);
        }
        initializer.discard_rest();
        self.phase = Phase::Initializing(Box::new(initializer));
        self.gave_up = Some(why.to_string());
        self.waiting = InitStatus::NoData;
    }

    /// What is known of the pose.
    pub fn status(&self) -> Status {
        match &self.phase {
            Phase::Running(estimator) => estimator.status(),
            Phase::Initializing(_) => Status {
                localization: Localization::Lost,
                reason: match &self.gave_up {
                    Some(why) => format!("{why}; {}", self.waiting),
                    None => self.waiting.to_string(),
                },
                last_map_update_ns: None,
                held_keyframes: 0,
            },
        }
    }
}
