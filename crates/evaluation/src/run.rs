//! The score of a run: local pose, `global_from_local` and pose in G, each with its error and its consistency.
//!
//! The pose in G alone cannot show a filter that gains information about yaw that is not there: the local pose and the
//! transform can be wrong while their product is right. So all three are always scored.
//!
//! The odometry frame L is defined by the run itself, and so is its true pose in G: L's z axis points against gravity, and
//! the first estimate has no error in position and none in the rotation about z.

use super::alignment::PositionSums;
use super::alignment::rotation_between;
use super::frame_alignment::MapFromTruth;
use super::statistics::RunningStatistics;
use super::{Alignment, Nees, NeesSum, Statistics, nees};
use crate::trajectory::{StateKind, StateRow};
use geometry::pose::Pose;
use geometry::uncertain_pose::PoseWithCovariance;
use nalgebra::{UnitQuaternion, Vector3, Vector6};
use sensors::{Rows, SequenceError, TruthRow, TruthTrack};
use serde::Serialize;
use thiserror::Error;

/// Truth is interpolated between rows that are at most so far apart.
pub const MAX_TRUTH_GAP_NS: i64 = 250_000_000;

/// Which part of a run is scored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScoreOptions {
    /// Time after the map initialization from which on the transform and the pose in G are scored, seconds.
    pub skip_after_initialization_s: f64,
    /// Direction of gravity in a map whose frame is its own, since it was built without reference poses: the truth is aligned
    /// with the poses in the map, in yaw and position, before they are compared, and of these there is no NEES. `None`: both
    /// are in one frame.
    pub gravity_in_own_frame: Option<Vector3<f64>>,
}

impl Default for ScoreOptions {
    fn default() -> Self {
        Self { skip_after_initialization_s: 5.0, gravity_in_own_frame: None }
    }
}

/// Why a run could not be scored.
#[derive(Debug, Error)]
pub enum ScoreError {
    /// There is no instant at which both the estimate and the truth are known.
    #[error("no estimate lies within the time of the ground truth: is it the ground truth of this run?")]
    NoOverlap,
    /// The states or the truth cannot be read.
    #[error(transparent)]
    Unreadable(#[from] SequenceError),
}

/// The score of one of the three poses.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Score {
    /// Root mean square of the rotation error, degrees.
    pub rmse_deg: f64,
    /// Root mean square of the position error, metres.
    pub rmse_m: f64,
    /// Largest rotation error, degrees.
    pub max_deg: f64,
    /// Largest position error, metres.
    pub max_m: f64,
    /// Mean NEES per degree of freedom of the rotation; `None` where no covariance was positive definite, or where the truth was
    /// aligned with the estimate.
    pub nees_rotation: Option<f64>,
    /// The same of the position.
    pub nees_position: Option<f64>,
    /// The same of the whole pose.
    pub nees_pose: Option<f64>,
    /// Number of scored instants.
    pub samples: usize,
    /// How many of them have a covariance that is positive definite: the NEES is that of these.
    pub nees_samples: usize,
}

impl Score {
    /// The score without its NEES.
    fn without_nees(self) -> Self {
        Self { nees_rotation: None, nees_position: None, nees_pose: None, ..self }
    }
}

/// The score of a run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RunScore {
    /// `local_from_imu`, over the whole run.
    pub local: Score,
    /// `global_from_local`, from some time after the map initialization on.
    pub transform: Option<Score>,
    /// `global_from_imu`, from some time after the map initialization on; not aligned, unless `map_from_truth` is there.
    pub pose: Option<Score>,
    /// The alignment of the truth with the map, where the map's frame is its own.
    pub map_from_truth: Option<MapFromTruth>,
    /// Position error of `local_from_imu` over the whole run after alignment in yaw and position, metres.
    pub odometry_yaw_aligned_m: Statistics,
    /// Rotation error of the same, degrees.
    pub odometry_yaw_aligned_deg: Statistics,
    /// True length of the path, metres.
    pub distance_m: f64,
    /// Time from the first to the last scored estimate, seconds.
    pub duration_s: f64,
    /// Time from the first estimate to the map initialization, seconds.
    pub map_initialization_s: Option<f64>,
}

impl RunScore {
    /// The score without the NEES of the transform and of the pose in G.
    ///
    /// For a truth that was aligned with the estimated poses in G: the constant part of their errors in yaw and position is gone,
    /// and their covariances are those of the whole errors.
    #[must_use]
    pub fn without_nees_in_map(&self) -> Self {
        Self {
            transform: self.transform.map(Score::without_nees),
            pose: self.pose.map(Score::without_nees),
            ..*self
        }
    }
}

/// One error of one pose, with the standard deviations that the filter claims.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ErrorSample {
    /// Time, nanoseconds.
    pub stamp_ns: i64,
    /// `[dtheta, dp]` from the estimate to the truth, parent frame, rad and metres.
    pub error: Vector6<f64>,
    /// Standard deviation of each component by the filter's covariance.
    pub sigma: Vector6<f64>,
    /// NEES, where the covariance was positive definite.
    pub nees: Option<Nees>,
}

/// All errors of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct RunErrors {
    /// The true pose of L in G.
    pub true_global_from_local: Pose,
    /// Of `local_from_imu`.
    pub local: Vec<ErrorSample>,
    /// Of `global_from_local`.
    pub transform: Vec<ErrorSample>,
    /// Of `global_from_imu`.
    pub pose: Vec<ErrorSample>,
}

impl RunErrors {
    /// The errors of one of the three poses.
    pub fn get(&self, kind: StateKind) -> &[ErrorSample] {
        match kind {
            StateKind::LocalFromImu => &self.local,
            StateKind::GlobalFromLocal => &self.transform,
            StateKind::GlobalFromImu => &self.pose,
        }
    }
}

/// The errors of each output of a run.
///
/// # Arguments
/// * `truth`: of the IMU in G; interpolated over gaps up to 0.25 s.
/// * `gravity_in_truth`: unit direction of gravity in the truth's frame.
///
/// # Errors
/// [`ScoreError::NoOverlap`].
pub fn run_errors(
    states: &[StateRow],
    truth: &[TruthRow],
    gravity_in_truth: Vector3<f64>,
) -> Result<RunErrors, ScoreError> {
    let known = known_states(states, truth);
    let (first, first_true) = known.first().ok_or(ScoreError::NoOverlap)?;
    let global_from_local = true_global_from_local(&first.local_from_imu.pose, first_true, &gravity_in_truth);
    Ok(errors_of(&known, global_from_local))
}

/// The errors of each output of a run where the true pose of L is known, as in a simulation.
///
/// # Arguments
/// * `truth`: of the IMU in G; interpolated over gaps up to 0.25 s.
/// * `true_global_from_local`: the true pose of L in G.
///
/// # Errors
/// [`ScoreError::NoOverlap`].
pub fn run_errors_in(
    states: &[StateRow],
    truth: &[TruthRow],
    true_global_from_local: Pose,
) -> Result<RunErrors, ScoreError> {
    let known = known_states(states, truth);
    if known.is_empty() {
        return Err(ScoreError::NoOverlap);
    }
    Ok(errors_of(&known, true_global_from_local))
}

fn errors_of(known: &[(&StateRow, Pose)], global_from_local: Pose) -> RunErrors {
    let local_from_global = global_from_local.inverse();
    let mut errors = RunErrors {
        true_global_from_local: global_from_local,
        local: Vec::with_capacity(known.len()),
        transform: Vec::new(),
        pose: Vec::new(),
    };
    for (state, global_from_imu) in known {
        let local_from_imu = local_from_global.compose(global_from_imu);
        errors.local.push(sample(state.stamp_ns, &state.local_from_imu, &local_from_imu));
        if let Some(estimate) = &state.global_from_local {
            errors.transform.push(sample(state.stamp_ns, estimate, &global_from_local));
        }
        if let Some(estimate) = &state.global_from_imu {
            errors.pose.push(sample(state.stamp_ns, estimate, global_from_imu));
        }
    }
    errors
}

/// Scores a run; see [`run_errors`] for the arguments.
///
/// # Errors
/// [`ScoreError::NoOverlap`].
pub fn score_run(
    states: &[StateRow],
    truth: &[TruthRow],
    gravity_in_truth: Vector3<f64>,
    options: &ScoreOptions,
) -> Result<RunScore, ScoreError> {
    let states = || -> Result<Rows<'_, StateRow>, _> { Ok(Box::new(states.iter().cloned().map(Ok))) };
    let truth = || -> Result<Rows<'_, TruthRow>, _> { Ok(Box::new(truth.iter().copied().map(Ok))) };
    score_rows(states, truth, gravity_in_truth, options)
}

/// Scores a run of any length in constant memory.
///
/// # Arguments
/// * `states`, `truth`: each call opens the rows from their beginning; both are read twice.
/// * `gravity_in_truth`: unit direction of gravity in the truth's frame.
///
/// # Errors
/// [`ScoreError`].
pub fn score_rows<'a>(
    states: impl Fn() -> Result<Rows<'a, StateRow>, SequenceError>,
    truth: impl Fn() -> Result<Rows<'a, TruthRow>, SequenceError>,
    gravity_in_truth: Vector3<f64>,
    options: &ScoreOptions,
) -> Result<RunScore, ScoreError> {
    let overview = Overview::of(states()?, truth()?, options)?;
    let (first, first_true) = overview.first_known.as_ref().ok_or(ScoreError::NoOverlap)?;
    let map_from_truth = options.gravity_in_own_frame.and_then(|gravity_in_map| {
        MapFromTruth::of(&overview.positions_in_map, gravity_in_map, gravity_in_truth)
    });
    let in_map = |truth: &Pose| map_from_truth.map_or(*truth, |aligned| aligned.pose().compose(truth));
    let gravity_in_global = map_from_truth.map_or(gravity_in_truth, |aligned| aligned.gravity());
    let first_in_map = in_map(first_true);
    let global_from_local =
        true_global_from_local(&first.local_from_imu.pose, &first_in_map, &gravity_in_global);
    let local_from_global = global_from_local.inverse();
    let alignment =
        Alignment::Yaw { gravity_in_reference: gravity_in_truth, gravity_in_estimate: -Vector3::z() };
    let aligned = overview.positions.align(&alignment).map_err(|_| ScoreError::NoOverlap)?;
    let initialized = overview.initialized_ns;
    let from = initialized
        .map_or(i64::MAX, |stamp_ns| stamp_ns + (options.skip_after_initialization_s * 1e9) as i64);

    let (mut local, mut transform, mut pose) = <(ScoreSum, ScoreSum, ScoreSum)>::default();
    let (mut metres, mut degrees) = <(RunningStatistics, RunningStatistics)>::default();
    for known in KnownStates::new(states()?, truth()?) {
        let (state, truth) = known?;
        let global_from_imu = in_map(&truth);
        local.push(&state.local_from_imu, &local_from_global.compose(&global_from_imu));
        let odometry = aligned.compose(&state.local_from_imu.pose);
        metres.push((truth.translation - odometry.translation).norm());
        degrees.push(truth.rotation.angle_to(&odometry.rotation).to_degrees());
        if state.stamp_ns < from {
            continue;
        }
        if let Some(estimate) = &state.global_from_local {
            transform.push(estimate, &global_from_local);
        }
        if let Some(estimate) = &state.global_from_imu {
            pose.push(estimate, &global_from_imu);
        }
    }
    let score = RunScore {
        local: local.score().ok_or(ScoreError::NoOverlap)?,
        transform: transform.score(),
        pose: pose.score(),
        map_from_truth,
        odometry_yaw_aligned_m: metres.statistics().ok_or(ScoreError::NoOverlap)?,
        odometry_yaw_aligned_deg: degrees.statistics().ok_or(ScoreError::NoOverlap)?,
        distance_m: overview.distance_m,
        duration_s: seconds(first.stamp_ns, overview.last_known_ns),
        map_initialization_s: initialized
            .zip(overview.first_ns)
            .map(|(stamp_ns, first_ns)| seconds(first_ns, stamp_ns)),
    };
    Ok(if map_from_truth.is_some() { score.without_nees_in_map() } else { score })
}

/// What the scoring of a run needs before it can begin, from a first pass.
#[derive(Default)]
struct Overview {
    first_ns: Option<i64>,
    /// Time of the first pose in G.
    initialized_ns: Option<i64>,
    first_known: Option<(StateRow, Pose)>,
    last_known_ns: i64,
    positions: PositionSums,
    /// Pairs of position in the map and in the truth.
    positions_in_map: PositionSums,
    distance_m: f64,
}

impl Overview {
    fn of(
        states: Rows<'_, StateRow>,
        truth: Rows<'_, TruthRow>,
        options: &ScoreOptions,
    ) -> Result<Self, ScoreError> {
        let (mut first_ns, mut initialized_ns) = (None, None);
        let observed = states.inspect(|state| {
            let Ok(state) = state else { return };
            first_ns.get_or_insert(state.stamp_ns);
            if state.global_from_imu.is_some() {
                initialized_ns.get_or_insert(state.stamp_ns);
            }
        });
        let mut overview = Self::default();
        let mut before: Option<Vector3<f64>> = None;
        let skipped_ns = (options.skip_after_initialization_s * 1e9) as i64;
        let mut first_scored_ns: Option<i64> = None;
        for known in KnownStates::new(Box::new(observed), truth) {
            let (state, truth) = known?;
            let here = truth.translation;
            overview.distance_m += before.replace(here).map_or(0.0, |before| (here - before).norm());
            overview.positions.push(&here, &state.local_from_imu.pose.translation);
            if let Some(estimate) = &state.global_from_imu {
                let scored_ns = *first_scored_ns.get_or_insert(state.stamp_ns + skipped_ns);
                if state.stamp_ns >= scored_ns {
                    overview.positions_in_map.push(&estimate.pose.translation, &here);
                }
            }
            overview.last_known_ns = state.stamp_ns;
            overview.first_known.get_or_insert((state, truth));
        }
        Ok(Self { first_ns, initialized_ns, ..overview })
    }
}

/// The states whose truth is known, with it.
struct KnownStates<'a> {
    states: Rows<'a, StateRow>,
    truth: Rows<'a, TruthRow>,
    /// The rows of truth on both sides of the newest state; two at most.
    around: Vec<TruthRow>,
}

impl<'a> KnownStates<'a> {
    fn new(states: Rows<'a, StateRow>, truth: Rows<'a, TruthRow>) -> Self {
        Self { states, truth, around: Vec::with_capacity(3) }
    }

    fn truth_at(&mut self, stamp_ns: i64) -> Result<Option<Pose>, SequenceError> {
        while self.around.last().is_none_or(|last| last.stamp_ns < stamp_ns) {
            let Some(row) = self.truth.next().transpose()? else { break };
            self.around.push(row);
            if self.around.len() > 2 {
                self.around.remove(0);
            }
        }
        Ok(TruthTrack::new(&self.around).pose(stamp_ns, MAX_TRUTH_GAP_NS))
    }
}

impl Iterator for KnownStates<'_> {
    type Item = Result<(StateRow, Pose), SequenceError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            let state = match self.states.next()? {
                Ok(state) => state,
                Err(error) => return Some(Err(error)),
            };
            match self.truth_at(state.stamp_ns) {
                Ok(Some(truth)) => return Some(Ok((state, truth))),
                Ok(None) => {}
                Err(error) => return Some(Err(error)),
            }
        }
    }
}

fn seconds(from_ns: i64, to_ns: i64) -> f64 {
    (to_ns - from_ns) as f64 * 1e-9
}

/// The states whose truth is known, with it.
fn known_states<'a>(states: &'a [StateRow], truth: &[TruthRow]) -> Vec<(&'a StateRow, Pose)> {
    let track = TruthTrack::new(truth);
    let known = |state: &'a StateRow| track.pose(state.stamp_ns, MAX_TRUTH_GAP_NS).map(|pose| (state, pose));
    states.iter().filter_map(known).collect()
}

/// The true `global_from_local`: L's z axis points against gravity, and the first estimate has no error in position and in
/// the rotation about z.
fn true_global_from_local(
    local_from_imu: &Pose,
    global_from_imu: &Pose,
    gravity_in_global: &Vector3<f64>,
) -> Pose {
    let level = rotation_between(gravity_in_global, &-Vector3::z());
    // The rotation error is Exp(e) = Rz(-yaw) level^T R_GI R_LI^T; its quaternion must have no z component.
    let error = level.inverse() * global_from_imu.rotation * local_from_imu.rotation.inverse();
    let yaw = 2.0 * error.k.atan2(error.w);
    let rotation = level * UnitQuaternion::from_scaled_axis(Vector3::z() * yaw);
    Pose::new(rotation, global_from_imu.translation - rotation * local_from_imu.translation)
}

fn sample(stamp_ns: i64, estimate: &PoseWithCovariance, truth: &Pose) -> ErrorSample {
    ErrorSample {
        stamp_ns,
        error: estimate.pose.local(truth),
        sigma: estimate.covariance.diagonal().map(|variance| variance.max(0.0).sqrt()),
        nees: nees(estimate, truth),
    }
}

/// Sums over the errors of one of the three poses.
#[derive(Default)]
struct ScoreSum {
    square_rad: f64,
    square_m: f64,
    max_rad: f64,
    max_m: f64,
    nees: NeesSum,
    samples: usize,
}

impl ScoreSum {
    fn push(&mut self, estimate: &PoseWithCovariance, truth: &Pose) {
        let error = estimate.pose.local(truth);
        let (rotation, position) = (error.fixed_rows::<3>(0).norm(), error.fixed_rows::<3>(3).norm());
        self.square_rad += rotation * rotation;
        self.square_m += position * position;
        self.max_rad = self.max_rad.max(rotation);
        self.max_m = self.max_m.max(position);
        if let Some(nees) = nees(estimate, truth) {
            self.nees.push(&nees);
        }
        self.samples += 1;
    }

    fn score(&self) -> Option<Score> {
        let count = self.samples as f64;
        let mean = self.nees.mean();
        (self.samples > 0).then(|| Score {
            rmse_deg: (self.square_rad / count).sqrt().to_degrees(),
            rmse_m: (self.square_m / count).sqrt(),
            max_deg: self.max_rad.to_degrees(),
            max_m: self.max_m,
            nees_rotation: mean.map(|nees| nees.rotation),
            nees_position: mean.map(|nees| nees.position),
            nees_pose: mean.map(|nees| nees.pose),
            samples: self.samples,
            nees_samples: self.nees.samples(),
        })
    }
}
