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
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::{Semaphore, broadcast};

/// Viewers at the same time; others are refused.
pub const MAX_VIEWERS: usize = 32;
/// Robots that are kept; messages of others are ignored.
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
}

#[derive(Default)]
struct LiveState {
    robots: BTreeMap<String, ViewedRobot>,
    /// Robots and maps in the order in which they came: their numbers.
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
        }
    }
}

impl Live {
    pub(crate) fn now_ms(&self) -> u64 {
        self.clock.now_ms()
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
        let now_ms = self.now_ms();
        let mut state = self.lock();
        let robot = state.sessions.get(client).cloned();
        if let Some(robot) = &robot {
            state.with_robot(robot, |robot| robot.note_query(&query));
        }
        state.queries.add(now_ms, robot.as_deref(), client, query)
    }

    /// Tells of a recorded run that can be shown now.
    pub(crate) fn note_run(&self, name: &str) {
        let mut state = self.lock();
        state.run = Some(name.to_owned());
        state.run_changed = true;
    }

    pub(crate) fn note_statistics(&self, sample: ServerSample) {
        let now_ms = self.now_ms();
        self.lock().statistics.add(now_ms, sample);
    }

    pub(crate) fn newest_queries(&self, of: Option<&str>, after: u64, limit: usize) -> Vec<Arc<KeptQuery>> {
        self.lock().queries.newest(of, after, limit)
    }

    pub(crate) fn statistics(&self) -> Vec<TimedSample> {
        self.lock().statistics.all()
    }

    /// The history of a span of time, milliseconds since 1970; see [`History::between`].
    ///
    /// # Arguments
    /// * `map`: poses in other maps are left out.
    pub(crate) fn history(&self, from_ms: u64, to_ms: u64, map: Option<&str>, limit: usize) -> HistoryAnswer {
        let state = self.lock();
        let number = map.map(|map| number_of(&state.map_names, map).unwrap_or(u16::MAX));
        state.history.between(from_ms, to_ms, &state.robot_names, number, limit)
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
        let now_ms = self.now_ms();
        let mut state = self.lock();
        let LiveState { robots, robot_names, map_names, history, .. } = &mut *state;
        if !history.is_due(robots.len()) {
            return;
        }
        for (number, name) in robot_names.iter().enumerate() {
            if let Some(robot) = robots.get_mut(name) {
                robot.sample(now_ms, number as u16, |map| number_of(map_names, map), history);
            }
        }
    }

    fn note_published(&self, robot: &str, published: Published) {
        self.lock().with_robot(robot, |robot| robot.note(published));
    }

    fn note_online(&self, robot: &str, is_online: bool) {
        self.lock().with_robot(robot, |robot| robot.note_token(is_online));
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
        &self,
        state: &'a LiveState,
        is_snapshot: bool,
        robots: Vec<&'a ViewedRobot>,
        has_maps: bool,
    ) -> Update<'a> {
        let (time_ms, history_since_ms) = (self.now_ms(), state.history.since_ms());
        Update {
            is_snapshot,
            time_ms,
            history_since_ms,
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
        if self.robots.len() >= MAX_ROBOTS && !self.robots.contains_key(name) {
            return;
        }
        let robot = self.robots.entry(name.to_owned()).or_insert_with(|| {
            self.robot_names.push(name.to_owned());
            ViewedRobot::new(name)
        });
        change(robot);
        self.changed.insert(name.to_owned());
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
