//! Robots as they publish.
//!
//! Of each robot the latest of everything is kept. Twenty times a second what changed is written once, and given to all
//! viewers; one that is too slow for that skips, and gets the latest of everything when it has caught up.

mod robot;
mod socket;
mod subscribe;

pub use robot::Answer;
pub(crate) use socket::socket;
pub use subscribe::{RobotFollower, follow_robots};

use crate::server::Viewer;
use axum::extract::ws::Utf8Bytes;
use robot::{Published, ViewedRobot};
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::{Semaphore, broadcast};

/// Viewers at the same time; others are refused.
pub const MAX_VIEWERS: usize = 32;
/// Robots that are kept; messages of others are ignored.
const MAX_ROBOTS: usize = 1000;
/// Messages that wait for a viewer.
const QUEUE: usize = 16;
/// Time between two messages to viewers.
const TICK: Duration = Duration::from_millis(50);

/// The robots, and who looks at them.
pub(crate) struct Live {
    state: Mutex<LiveState>,
    updates: broadcast::Sender<Utf8Bytes>,
    viewers: Arc<Semaphore>,
}

#[derive(Default)]
struct LiveState {
    robots: BTreeMap<String, ViewedRobot>,
    /// Robots by the ids of their sessions.
    sessions: BTreeMap<String, String>,
    maps: BTreeMap<String, u64>,
    changed: BTreeSet<String>,
    maps_changed: bool,
}

/// A message to viewers.
#[derive(Serialize)]
struct Update<'a> {
    /// Whether it holds all robots.
    is_snapshot: bool,
    robots: Vec<&'a ViewedRobot>,
    /// Versions of the maps, where one changed.
    maps: Option<&'a BTreeMap<String, u64>>,
}

impl Default for Live {
    fn default() -> Self {
        Self {
            state: Mutex::default(),
            updates: broadcast::Sender::new(QUEUE),
            viewers: Arc::new(Semaphore::new(MAX_VIEWERS)),
        }
    }
}

impl Live {
    pub(crate) fn note_map(&self, name: &str, version: u64) {
        let mut state = self.lock();
        state.maps.insert(name.to_owned(), version);
        state.maps_changed = true;
    }

    pub(crate) fn note_answer(&self, client: &str, answer: Answer) {
        let mut state = self.lock();
        if let Some(robot) = state.sessions.get(client).cloned() {
            state.with_robot(&robot, |robot| robot.note_answer(answer));
        }
    }

    fn note_published(&self, robot: &str, published: Published) {
        self.lock().with_robot(robot, |robot| robot.note(published));
    }

    fn note_online(&self, robot: &str, is_online: bool) {
        self.lock().with_robot(robot, |robot| robot.is_online = is_online);
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
        written(&Update { is_snapshot: true, robots, maps: Some(&state.maps) })
    }

    /// What changed since it was last called; `None` for nothing.
    fn changes(&self) -> Option<Utf8Bytes> {
        let mut state = self.lock();
        let changed = std::mem::take(&mut state.changed);
        let maps_changed = std::mem::take(&mut state.maps_changed);
        if changed.is_empty() && !maps_changed {
            return None;
        }
        for name in &changed {
            if let Some(robot) = state.robots.get_mut(name) {
                robot.set_ages();
            }
        }
        let robots = changed.iter().filter_map(|name| state.robots.get(name)).collect();
        Some(written(&Update { is_snapshot: false, robots, maps: maps_changed.then_some(&state.maps) }))
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
        change(self.robots.entry(name.to_owned()).or_insert_with(|| ViewedRobot::new(name)));
        self.changed.insert(name.to_owned());
    }
}

impl Viewer {
    /// Tells viewers what changed, until it is cancelled.
    pub(crate) async fn tick_live(self: Arc<Self>) {
        let mut ticks = tokio::time::interval(TICK);
        ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        loop {
            ticks.tick().await;
            if self.live.updates.receiver_count() > 0
                && let Some(update) = self.live.changes()
            {
                // Nobody left meanwhile: nobody misses it.
                let _ = self.live.updates.send(update);
            }
        }
    }
}

/// A message as JSON. Its values are finite, so that it can always be written.
fn written(update: &Update) -> Utf8Bytes {
    serde_json::to_string(update).unwrap_or_default().into()
}
