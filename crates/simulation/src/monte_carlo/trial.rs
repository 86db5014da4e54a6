//! One run: a seed's world, and each variant of the filter on it.

use super::answers::Answer;
use super::calibration::Stated;
use super::disturbance::{DisturbedState, THREE_SIGMA};
use super::map_change::{MapChange, answers_and_change};
use super::{CalibrationError, FilterStart, MonteCarloOptions, Rescue, Variant, global_from_world, start};
use crate::run::Kind;
use crate::{SimulatedWorld, SimulationError, simulate_world};
use estimator::{
    Alarm, CalibratedCamera, CloneId, Estimated, Estimator, EstimatorError, GnssCounts, GnssReading,
    ImuSample, Initializer, Localization, MapMode, TrackObservation, WheelReading, WheelReport,
};
use evaluation::trajectory::StateRow;
use evaluation::{RunErrors, nees, run_errors, run_errors_in};
use geometry::Pose;
use nalgebra::Vector3;
use sensors::{Frame, Sequence, TruthRow};
use serde::Serialize;

/// Counts of the map's replies.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct MapCounts {
    /// Replies of the right place.
    pub answers: usize,
    /// Of these, used in an update.
    pub used: usize,
    /// Replies of a wrong place.
    pub wrong_places: usize,
    /// Of these, used in an update.
    pub wrong_places_used: usize,
    /// Updates that moved the pose in G by more than its 3 sigma (99.73 % of 6 degrees of freedom).
    pub jumps: usize,
}

/// One run of one variant.
#[derive(Clone, Debug)]
pub struct Trial {
    /// Its seed.
    pub seed: u64,
    /// Time of the first image, nanoseconds.
    pub begin_ns: i64,
    /// All its errors; `None` where the filter failed on the first image.
    pub errors: Option<RunErrors>,
    /// Time of the map initialization, seconds since the begin.
    pub map_initialization_s: Option<f64>,
    /// Counts of the map's replies.
    pub map: MapCounts,
    /// When the watch over the map first raised an alarm, seconds since the begin.
    pub alarm_s: Option<f64>,
    /// Whether the filter was localized in the map at the end.
    pub localized: bool,
    /// The rescues after the failures of the disturbance, in their order. What else is stated of such a run is that until them.
    pub rescues: Vec<Rescue>,
    /// Why it ended early.
    pub diverged: Option<String>,
    /// Errors of the calibration that the filter was given, by camera.
    pub stated_calibration: Vec<CalibrationError>,
    /// Errors of the filter's own calibration at the end, by camera.
    pub estimated_calibration: Vec<CalibrationError>,
    /// Readout time of each camera at the end, seconds; `None` for a filter that knows of no rolling shutter.
    pub readout_times: Option<Vec<Estimated>>,
    /// What the wheels did, and their calibration at the end; `None` without them.
    pub wheels: Option<WheelReport>,
    /// When the wheels were first left out, seconds since the begin.
    pub wheels_left_out_s: Option<f64>,
    /// What GNSS did; `None` without it.
    pub gnss: Option<GnssCounts>,
    /// When GNSS was first left out, seconds since the begin.
    pub gnss_left_out_s: Option<f64>,
}

/// What all variants of a seed share.
struct Seed<'a> {
    number: u64,
    world: SimulatedWorld,
    live: Sequence,
    /// Replies to the frames of `live`.
    answers: Vec<Option<Answer>>,
    change: Option<MapChange>,
    /// Empty without wheels.
    wheels: Vec<WheelReading>,
    /// Empty without GNSS.
    gnss: Vec<GnssReading>,
    global_from_world: Pose,
    options: &'a MonteCarloOptions,
}

/// Runs all variants on one seed.
pub(crate) fn run_seed(
    options: &MonteCarloOptions,
    seed: u64,
    variants: &[Variant],
) -> Result<Vec<Trial>, SimulationError> {
    let simulation = crate::SimulationOptions { seed, ..options.simulation.clone() };
    let world = simulate_world(&simulation)?;
    let live = world.record(&simulation, Kind::Live);
    let uses_map = variants.iter().any(|variant| variant.config.mode != MapMode::Odometry);
    let (answers, change) = if uses_map {
        answers_and_change(options, &simulation, &world, &live.frames)
    } else {
        (live.frames.iter().map(|_| None).collect(), None)
    };
    let wheels = options.wheels.as_ref();
    let wheels = wheels.map(|wheels| wheels.record(seed, &world.live_trajectory)).unwrap_or_default();
    let global_from_world = if uses_map { global_from_world() } else { Pose::identity() };
    let gnss = options.gnss.as_ref();
    let gnss =
        gnss.map(|gnss| gnss.record(seed, &world.live_trajectory, &global_from_world)).unwrap_or_default();
    let one = Seed { number: seed, world, live, answers, change, wheels, gnss, global_from_world, options };
    Ok(variants.iter().map(|variant| one.run(variant)).collect())
}

/// A run in progress.
#[derive(Clone)]
struct Player<'a> {
    estimator: Estimator,
    next_frame: usize,
    next_reading: usize,
    next_wheels: usize,
    next_gnss: usize,
    /// The reply to the previous image, with that image's clone.
    pending: Option<(CloneId, &'a Answer)>,
    states: Vec<StateRow>,
    map: MapCounts,
    alarm_ns: Option<i64>,
    wheels_left_out_ns: Option<i64>,
    gnss_left_out_ns: Option<i64>,
    /// The next initialization: the first one, or where the estimator gave up after a disturbance.
    initializer: Option<Initializer>,
    rescue: Option<Rescue>,
    /// An answer came with the newest image.
    is_answered: bool,
}

impl Seed<'_> {
    fn run(&self, variant: &Variant) -> Trial {
        let truth: Vec<CalibratedCamera> = self
            .world
            .cameras
            .iter()
            .take(variant.cameras)
            .map(|sensor| CalibratedCamera {
                camera: sensor.camera.clone(),
                imu_from_camera: sensor.imu_from_camera,
                readout_s: sensor.readout_s,
                delay_s: sensor.delay_s(),
            })
            .collect();
        let stated = self.options.calibration.draw(self.number, &truth);
        let true_delay_s = stated.image_delay_ns as f64 * 1e-9;
        let stated_calibration = stated
            .rig
            .iter()
            .zip(&truth)
            .map(|(given, truth)| CalibrationError::of(given, truth, (0.0, true_delay_s)))
            .collect();
        let begin_ns = self.live.frames.first().map_or(0, |frame| frame.stamp_ns + stated.image_delay_ns);
        let start = self.start(variant, begin_ns);
        let mut trial = Trial {
            seed: self.number,
            begin_ns,
            errors: None,
            map_initialization_s: None,
            map: MapCounts::default(),
            alarm_s: None,
            localized: false,
            rescues: Vec::new(),
            diverged: None,
            stated_calibration,
            estimated_calibration: Vec::new(),
            readout_times: None,
            wheels: None,
            wheels_left_out_s: None,
            gnss: None,
            gnss_left_out_s: None,
        };
        let estimator = match Estimator::new(variant.config.clone(), stated.rig.clone(), &start.initial) {
            Ok(estimator) => estimator,
            Err(error) => {
                trial.diverged = Some(error.to_string());
                return trial;
            }
        };
        let initializes = self.options.start == FilterStart::Initialization;
        let mut player = Player {
            estimator,
            next_frame: 0,
            next_reading: 0,
            next_wheels: 0,
            next_gnss: 0,
            pending: None,
            states: Vec::new(),
            map: MapCounts::default(),
            alarm_ns: None,
            wheels_left_out_ns: None,
            gnss_left_out_ns: None,
            initializer: initializes.then(|| Initializer::new(variant.config.clone(), stated.rig.clone())),
            rescue: None,
            is_answered: false,
        };
        let played = self.play(&mut player, variant, &stated);
        let rescues = played.and_then(|()| self.disturb(&player, variant, &stated));
        match rescues {
            Ok(rescues) => trial.rescues = rescues,
            Err(error) => trial.diverged = Some(error.to_string()),
        }
        let initialized = player.states.iter().find(|state| state.global_from_imu.is_some());
        trial.map_initialization_s = initialized.map(|state| (state.stamp_ns - begin_ns) as f64 * 1e-9);
        trial.map = player.map;
        trial.alarm_s = player.alarm_ns.map(|alarm_ns| (alarm_ns - begin_ns) as f64 * 1e-9);
        trial.localized = player.estimator.status().localization == Localization::Localized;
        let found = player.estimator.calibration();
        let delays = (-found.time_offset, true_delay_s);
        let cameras = found.cameras.iter().zip(&truth);
        trial.estimated_calibration =
            cameras.map(|(found, truth)| CalibrationError::of(found, truth, delays)).collect();
        trial.readout_times = player.estimator.readout_times();
        trial.wheels = player.estimator.wheel_report();
        let seconds = |stamp_ns: i64| (stamp_ns - begin_ns) as f64 * 1e-9;
        trial.wheels_left_out_s = player.wheels_left_out_ns.map(seconds);
        trial.gnss = player.estimator.gnss_counts();
        trial.gnss_left_out_s = player.gnss_left_out_ns.map(seconds);
        let truth = self.truth(&player.states);
        trial.errors = if initializes {
            let gravity_in_global = self.global_from_world.rotation * -Vector3::z();
            run_errors(&player.states, &truth, gravity_in_global).ok()
        } else {
            run_errors_in(&player.states, &truth, start.global_from_local).ok()
        };
        if trial.errors.is_none() && trial.diverged.is_none() {
            trial.diverged = Some("never initialized".to_owned());
        }
        trial
    }

    fn start(&self, variant: &Variant, begin_ns: i64) -> start::Start {
        let motion = self.world.live_trajectory.at(begin_ns);
        let rows = self.live.groundtruth.as_deref().unwrap_or_default();
        let row = rows.iter().rfind(|row| row.stamp_ns <= begin_ns);
        let biases = row.and_then(|row| row.gyroscope_bias.zip(row.accelerometer_bias)).unwrap_or_default();
        let initial = variant.config.initial;
        let sigmas = match self.options.start {
            FilterStart::KnownBiases => initial.with_known_biases(),
            FilterStart::UnknownBiases | FilterStart::Initialization => initial,
        };
        start::draw(self.number, begin_ns, &motion, biases, &sigmas, &self.global_from_world)
    }

    /// Plays a run to its end, or to where it is disturbed.
    fn play<'a>(
        &'a self,
        player: &mut Player<'a>,
        variant: &Variant,
        stated: &Stated,
    ) -> Result<(), EstimatorError> {
        let readings = &self.live.imu_samples;
        while let Some(frame) = self.live.frames.get(player.next_frame) {
            let answer = self.answers[player.next_frame].as_ref();
            let stamp_ns = frame.stamp_ns + stated.image_delay_ns;
            if stamp_ns > self.world.live_trajectory.end_ns() {
                break;
            }
            player.next_frame += 1;
            let until_ns = player.estimator.last_row_ns(stamp_ns);
            let due = readings[player.next_reading..].partition_point(|reading| reading.stamp_ns <= until_ns);
            // With the reading after the image: between two of them it is interpolated.
            let end = (player.next_reading + due + 1).min(readings.len());
            for reading in &readings[player.next_reading..end] {
                player.imu(*reading)?;
            }
            player.next_reading = end;
            while let Some(reading) =
                self.wheels.get(player.next_wheels).filter(|next| next.stamp_ns <= until_ns)
            {
                player.next_wheels += 1;
                // What is refused is counted.
                let _ = player.estimator.wheels(*reading);
            }
            while let Some(reading) = self.gnss.get(player.next_gnss).filter(|next| next.stamp_ns <= until_ns)
            {
                player.next_gnss += 1;
                let _ = player.estimator.gnss(*reading);
            }
            let change = self.change.as_ref().filter(|change| change.stamp_ns == frame.stamp_ns);
            match player.frame(frame, stamp_ns, variant, answer, change) {
                // It gave up for the disturbance, and continues.
                Err(EstimatorError::Diverged(_)) if player.rescue.is_some() => {
                    player.pending = None;
                    player.initializer = Some(Initializer::new(variant.config.clone(), stated.rig.clone()));
                }
                done => done?,
            }
            if self.change.as_ref().is_some_and(|change| frame.stamp_ns < change.stamp_ns) {
                player.states.clear();
            }
            if player.rescue.is_none() && self.is_disturbed(frame.stamp_ns) {
                return Ok(());
            }
            self.note_rescue(player);
        }
        Ok(())
    }

    /// Whether the filter is disturbed by then.
    fn is_disturbed(&self, stamp_ns: i64) -> bool {
        let begin_ns = self.live.frames.first().map_or(0, |frame| frame.stamp_ns);
        let seconds = (stamp_ns - begin_ns) as f64 * 1e-9;
        self.options.disturbance.as_ref().is_some_and(|disturbance| seconds >= disturbance.at_s)
    }

    /// Continues a run after each of the failures.
    fn disturb<'a>(
        &'a self,
        player: &Player<'a>,
        variant: &Variant,
        stated: &Stated,
    ) -> Result<Vec<Rescue>, EstimatorError> {
        let states = self.options.disturbance.iter().flat_map(|disturbance| &disturbance.states);
        let rescue = |state: &DisturbedState| {
            let mut disturbed = player.clone();
            state.apply(self.number, &mut disturbed.estimator);
            disturbed.rescue = Some(Rescue::default());
            self.play(&mut disturbed, variant, stated)?;
            Ok(disturbed.rescue.unwrap_or_default())
        };
        states.map(rescue).collect()
    }

    fn note_rescue(&self, player: &mut Player<'_>) {
        if let Some(rescue) = player.rescue.as_mut().filter(|_| player.initializer.is_none()) {
            let truth = self.world.live_trajectory.at(player.estimator.stamp_ns()).pose;
            rescue.note(&player.estimator, &(self.global_from_world * truth), player.is_answered);
        }
    }

    /// The truth at the stamps that the filter was given.
    fn truth(&self, states: &[StateRow]) -> Vec<TruthRow> {
        let row = |state: &StateRow| TruthRow {
            stamp_ns: state.stamp_ns,
            pose: self.global_from_world * self.world.live_trajectory.at(state.stamp_ns).pose,
            velocity: None,
            gyroscope_bias: None,
            accelerometer_bias: None,
        };
        states.iter().map(row).collect()
    }
}

impl<'a> Player<'a> {
    fn imu(&mut self, reading: ImuSample) -> Result<(), EstimatorError> {
        match &mut self.initializer {
            Some(initializer) => Ok(initializer.imu(reading)?),
            None => self.estimator.imu(reading),
        }
    }

    /// Whether the estimator runs, after a try to initialize it where it does not.
    fn is_running(&mut self, stamp_ns: i64, tracks: &[TrackObservation]) -> Result<bool, EstimatorError> {
        let Some(initializer) = &mut self.initializer else { return Ok(true) };
        let Ok(found) = initializer.image(stamp_ns, tracks) else { return Ok(false) };
        let rig = self.estimator.calibration().cameras.clone();
        let mut estimator = Estimator::new(self.estimator.config().clone(), rig, &found.initial)?;
        for reading in initializer.readings_for(&found.initial) {
            estimator.imu(*reading)?;
        }
        self.estimator = estimator;
        self.initializer = None;
        Ok(true)
    }

    /// One image. As in a robot, the reply to an image arrives with the next one.
    fn frame(
        &mut self,
        frame: &Frame,
        stamp_ns: i64,
        variant: &Variant,
        answer: Option<&'a Answer>,
        change: Option<&MapChange>,
    ) -> Result<(), EstimatorError> {
        let used = |track: &&TrackObservation| usize::from(track.camera) < variant.cameras;
        let tracks: Vec<TrackObservation> = frame.tracks.iter().filter(used).copied().collect();
        self.is_answered = false;
        if !self.is_running(stamp_ns, &tracks)? {
            return Ok(());
        }
        let clone = self.estimator.time_update(stamp_ns)?;
        let are_wheels_out = self.estimator.alarms().iter().any(|alarm| matches!(alarm, Alarm::Wheels(_)));
        if are_wheels_out {
            self.wheels_left_out_ns.get_or_insert(stamp_ns);
        }
        if self.estimator.alarms().iter().any(|alarm| matches!(alarm, Alarm::Gnss(_))) {
            self.gnss_left_out_ns.get_or_insert(stamp_ns);
        }
        self.estimator.track_update(&tracks)?;
        if let Some(change) = change {
            self.estimator.map_changed(&change.revision);
        }
        if let Some((queried, answer)) = self.pending.take() {
            self.map_update(queried, answer)?;
        }
        self.states.push(StateRow {
            stamp_ns: self.estimator.stamp_ns(),
            local_from_imu: self.estimator.local_from_imu(),
            global_from_local: self.estimator.global_from_local(),
            global_from_imu: self.estimator.global_from_imu(),
        });
        if let Some(answer) = answer.filter(|_| variant.config.mode != MapMode::Odometry) {
            self.estimator.pin(clone);
            self.pending = Some((clone, answer));
        }
        Ok(())
    }

    fn map_update(&mut self, queried: CloneId, answer: &Answer) -> Result<(), EstimatorError> {
        let before = self.estimator.global_from_imu();
        let mut seen = answer.answer.clone();
        for landmark in &mut seen.landmarks {
            landmark.pixel = self.estimator.still_pixel(queried, 0, &landmark.pixel);
        }
        let report = self.estimator.map_update(queried, &seen)?;
        self.estimator.unpin(queried);
        let is_alarm = self.estimator.alarms().iter().any(|alarm| matches!(alarm, Alarm::Drift(_)));
        if is_alarm {
            self.alarm_ns.get_or_insert(self.estimator.stamp_ns());
        }
        self.is_answered = true;
        let counts = &mut self.map;
        let (count, used) = if answer.is_wrong_place {
            (&mut counts.wrong_places, &mut counts.wrong_places_used)
        } else {
            (&mut counts.answers, &mut counts.used)
        };
        *count += 1;
        *used += usize::from(report.rejection.is_none());
        let moved = before.zip(self.estimator.global_from_imu());
        let far = moved.and_then(|(before, after)| nees(&before, &after.pose));
        counts.jumps += usize::from(far.is_some_and(|far| far.pose * 6.0 > THREE_SIGMA));
        Ok(())
    }
}
