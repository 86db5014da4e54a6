//! The latest of what a robot published.

use crate::history::{History, Observed, SampledPose, ShownState};
use crate::queries::{ViewedQuery, ViewedResult};
use crate::viewed_map::{position_covariance, rotation_wxyz};
use geometry::PoseWithCovariance;
use protocol::{KeyframeId, MatchOutcome, Presence, Published, RobotState};
use serde::Serialize;
use std::time::Instant;

/// The answer to a query of a robot.
#[derive(Serialize)]
struct Answer {
    /// The map that was asked.
    map: String,
    /// The keyframes that matched; none for an image that was not recognized.
    keyframes: Vec<KeyframeId>,
}

/// A pose as the page draws it.
#[derive(Serialize)]
struct ViewedPose {
    position: [f64; 3],
    rotation_wxyz: [f64; 4],
    /// m^2, by rows.
    position_covariance: [[f64; 3]; 3],
    sigma_theta_rad: f64,
}

impl ViewedPose {
    fn of(pose: &PoseWithCovariance) -> Self {
        Self {
            position: pose.pose.translation.into(),
            rotation_wxyz: rotation_wxyz(&pose.pose),
            position_covariance: position_covariance(pose),
            sigma_theta_rad: pose.sigma_theta_rad(),
        }
    }

    fn sampled(&self, map: u16) -> SampledPose {
        let [[xx, xy, xz], [_, yy, yz], [_, _, zz]] = self.position_covariance;
        SampledPose {
            map,
            position: self.position,
            rotation_wxyz: self.rotation_wxyz.map(|value| value as f32),
            position_covariance: [xx, xy, xz, yy, yz, zz].map(|value| value as f32),
        }
    }
}

/// The pose in the map.
#[derive(Serialize)]
struct ViewedGlobal {
    stamp_ns: i64,
    map: String,
    map_version: u64,
    global_from_imu: ViewedPose,
    global_from_local: ViewedPose,
}

/// The odometry.
#[derive(Serialize)]
struct ViewedOdometry {
    stamp_ns: i64,
    local_from_imu: ViewedPose,
    speed_mps: f64,
}

/// The status.
#[derive(Serialize)]
struct ViewedStatus {
    state: RobotState,
    reason: String,
    map: Option<String>,
    keyframes_held: u32,
    queries_sent: u64,
    queries_answered: u64,
    last_map_update_age_s: Option<f64>,
}

/// Something, when it was received, and how long ago that is.
#[derive(Serialize)]
struct Dated<T> {
    #[serde(flatten)]
    value: T,
    age_s: f64,
    #[serde(skip)]
    received: Instant,
}

impl<T> Dated<T> {
    fn now(value: T) -> Self {
        Self { value, age_s: 0.0, received: Instant::now() }
    }

    fn set_age(&mut self) {
        self.age_s = self.received.elapsed().as_secs_f64();
    }
}

/// The latest of what a robot published.
#[derive(Serialize)]
pub(super) struct ViewedRobot {
    robot: String,
    is_online: bool,
    /// Its session ended: its liveliness token went, or it shut down.
    has_ended: bool,
    /// It shut down in order.
    is_off: bool,
    /// Time since the last sign of life.
    heard_age_s: f64,
    pose: Option<Dated<ViewedGlobal>>,
    odometry: Option<Dated<ViewedOdometry>>,
    status: Option<Dated<ViewedStatus>>,
    answer: Option<Dated<Answer>>,
    /// Counts the answers, so that a page sees each new one.
    answers: u64,
    #[serde(skip)]
    unsampled: Unsampled,
    #[serde(skip)]
    presence: Presence,
}

/// What is not yet in the history.
#[derive(Default)]
struct Unsampled {
    has_pose: bool,
    matched: u16,
    unmatched: u16,
    /// The state that the history knows.
    noted: Option<ShownState>,
}

impl ViewedRobot {
    pub(super) fn new(name: &str) -> Self {
        Self {
            robot: name.to_owned(),
            is_online: true,
            has_ended: false,
            is_off: false,
            heard_age_s: 0.0,
            pose: None,
            odometry: None,
            status: None,
            answer: None,
            answers: 0,
            unsampled: Unsampled::default(),
            presence: Presence::new(Instant::now()),
        }
    }

    /// Its liveliness token came or went.
    pub(super) fn note_token(&mut self, is_there: bool) {
        self.presence.note_token(is_there, Instant::now());
        self.is_online = self.presence.is_online(Instant::now());
    }

    /// Ends the presence of a robot that is silent.
    ///
    /// # Returns
    /// Whether it was there until now.
    pub(super) fn end_silence(&mut self) -> bool {
        let was_online = self.is_online;
        self.is_online = self.presence.is_online(Instant::now());
        was_online && !self.is_online
    }

    /// How long ago it gave its last sign of life, seconds; `None` while it is there.
    pub(super) fn offline_age_s(&self, now: Instant) -> Option<f64> {
        (!self.is_online).then(|| self.presence.heard_age_s(now))
    }

    pub(super) fn note(&mut self, published: Published) {
        let now = Instant::now();
        self.presence.note_published(&published, now);
        self.is_online = self.presence.is_online(now);
        match published {
            Published::Pose(pose) => {
                let pose = *pose;
                self.unsampled.has_pose = true;
                self.pose = Some(Dated::now(ViewedGlobal {
                    stamp_ns: pose.stamp_ns,
                    global_from_imu: ViewedPose::of(&pose.global_from_imu),
                    global_from_local: ViewedPose::of(&pose.global_from_local),
                    map: pose.map,
                    map_version: pose.map_version,
                }));
            }
            Published::Odometry(odometry) => {
                let [x, y, z] = odometry.velocity_in_local;
                self.odometry = Some(Dated::now(ViewedOdometry {
                    stamp_ns: odometry.stamp_ns,
                    local_from_imu: ViewedPose::of(&odometry.local_from_imu),
                    speed_mps: x.hypot(y).hypot(z),
                }));
            }
            Published::Status(status) => {
                let age = |last_ns: i64| status.stamp_ns.saturating_sub(last_ns) as f64 * 1e-9;
                self.status = Some(Dated::now(ViewedStatus {
                    state: status.state,
                    last_map_update_age_s: status.last_map_update_ns.map(age),
                    reason: status.reason,
                    map: status.map,
                    keyframes_held: status.keyframes_held,
                    queries_sent: status.queries_sent,
                    queries_answered: status.queries_answered,
                }));
            }
        }
    }

    pub(super) fn note_query(&mut self, query: &ViewedQuery) {
        let mut is_matched = false;
        if let ViewedResult::Answered(answer) = &query.result {
            let answer = answer.as_ref();
            is_matched = answer.outcome == MatchOutcome::Matched;
            let answer = Answer { map: query.map.clone(), keyframes: answer.keyframes.clone() };
            self.answer = Some(Dated::now(answer));
            self.answers += 1;
        }
        let Unsampled { matched, unmatched, .. } = &mut self.unsampled;
        let count = if is_matched { matched } else { unmatched };
        *count = count.saturating_add(1);
    }

    /// Writes down what happened since the last call.
    ///
    /// # Arguments
    /// * `number`: of the robot.
    /// * `map_number`: of a map by its name; `None` for one that is not shown.
    pub(super) fn sample(
        &mut self,
        t_ms: u64,
        number: u16,
        map_number: impl Fn(&str) -> Option<u16>,
        history: &mut History,
    ) {
        let state = match self.status.as_ref().map(|status| status.value.state) {
            _ if self.presence.is_off() => ShownState::Off,
            _ if !self.is_online => ShownState::Silent,
            state => ShownState::of(state),
        };
        if self.unsampled.noted != Some(state) {
            self.unsampled.noted = Some(state);
            let reason = self.status.as_ref().map_or("", |status| status.value.reason.as_str());
            history.note_change(t_ms, &self.robot, state, reason);
        }
        let Unsampled { has_pose, matched, unmatched, noted } = std::mem::take(&mut self.unsampled);
        self.unsampled.noted = noted;
        let pose = self.pose.as_ref().filter(|_| has_pose).and_then(|pose| {
            let ViewedGlobal { map, global_from_imu, .. } = &pose.value;
            Some(global_from_imu.sampled(map_number(map)?))
        });
        if pose.is_some() || matched > 0 || unmatched > 0 {
            history.add(t_ms, Observed { robot: number, state, matched, unmatched, pose });
        }
    }

    /// States how old everything is at this moment.
    pub(super) fn set_ages(&mut self) {
        self.has_ended = self.presence.has_ended();
        self.is_off = self.presence.is_off();
        self.heard_age_s = self.presence.heard_age_s(Instant::now());
        self.pose.iter_mut().for_each(Dated::set_age);
        self.odometry.iter_mut().for_each(Dated::set_age);
        self.status.iter_mut().for_each(Dated::set_age);
        self.answer.iter_mut().for_each(Dated::set_age);
    }
}
