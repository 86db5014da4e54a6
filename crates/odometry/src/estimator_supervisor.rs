//! Initializes the estimator, runs it, and initializes it again when it diverges.
//!
//! The odometry frame L is continuous over initializations (REP-105): a new filter begins with position and yaw of the
//! last trusted pose. The pose in the map is not carried over; a new filter is localized by its own queries, in the same map.

use estimator::{
    CalibratedCamera, Divergence, Estimator, EstimatorConfig, EstimatorError, GnssCounts, GnssReading,
    ImuSample, InitMethod, InitStatus, Initialization, Initializer, LastTrustedPose, LearnedNoise,
    LearnedWheels, Localization, MapKnowledge, Status, TrackObservation, WheelReading, WheelReport,
};
use sensors::push_newest;
use std::collections::VecDeque;

/// A filter that diverges earlier than this was initialized badly, nanoseconds.
const MIN_LIFE_NS: i64 = 10_000_000_000;
/// Longest pause before the next initialization, seconds. Pauses begin at one second and double with each bad
/// initialization, so that a robot with broken sensors does not spend its time on initializing.
const MAX_PAUSE_S: f64 = 30.0;

/// Time without a pose before the first warning, and between warnings, nanoseconds.
const FIRST_WARNING_NS: i64 = 2_000_000_000;
const WARN_EVERY_NS: i64 = 10_000_000_000;

/// Newest readings of the wheels that are kept for an estimator that is still to be initialized: two seconds at 100 Hz.
const MAX_WHEEL_READINGS: usize = 200;

/// What the supervisor does now.
#[derive(Debug)]
enum Phase {
    Initializing(Box<Initializer>),
    Running(Box<Estimator>),
}

/// The estimator, or its initialization.
#[derive(Debug)]
pub struct EstimatorSupervisor {
    config: EstimatorConfig,
    rig: Vec<CalibratedCamera>,
    phase: Phase,
    /// Time of the newest initialization by the clock of the cameras, nanoseconds.
    started_ns: i64,
    last_trusted: Option<LastTrustedPose>,
    /// Noise levels that the last filter learned.
    learned_noise: Option<LearnedNoise>,
    /// Calibration of the wheels that the last filter learned.
    learned_wheels: Option<LearnedWheels>,
    /// What the last filter knew of the map.
    map_knowledge: MapKnowledge,
    /// Readings of the wheels for the next filter.
    wheel_readings: VecDeque<WheelReading>,
    /// What the filters before did with wheels and GNSS.
    before: SensorReports,
    bad_initializations: i32,
    /// Why the last filter diverged.
    divergence: Option<String>,
    init_status: InitStatus,
    /// Time of the next warning that there is no pose, nanoseconds.
    next_warning_ns: Option<i64>,
}

/// What all filters of a run did with readings that are not those of cameras and IMU.
#[derive(Clone, Debug, Default)]
struct SensorReports {
    wheels: Option<WheelReport>,
    gnss: Option<GnssCounts>,
}

impl SensorReports {
    /// Of a filter, which counts on from those before it.
    fn of(estimator: &Estimator) -> Self {
        Self { wheels: estimator.wheel_report(), gnss: estimator.gnss_counts() }
    }
}

impl EstimatorSupervisor {
    /// Supervises an estimator that is initialized already.
    pub fn running(estimator: Estimator, rig: Vec<CalibratedCamera>) -> Self {
        let mut supervisor = Self::initializing(estimator.config().clone(), rig);
        supervisor.started_ns = estimator.stamp_ns();
        supervisor.phase = Phase::Running(Box::new(estimator));
        supervisor
    }

    /// Supervises an estimator that is still to be initialized.
    pub fn initializing(config: EstimatorConfig, rig: Vec<CalibratedCamera>) -> Self {
        let initializer = Initializer::new(config.clone(), rig.clone());
        Self {
            config,
            rig,
            phase: Phase::Initializing(Box::new(initializer)),
            started_ns: i64::MAX,
            last_trusted: None,
            learned_noise: None,
            learned_wheels: None,
            map_knowledge: MapKnowledge::default(),
            wheel_readings: VecDeque::new(),
            before: SensorReports::default(),
            bad_initializations: 0,
            divergence: None,
            init_status: InitStatus::NoData,
            next_warning_ns: None,
        }
    }

    /// Settings of the estimator.
    pub fn config(&self) -> &EstimatorConfig {
        &self.config
    }

    /// Number of cameras of the rig.
    pub fn camera_count(&self) -> usize {
        self.rig.len()
    }

    /// The estimator; `None` while it is being initialized.
    pub fn estimator(&self) -> Option<&Estimator> {
        match &self.phase {
            Phase::Running(estimator) => Some(estimator),
            Phase::Initializing(_) => None,
        }
    }

    /// What is added to the time of an image to obtain the IMU's, as estimated or by the settings, nanoseconds.
    pub fn camera_time_offset_ns(&self) -> i64 {
        match &self.phase {
            Phase::Running(estimator) => estimator.imu_stamp_ns(0),
            Phase::Initializing(_) => self.config.imu_stamp_ns(0),
        }
    }

    /// Time of the last row of a frame on the clock of the IMU, nanoseconds: up to there readings are needed.
    pub fn last_row_ns(&self, frame_ns: i64) -> i64 {
        match &self.phase {
            Phase::Running(estimator) => estimator.last_row_ns(frame_ns),
            Phase::Initializing(_) => self.config.imu_stamp_ns(frame_ns),
        }
    }

    /// The estimator, mutable; `None` while it is being initialized.
    pub fn estimator_mut(&mut self) -> Option<&mut Estimator> {
        match &mut self.phase {
            Phase::Running(estimator) => Some(estimator),
            Phase::Initializing(_) => None,
        }
    }

    /// The estimator, if it already ran at the time of an image: a newer one has no clone of that image.
    pub fn estimator_since(&mut self, stamp_ns: i64) -> Option<&mut Estimator> {
        let known = stamp_ns >= self.started_ns;
        self.estimator_mut().filter(|_| known)
    }

    /// Whether an image is before the given initial state.
    pub fn starts_after(&self, stamp_ns: i64) -> bool {
        self.estimator().is_some_and(|estimator| stamp_ns < estimator.stamp_ns())
            && stamp_ns < self.started_ns
    }

    /// Adds an IMU reading.
    ///
    /// # Errors
    /// [`EstimatorError::BadImu`]: the reading was refused.
    pub fn imu(&mut self, sample: ImuSample) -> Result<(), EstimatorError> {
        match &mut self.phase {
            Phase::Initializing(initializer) => Ok(initializer.imu(sample)?),
            Phase::Running(estimator) => estimator.imu(sample),
        }
    }

    /// Adds a position of GNSS. What the estimator refuses, it counts; before its initialization there is no odometry to align it with,
    /// and it is counted only.
    pub fn gnss(&mut self, reading: GnssReading) {
        match &mut self.phase {
            Phase::Running(estimator) => drop(estimator.gnss(reading)),
            Phase::Initializing(_) if self.config.gnss.is_some() => {
                self.before.gnss.get_or_insert_default().before_initialization += 1;
            }
            Phase::Initializing(_) => {}
        }
    }

    /// What wheel odometry did in all of the run, and the calibration that the last filter found; `None` without it.
    pub fn wheel_report(&self) -> Option<WheelReport> {
        self.estimator().and_then(Estimator::wheel_report).or_else(|| self.before.wheels.clone())
    }

    /// What GNSS did in all of the run; `None` without it.
    pub fn gnss_counts(&self) -> Option<GnssCounts> {
        self.estimator().and_then(Estimator::gnss_counts).or(self.before.gnss)
    }

    /// Adds a reading of the wheels. What the estimator refuses, it counts.
    pub fn wheels(&mut self, reading: WheelReading) {
        match &mut self.phase {
            Phase::Initializing(_) => {
                push_newest(&mut self.wheel_readings, reading, MAX_WHEEL_READINGS);
            }
            Phase::Running(estimator) => {
                let _ = estimator.wheels(reading);
            }
        }
    }

    /// Tries to initialize the estimator at an image; does nothing where it runs.
    ///
    /// # Returns
    /// How it was initialized now; `None` where it runs already, or cannot be initialized yet.
    ///
    /// # Errors
    /// [`EstimatorError::Config`] names the setting that cannot work.
    pub fn try_initialize(
        &mut self,
        stamp_ns: i64,
        tracks: &[TrackObservation],
    ) -> Result<Option<InitMethod>, EstimatorError> {
        let Phase::Initializing(initializer) = &mut self.phase else { return Ok(None) };
        let Initialization { initial, method } = match initializer.image(stamp_ns, tracks) {
            Ok(start) => start,
            Err(status) => {
                self.note_init_status(stamp_ns, status);
                return Ok(None);
            }
        };
        self.next_warning_ns = None;
        let mut estimator = Estimator::new(self.config.clone(), self.rig.clone(), &initial)?;
        if let Some(learned) = &self.learned_noise {
            estimator.resume_noise(learned);
        }
        if let Some(learned) = &self.learned_wheels {
            estimator.resume_wheels(learned);
        }
        estimator.resume_map(&self.map_knowledge);
        estimator.resume_counts(self.before.gnss, self.before.wheels.as_ref().map(|report| report.counts));
        for reading in initializer.readings_for(&initial) {
            match estimator.imu(*reading) {
                // It was dropped, as one of a running filter is.
                Err(error @ EstimatorError::BadImu(_)) => tracing::warn!(%error, "bad IMU reading"),
                taken => taken?,
            }
        }
        for reading in self.wheel_readings.drain(..) {
            let _ = estimator.wheels(reading);
        }
        self.started_ns = initial.stamp_ns - self.config.imu_stamp_ns(0);
        self.phase = Phase::Running(Box::new(estimator));
        Ok(Some(method))
    }

    /// Keeps the status of the initialization, and logs it when it takes long.
    fn note_init_status(&mut self, stamp_ns: i64, status: InitStatus) {
        self.init_status = status;
        let due_ns = *self.next_warning_ns.get_or_insert(stamp_ns + FIRST_WARNING_NS);
        if stamp_ns >= due_ns {
            tracing::warn!(%status, "no pose: the estimator is not initialized yet");
            self.next_warning_ns = Some(stamp_ns + WARN_EVERY_NS);
        }
    }

    /// Keeps the newest pose as the last trusted one, unless the estimator is suspicious.
    pub fn update_last_trusted(&mut self) {
        let Phase::Running(estimator) = &self.phase else { return };
        if !estimator.is_suspicious() {
            self.learned_noise = Some(estimator.learned_noise());
            self.learned_wheels = estimator.learned_wheels();
            self.last_trusted = Some(LastTrustedPose {
                stamp_ns: estimator.stamp_ns(),
                local_from_imu: estimator.local_from_imu(),
                velocity: estimator.velocity(),
                gyroscope_bias: estimator.biases().0,
            });
        }
    }

    /// Noise levels as learned up to now; `None` before the first image.
    pub fn learned_noise(&self) -> Option<LearnedNoise> {
        self.estimator().map(Estimator::learned_noise).or(self.learned_noise)
    }

    /// From when on [`EstimatorSupervisor::reinitialize`] needs the readings, nanoseconds; `None` during
    /// initialization.
    pub fn last_trusted_ns(&self) -> Option<i64> {
        self.estimator().and(self.last_trusted).map(|last| last.stamp_ns)
    }

    /// Drops a diverged estimator and begins the next initialization.
    ///
    /// # Arguments
    /// * `readings`: those up to now, from [`EstimatorSupervisor::last_trusted_ns`] on; they propagate the yaw.
    pub fn reinitialize(&mut self, now_ns: i64, why: &EstimatorError, readings: &[ImuSample]) {
        // A gap in the readings says nothing of the initialization.
        let is_gap = matches!(why, EstimatorError::Diverged(Divergence::MotionUnknown { .. }));
        let short = !is_gap && now_ns - self.started_ns < MIN_LIFE_NS;
        self.bad_initializations = if short { self.bad_initializations + 1 } else { 0 };
        let pause = if short { 2_f64.powi(self.bad_initializations - 1).min(MAX_PAUSE_S) } else { 0.0 };
        let not_before_ns = now_ns + (pause * 1e9) as i64;
        let mut initializer =
            Initializer::again(self.config.clone(), self.rig.clone(), self.last_trusted, not_before_ns);
        let from_ns = self.last_trusted.map_or(now_ns, |last| last.stamp_ns);
        let first = readings.partition_point(|reading| reading.stamp_ns < from_ns).saturating_sub(1);
        for reading in &readings[first.min(readings.len())..] {
            // Readings that the filter refused are refused here too.
            let _ = initializer.imu(*reading);
        }
        initializer.discard_rest();
        if let Phase::Running(estimator) = &self.phase {
            self.before = SensorReports::of(estimator);
            self.map_knowledge = estimator.map_knowledge();
        }
        self.phase = Phase::Initializing(Box::new(initializer));
        self.divergence = Some(why.to_string());
        self.init_status = InitStatus::NoData;
    }

    /// Status of the localization: [`Localization::Starting`] while the first initialization goes on.
    pub fn status(&self) -> Status {
        match &self.phase {
            Phase::Running(estimator) => estimator.status(),
            Phase::Initializing(_) => {
                let (localization, reason) = match &self.divergence {
                    Some(why) => (Localization::Lost, format!("{why}; {}", self.init_status)),
                    None => (Localization::Starting, self.init_status.to_string()),
                };
                Status { localization, reason, last_map_update_ns: None, held_keyframes: 0 }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use estimator::propagation::{ImuMatrix, ImuState};
    use estimator::{BaseKind, GnssConfig, InitialState, WheelBase, WheelConfig};
    use geometry::Pose;
    use geometry::camera::{Camera, Distortion};
    use nalgebra::{Matrix3, Vector2, Vector3};

    fn position(stamp_ns: i64, x: f64) -> GnssReading {
        GnssReading { stamp_ns, position: Vector3::x() * x, covariance: Matrix3::identity() * 1e-4 }
    }

    /// One camera, and a start at rest.
    fn at_rest() -> (Vec<CalibratedCamera>, InitialState) {
        let (focal, centre) = ([400.0; 2], [320.0, 240.0]);
        let camera = Camera { width: 640, height: 480, focal, centre, distortion: Distortion::None };
        let rig = vec![CalibratedCamera::new(camera, Pose::identity())];
        let imu = ImuState {
            local_from_imu: Pose::identity(),
            velocity: Vector3::zeros(),
            gyroscope_bias: Vector3::zeros(),
            accelerometer_bias: Vector3::zeros(),
        };
        let initial = InitialState { stamp_ns: 0, imu, covariance: ImuMatrix::identity() * 1e-4 };
        (rig, initial)
    }

    #[test]
    fn what_all_filters_of_a_run_did_with_gnss_is_counted_together() {
        let mut config = EstimatorConfig::default();
        config.gnss = Some(GnssConfig::default());
        let (rig, initial) = at_rest();
        let filter = || Estimator::new(config.clone(), rig.clone(), &initial).unwrap();
        let mut supervisor = EstimatorSupervisor::running(filter(), rig.clone());
        supervisor.gnss(position(1, f64::NAN));
        let why = EstimatorError::Diverged(Divergence::MotionUnknown { seconds: 2.0 });
        supervisor.reinitialize(10, &why, &[]);
        supervisor.gnss(position(11, 0.0));
        supervisor.gnss(position(12, 0.0));
        let counts = supervisor.gnss_counts().unwrap();
        assert_eq!((counts.refused, counts.before_initialization), (1, 2));
        let mut next = filter();
        next.resume_counts(Some(counts), None);
        assert_eq!(next.gnss_counts(), Some(counts));
        // Without an antenna there is nothing to count.
        let mut without = EstimatorSupervisor::initializing(EstimatorConfig::default(), rig);
        without.gnss(position(1, 0.0));
        assert_eq!(without.gnss_counts(), None);
    }

    /// The calibration may be what made a filter diverge.
    #[test]
    fn after_a_divergence_the_wheels_are_less_certain_than_they_were_learned() {
        let config = |sigma_radius_fraction: f64| {
            let mut wheels = WheelConfig::new(WheelBase::new(BaseKind::Differential, 0.1, 0.5));
            wheels.initial.sigma_radius_fraction = sigma_radius_fraction;
            let mut config = EstimatorConfig::default();
            config.wheels = Some(wheels);
            config
        };
        let (rig, initial) = at_rest();
        let learned = Estimator::new(config(1e-4), rig.clone(), &initial).unwrap();
        let mut supervisor = EstimatorSupervisor::initializing(config(0.02), rig);
        supervisor.learned_wheels = learned.learned_wheels();
        let mut stamp_ns = 0;
        while supervisor.estimator().is_none() && stamp_ns < 10_000_000_000 {
            for _ in 0..10 {
                let (gyroscope, accelerometer) = (Vector3::zeros(), Vector3::z() * 9.81);
                supervisor.imu(ImuSample { stamp_ns, gyroscope, accelerometer }).unwrap();
                stamp_ns += 5_000_000;
            }
            let at = |feature_id: u64| Vector2::new(30.0 * feature_id as f64, 240.0);
            let track = |feature_id| TrackObservation { camera: 0, feature_id, pixel: at(feature_id) };
            let tracks: Vec<TrackObservation> = (0..20).map(track).collect();
            supervisor.try_initialize(stamp_ns - 5_000_000, &tracks).unwrap();
        }
        let sigma_m = |report: WheelReport| report.geometry["radius_left_m"].sigma;
        let [before, after] =
            [learned.wheel_report(), supervisor.wheel_report()].map(|report| sigma_m(report.unwrap()));
        assert!((after / before - 10.0).abs() < 1e-6, "{before} m, and {after} m again");
    }
}
