//! The last hour: poses of robots once a second, what their state was, and how their queries ended.
//!
//! Robots are looked at once a second, so that what is kept depends neither on how often they publish nor on how much. Times are
//! milliseconds since the start of the server, until they are answered.

use crate::fair_log::FairLog;
use protocol::RobotState;
use serde::Serialize;
use std::collections::{BTreeMap, VecDeque};

/// How long samples are kept, milliseconds.
const SPAN_MS: u64 = 3_600_000;
/// Samples that are kept, of all robots together: an hour of 100 robots, 35 MB.
pub const MAX_SAMPLES: usize = 360_000;
/// So many robots are sampled once a second; of more, all are sampled more rarely.
const FULL_RATE_ROBOTS: usize = 100;
/// Changes of state that are kept, of all robots together; 3 MB.
const MAX_CHANGES: usize = 8_000;
/// Longest reason that is kept, bytes.
const MAX_REASON_BYTES: usize = 200;
/// Samples in one answer: 5 MB.
pub const MAX_ANSWER_SAMPLES: usize = 20_000;

/// The state of a robot as the page names it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum ShownState {
    Localized,
    OdometryOnly,
    Lost,
    Starting,
    /// Nothing came for a while, or its session ended without a word.
    Silent,
    /// It shut down in order.
    Off,
    /// It published no status.
    Unknown,
}

impl ShownState {
    /// The state of a robot that is there.
    pub(crate) fn of(state: Option<RobotState>) -> Self {
        match state {
            Some(RobotState::Localized) => Self::Localized,
            Some(RobotState::OdometryOnly) => Self::OdometryOnly,
            Some(RobotState::Lost) => Self::Lost,
            Some(RobotState::Starting) => Self::Starting,
            Some(RobotState::Off) => Self::Off,
            None => Self::Unknown,
        }
    }
}

/// A pose that is kept.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct SampledPose {
    /// Number of the map.
    #[serde(skip)]
    pub(crate) map: u16,
    /// In G, metres.
    pub(crate) position: [f64; 3],
    pub(crate) rotation_wxyz: [f32; 4],
    /// m^2, by rows, the part on and above the diagonal.
    pub(crate) position_covariance: [f32; 6],
}

/// What one robot did since it was last looked at.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Observed {
    pub(crate) robot: u16,
    pub(crate) state: ShownState,
    /// Queries whose image was recognized, and others.
    pub(crate) matched: u16,
    pub(crate) unmatched: u16,
    /// `None` where it published none.
    pub(crate) pose: Option<SampledPose>,
}

#[derive(Clone, Copy, Debug)]
struct Sample {
    t_ms: u64,
    observed: Observed,
}

#[derive(Clone, Debug)]
struct Change {
    t_ms: u64,
    state: ShownState,
    reason: String,
}

/// The last hour.
#[derive(Debug)]
pub(crate) struct History {
    samples: VecDeque<Sample>,
    changes: FairLog<Change>,
    /// Seconds since the start.
    seconds: usize,
}

impl Default for History {
    fn default() -> Self {
        Self { samples: VecDeque::new(), changes: FairLog::new(MAX_CHANGES), seconds: 0 }
    }
}

impl History {
    /// Whether robots are sampled in this second, which is counted.
    pub(crate) fn is_due(&mut self, robots: usize) -> bool {
        self.seconds += 1;
        self.seconds.is_multiple_of(robots.div_ceil(FULL_RATE_ROBOTS).max(1))
    }

    pub(crate) fn add(&mut self, t_ms: u64, observed: Observed) {
        let first_kept = t_ms.saturating_sub(SPAN_MS);
        while self.samples.len() >= MAX_SAMPLES
            || self.samples.front().is_some_and(|sample| sample.t_ms < first_kept)
        {
            self.samples.pop_front();
        }
        let (length, capacity) = (self.samples.len(), self.samples.capacity());
        if length == capacity {
            // Doubling would take half as much again as is needed.
            self.samples.reserve_exact(length.max(1024).min(MAX_SAMPLES - length));
        }
        self.samples.push_back(Sample { t_ms, observed });
    }

    /// A robot's state changed; noted once a second at most.
    pub(crate) fn note_change(&mut self, t_ms: u64, robot: &str, state: ShownState, reason: &str) {
        let reason = reason[..reason.floor_char_boundary(MAX_REASON_BYTES)].to_owned();
        self.changes.add(robot, Change { t_ms, state, reason });
    }

    /// Removes what it has of a robot.
    pub(crate) fn remove(&mut self, number: u16, robot: &str) {
        self.samples.retain(|sample| sample.observed.robot != number);
        self.changes.remove(robot);
    }

    /// When it begins; `None` while there is nothing.
    pub(crate) fn since_ms(&self) -> Option<u64> {
        self.samples.front().map(|sample| sample.t_ms)
    }

    /// What it knows of a span of time.
    ///
    /// # Arguments
    /// * `names`: of robots, by number.
    /// * `map`: poses in other maps are left out.
    /// * `limit`: about so many samples at most; where there are more, they are thinned evenly.
    pub(crate) fn between(
        &self,
        from_ms: u64,
        to_ms: u64,
        names: &[String],
        map: Option<u16>,
        limit: usize,
    ) -> HistoryAnswer {
        let start = self.samples.partition_point(|sample| sample.t_ms < from_ms);
        let end = self.samples.partition_point(|sample| sample.t_ms <= to_ms).max(start);
        let each_ms = 1000 * (names.len().div_ceil(FULL_RATE_ROBOTS).max(1) as u64);
        let step_ms = each_ms * (end - start).div_ceil(limit.clamp(1, MAX_ANSWER_SAMPLES)).max(1) as u64;
        let mut robots: BTreeMap<u16, Vec<ViewedSample>> = BTreeMap::new();
        for Sample { t_ms, observed } in self.samples.range(start..end) {
            let of_robot = robots.entry(observed.robot).or_default();
            match of_robot.last_mut().filter(|last| last.t_ms / step_ms == t_ms / step_ms) {
                Some(last) if step_ms > each_ms => {
                    last.matched += u32::from(observed.matched);
                    last.unmatched += u32::from(observed.unmatched);
                }
                _ => of_robot.push(ViewedSample::of(*t_ms, observed, map)),
            }
        }
        let tracks = names.iter().enumerate().map(|(number, robot)| {
            let within = |change: &&Change| (from_ms..=to_ms).contains(&change.t_ms);
            let of_robot = self.changes.of(robot).map(|(_, change)| change);
            let changes = of_robot.filter(within).map(ViewedChange::of).collect();
            let samples = robots.remove(&(number as u16)).unwrap_or_default();
            RobotHistory { robot: robot.clone(), samples, changes }
        });
        let robots = tracks.filter(|track| !track.samples.is_empty() || !track.changes.is_empty()).collect();
        HistoryAnswer { since_ms: self.since_ms(), step_ms, robots }
    }
}

/// A span of the history.
#[derive(Debug, Serialize)]
pub(crate) struct HistoryAnswer {
    /// When the whole history begins, milliseconds.
    since_ms: Option<u64>,
    /// Time between two samples of a robot.
    step_ms: u64,
    robots: Vec<RobotHistory>,
}

impl HistoryAnswer {
    /// The same with times since 1970.
    ///
    /// # Arguments
    /// * `started_ms`: the start of the server.
    #[must_use]
    pub(crate) fn since_1970(mut self, started_ms: u64) -> Self {
        self.since_ms = self.since_ms.map(|t_ms| t_ms + started_ms);
        for robot in &mut self.robots {
            robot.samples.iter_mut().for_each(|sample| sample.t_ms += started_ms);
            robot.changes.iter_mut().for_each(|change| change.t_ms += started_ms);
        }
        self
    }
}

#[derive(Debug, Serialize)]
struct RobotHistory {
    robot: String,
    samples: Vec<ViewedSample>,
    changes: Vec<ViewedChange>,
}

#[derive(Debug, Serialize)]
struct ViewedSample {
    t_ms: u64,
    state: ShownState,
    /// Queries since the last sample.
    matched: u32,
    unmatched: u32,
    pose: Option<SampledPose>,
}

impl ViewedSample {
    fn of(t_ms: u64, observed: &Observed, map: Option<u16>) -> Self {
        Self {
            t_ms,
            state: observed.state,
            matched: observed.matched.into(),
            unmatched: observed.unmatched.into(),
            pose: observed.pose.filter(|pose| map.is_none_or(|map| map == pose.map)),
        }
    }
}

#[derive(Debug, Serialize)]
struct ViewedChange {
    t_ms: u64,
    state: ShownState,
    reason: String,
}

impl ViewedChange {
    fn of(change: &Change) -> Self {
        Self { t_ms: change.t_ms, state: change.state, reason: change.reason.clone() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn observed(robot: u16, x: f64) -> Observed {
        let pose = SampledPose {
            map: 0,
            position: [x, 0.0, 0.0],
            rotation_wxyz: [1.0, 0.0, 0.0, 0.0],
            position_covariance: [0.0; 6],
        };
        Observed { robot, state: ShownState::Localized, matched: 1, unmatched: 2, pose: Some(pose) }
    }

    /// A thousand robots that are there for two hours.
    #[test]
    fn memory_is_bounded_whatever_robots_do_and_the_hour_is_covered() {
        let names: Vec<String> = (0..1000).map(|robot| format!("r{robot}")).collect();
        let mut history = History::default();
        let mut now_ms = 0;
        for second in 0..7200_u64 {
            now_ms = 1000 * second;
            if history.is_due(names.len()) {
                (0..1000).for_each(|robot| history.add(now_ms, observed(robot, second as f64)));
            }
            history.note_change(now_ms, "r0", ShownState::Lost, &"long ".repeat(1000));
        }
        let bytes = history.samples.capacity() * size_of::<Sample>();
        assert!(bytes <= 35_000_000, "{bytes}");
        let covered_ms = now_ms - history.since_ms().unwrap();
        assert!((3_580_000..=3_600_000).contains(&covered_ms), "{covered_ms}");
        assert_eq!(history.changes.all().count(), 7200);
        assert!(history.changes.all().all(|(_, change)| change.reason.len() <= MAX_REASON_BYTES));
        let answer = history.between(0, u64::MAX, &names, None, usize::MAX);
        let sent: usize = answer.robots.iter().map(|robot| robot.samples.len()).sum();
        assert!(sent <= MAX_ANSWER_SAMPLES + names.len(), "{sent}");
    }

    #[test]
    fn of_a_robot_that_is_removed_nothing_is_left_and_times_are_told_since_1970() {
        let mut history = History::default();
        for robot in 0..2 {
            history.add(1000, observed(robot, 0.0));
            history.note_change(1000, &format!("r{robot}"), ShownState::Localized, "");
        }
        history.remove(0, "r0");
        let names = ["new".to_owned(), "r1".to_owned()];
        let answer = history.between(0, u64::MAX, &names, None, 100).since_1970(50_000);
        assert_eq!((answer.since_ms, answer.robots.len()), (Some(51_000), 1));
        let left = &answer.robots[0];
        assert_eq!((left.robot.as_str(), left.samples[0].t_ms, left.changes[0].t_ms), ("r1", 51_000, 51_000));
    }

    #[test]
    fn thinned_samples_keep_the_number_of_queries() {
        let mut history = History::default();
        (0..1000).for_each(|second| history.add(1000 * second, observed(0, second as f64)));
        let names = ["r0".to_owned()];
        let answer = history.between(0, u64::MAX, &names, Some(0), 100);
        assert_eq!((answer.step_ms, answer.robots[0].samples.len()), (10_000, 100));
        assert_eq!(answer.robots[0].samples.iter().map(|sample| sample.unmatched).sum::<u32>(), 2000);
        let part = history.between(500_000, 501_000, &names, Some(0), 100);
        let positions = part.robots[0].samples.iter().map(|sample| sample.pose.unwrap().position[0]);
        assert_eq!(positions.collect::<Vec<_>>(), [500.0, 501.0]);
        let elsewhere = history.between(0, u64::MAX, &names, Some(1), 100);
        assert!(elsewhere.robots[0].samples.iter().all(|sample| sample.pose.is_none()));
    }
}
