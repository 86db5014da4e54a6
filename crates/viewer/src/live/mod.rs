//! Robots as they publish.
//!
//! Of each robot the latest of everything is kept. Twenty times a second what changed is written once, and given to all
//! viewers; one that is too slow for that skips, and gets the latest of everything when it has caught up.

mod robot;
mod socket;
mod subscribe;

pub(crate) use socket::socket;
pub use subscribe::{RobotFollower, follow_robots};

use crate::clock::Clock;
use crate::history::{History, HistoryAnswer};
use crate::queries::{KeptQuery, QueryLog, ViewedQuery};
use crate::server::Viewer;
use crate::statistics::{ServerSample, StatisticsLog, TimedSample};
use axum::extract::ws::Utf8Bytes;
use protocol::Published;
use robot::ViewedRobot;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::hash::{BuildHasher as _, RandomState};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::{Semaphore, broadcast};

/// Viewers at the same time; others are refused.
pub const MAX_VIEWERS: usize = 32;
/// Robots that are kept: another one takes the place of the one that is offline longest, and where all are online it is ignored.
const MAX_ROBOTS: usize = 1000;
/// Messages that wait for a viewer.
const QUEUE: usize = 16;
/// Time between two messages to viewers.
const TICK: Duration = Duration::from_millis(50);
/// Without a change, viewers get an empty message after this long: silence means that the connection is dead.
const HEARTBEAT: Duration = Duration::from_millis(500);
/// Time between two looks at the robots for the history.
const SAMPLING: Duration = Duration::from_secs(1);

/// The robots, and who looks at them.
pub(crate) struct Live {
    state: Mutex<LiveState>,
    updates: broadcast::Sender<Utf8Bytes>,
    viewers: Arc<Semaphore>,
    clock: Clock,
    /// Tells this process from others, also of the same server: numbers of queries and revisions begin anew with it.
    instance: String,
}

#[derive(Default)]
struct LiveState {
    robots: BTreeMap<String, ViewedRobot>,
    /// Whether it was logged that a robot is ignored.
    is_full_logged: bool,
    /// Robots and maps by their numbers.
    robot_names: Vec<String>,
    map_names: Vec<String>,
    queries: QueryLog,
    history: History,
    statistics: StatisticsLog,
    /// Robots by the ids of their sessions.
    sessions: BTreeMap<String, String>,
    maps: BTreeMap<String, u64>,
    /// How often each map was drawn.
    revisions: BTreeMap<String, u64>,
    /// How often it was told how each map differs from other releases.
    changes: BTreeMap<String, u64>,
    changed: BTreeSet<String>,
    maps_changed: bool,
    /// Name of the recorded run.
    run: Option<String>,
    run_changed: bool,
}

/// A message to viewers.
#[derive(Serialize)]
struct Update<'a> {
    /// Whether it holds all robots.
    is_snapshot: bool,
    /// In a snapshot: tells the process from one that is started later.
    instance: Option<&'a str>,
    /// The server's time, milliseconds since 1970.
    time_ms: u64,
    /// When the history begins.
    history_since_ms: Option<u64>,
    robots: Vec<&'a ViewedRobot>,
    /// Versions of the maps, where one changed.
    maps: Option<&'a BTreeMap<String, u64>>,
    /// How often each map was drawn, with the same versions too: a page that shows another one loads it again.
    revisions: Option<&'a BTreeMap<String, u64>>,
    /// How often it was told how each map differs from other releases.
    changes: Option<&'a BTreeMap<String, u64>>,
    /// Name of a recorded run that can be shown.
    run: Option<&'a str>,
}

impl Default for Live {
    fn default() -> Self {
        Self {
            state: Mutex::default(),
            updates: broadcast::Sender::new(QUEUE),
            viewers: Arc::new(Semaphore::new(MAX_VIEWERS)),
            clock: Clock::default(),
            instance: format!("{:016x}", RandomState::new().hash_one(std::process::id())),
        }
    }
}

impl Live {
    /// The server's time, milliseconds since 1970.
    pub(crate) fn now_ms(&self) -> u64 {
        self.clock.now_ms()
    }

    /// When the server was started, milliseconds since 1970.
    pub(crate) fn started_ms(&self) -> u64 {
        self.clock.started_ms()
    }

    pub(crate) fn note_map(&self, name: &str, version: u64, revision: u64) {
        let mut state = self.lock();
        state.revisions.insert(name.to_owned(), revision);
        if state.maps.insert(name.to_owned(), version).is_none() {
            state.map_names.push(name.to_owned());
        }
        state.maps_changed = true;
    }

    pub(crate) fn note_changes(&self, name: &str) {
        let mut state = self.lock();
        *state.changes.entry(name.to_owned()).or_default() += 1;
        state.maps_changed = true;
    }

    pub(crate) fn note_query(&self, client: &str, query: ViewedQuery) -> Arc<KeptQuery> {
        let steady_ms = self.clock.steady_ms();
        let mut state = self.lock();
        let robot = state.sessions.get(client).cloned();
        if let Some(robot) = &robot {
            state.with_robot(robot, |robot| robot.note_query(&query));
        }
        state.queries.add(steady_ms, robot.as_deref(), client, query)
    }

    /// Tells of a recorded run that can be shown now.
    pub(crate) fn note_run(&self, name: &str) {
        let mut state = self.lock();
        state.run = Some(name.to_owned());
        state.run_changed = true;
    }

    pub(crate) fn note_statistics(&self, sample: ServerSample) {
        let steady_ms = self.clock.steady_ms();
        self.lock().statistics.add(steady_ms, sample);
    }

    pub(crate) fn newest_queries(&self, of: Option<&str>, after: u64, limit: usize) -> Vec<Arc<KeptQuery>> {
        self.lock().queries.newest(of, after, limit)
    }

    pub(crate) fn statistics(&self) -> Vec<TimedSample> {
        self.lock().statistics.since_1970(self.started_ms())
    }

    /// The history of a span of time, milliseconds since 1970; see [`History::between`].
    ///
    /// # Arguments
    /// * `map`: poses in other maps are left out.
    pub(crate) fn history(&self, from_ms: u64, to_ms: u64, map: Option<&str>, limit: usize) -> HistoryAnswer {
        let started_ms = self.started_ms();
        let [from_ms, to_ms] = [from_ms, to_ms].map(|t_ms| t_ms.saturating_sub(started_ms));
        let state = self.lock();
        let number = map.map(|map| number_of(&state.map_names, map).unwrap_or(u16::MAX));
        let answer = state.history.between(from_ms, to_ms, &state.robot_names, number, limit);
        answer.since_1970(started_ms)
    }

    /// Robots that have stopped publishing are removed, also where no token was undeclared.
    fn end_silence(&self) {
        let mut state = self.lock();
        let LiveState { robots, changed, .. } = &mut *state;
        let silent = robots.iter_mut().filter_map(|(name, robot)| robot.end_silence().then_some(name));
        changed.extend(silent.cloned());
    }

    /// Adds what happened in the last second to the history.
    fn sample(&self) {
        let steady_ms = self.clock.steady_ms();
        let mut state = self.lock();
        let LiveState { robots, robot_names, map_names, history, .. } = &mut *state;
        if !history.is_due(robots.len()) {
            return;
        }
        for (number, name) in robot_names.iter().enumerate() {
            if let Some(robot) = robots.get_mut(name) {
                robot.sample(steady_ms, number as u16, |map| number_of(map_names, map), history);
            }
        }
    }

    fn note_published(&self, robot: &str, published: Published) {
        self.lock().with_robot(robot, |robot| robot.note(published));
    }

    fn note_online(&self, robot: &str, is_online: bool) {
        let mut state = self.lock();
        // One that ends and is not known needs no place.
        if is_online || state.robots.contains_key(robot) {
            state.with_robot(robot, |robot| robot.note_token(is_online));
        }
    }

    fn note_session(&self, session: &str, robot: &str, is_there: bool) {
        let mut state = self.lock();
        if !is_there {
            state.sessions.remove(session);
        } else if state.sessions.len() < MAX_ROBOTS {
            state.sessions.insert(session.to_owned(), robot.to_owned());
        }
    }

    /// Everything, for a viewer that is new or was too slow.
    fn snapshot(&self) -> Utf8Bytes {
        let mut state = self.lock();
        state.robots.values_mut().for_each(ViewedRobot::set_ages);
        let robots = state.robots.values().collect();
        written(&self.update(&state, true, robots, true))
    }

    /// What changed since it was last called; `None` for nothing, unless a heartbeat is due.
    fn changes(&self, is_due: bool) -> Option<Utf8Bytes> {
        let mut state = self.lock();
        let changed = std::mem::take(&mut state.changed);
        let maps_changed = std::mem::take(&mut state.maps_changed);
        let run_changed = std::mem::take(&mut state.run_changed);
        if changed.is_empty() && !maps_changed && !run_changed && !is_due {
            return None;
        }
        for name in &changed {
            if let Some(robot) = state.robots.get_mut(name) {
                robot.set_ages();
            }
        }
        let robots = changed.iter().filter_map(|name| state.robots.get(name)).collect();
        Some(written(&self.update(&state, false, robots, maps_changed)))
    }

    fn update<'a>(
        &'a self,
        state: &'a LiveState,
        is_snapshot: bool,
        robots: Vec<&'a ViewedRobot>,
        has_maps: bool,
    ) -> Update<'a> {
        let since_ms = state.history.since_ms();
        Update {
            is_snapshot,
            instance: is_snapshot.then_some(self.instance.as_str()),
            time_ms: self.now_ms(),
            history_since_ms: since_ms.map(|since_ms| since_ms + self.started_ms()),
            robots,
            maps: has_maps.then_some(&state.maps),
            revisions: has_maps.then_some(&state.revisions),
            changes: has_maps.then_some(&state.changes),
            run: state.run.as_deref(),
        }
    }

    fn lock(&self) -> MutexGuard<'_, LiveState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl LiveState {
    fn with_robot(&mut self, name: &str, change: impl FnOnce(&mut ViewedRobot)) {
        if !self.robots.contains_key(name) {
            if self.robots.len() < MAX_ROBOTS {
                self.robot_names.push(name.to_owned());
            } else if !self.replace_offline(name) {
                return;
            }
            self.robots.insert(name.to_owned(), ViewedRobot::new(name));
        }
        if let Some(robot) = self.robots.get_mut(name) {
            change(robot);
            self.changed.insert(name.to_owned());
        }
    }

    /// Gives the place and the number of the robot that is offline longest to another one.
    ///
    /// # Returns
    /// Whether there was one.
    fn replace_offline(&mut self, name: &str) -> bool {
        let now = Instant::now();
        let offline =
            self.robots.iter().filter_map(|(robot, known)| Some((known.offline_age_s(now)?, robot)));
        let longest = offline.max_by(|(one, _), (other, _)| one.total_cmp(other));
        let former = longest.map(|(_, robot)| robot.clone());
        let number = former.as_deref().and_then(|former| number_of(&self.robot_names, former));
        let (Some(former), Some(number)) = (former, number) else {
            if !std::mem::replace(&mut self.is_full_logged, true) {
                tracing::warn!(robot = name, "it is not shown: {MAX_ROBOTS} others are online");
            }
            return false;
        };
        self.robots.remove(&former);
        self.history.remove(number, &former);
        name.clone_into(&mut self.robot_names[usize::from(number)]);
        true
    }
}

impl Viewer {
    /// Tells viewers what changed, until it is cancelled.
    pub(crate) async fn tick_live(self: Arc<Self>) {
        let mut ticks = tokio::time::interval(TICK);
        ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        let (mut sampled, mut told) = (Instant::now(), Instant::now());
        loop {
            ticks.tick().await;
            if sampled.elapsed() >= SAMPLING {
                sampled += SAMPLING;
                self.live.end_silence();
                self.live.sample();
            }
            if self.live.updates.receiver_count() > 0
                && let Some(update) = self.live.changes(told.elapsed() >= HEARTBEAT)
            {
                told = Instant::now();
                // Nobody left meanwhile: nobody misses it.
                let _ = self.live.updates.send(update);
            }
        }
    }
}

/// The number of a name among others.
fn number_of(names: &[String], name: &str) -> Option<u16> {
    names.iter().position(|one| one == name).map(|at| at as u16)
}

/// A message as JSON. Its values are finite, so that it can always be written.
fn written(update: &Update) -> Utf8Bytes {
    serde_json::to_string(update).unwrap_or_default().into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_robot_takes_the_place_of_the_one_that_is_offline_longest() {
        let live = Live::default();
        let has = |name: &str| live.lock().robots.contains_key(name);
        (0..MAX_ROBOTS).for_each(|robot| live.note_online(&format!("r{robot}"), true));
        live.lock().history.note_change(1, "r3", crate::history::ShownState::Lost, "");
        live.note_online("late", true);
        assert!(!has("late"), "all others are online");
        for robot in ["r7", "r3"] {
            live.note_online(robot, false);
        }
        live.note_online("late", true);
        assert!(has("late") && !has("r3") && has("r7"), "the other was heard last");
        assert_eq!(live.lock().robot_names[3], "late");
        live.note_online("r3", false);
        assert!(!has("r3"), "its end needs no place");
        let answer = serde_json::to_value(live.history(0, u64::MAX, None, 10)).unwrap();
        assert_eq!(answer["robots"], serde_json::json!([]));
    }

    #[test]
    fn a_snapshot_tells_processes_apart() {
        let [one, other] = [Live::default(), Live::default()];
        let instance = |live: &Live| {
            let snapshot: serde_json::Value = serde_json::from_str(live.snapshot().as_str()).unwrap();
            snapshot["instance"].as_str().unwrap().to_owned()
        };
        assert_eq!(instance(&one), instance(&one));
        assert_ne!(instance(&one), instance(&other));
    }
}
