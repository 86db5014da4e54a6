//! What a job has on the disk while it goes on.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::Result;
use map::MapContents;
use map::store::MapTarget;

use super::refused_sessions::RefusedSessions;

/// Keeps what a job did so far.
pub trait Storage {
    /// The work on a session begins: what is remembered of it is on the disk before.
    fn begin(&mut self, known: &RefusedSessions);

    /// The map has one session more.
    ///
    /// # Errors
    /// The map cannot be written, which ends the job.
    fn taken(&mut self, map: &mut MapContents, known: &RefusedSessions) -> Result<()>;
}

/// Keeps nothing, of a job that writes nothing.
impl Storage for () {
    fn begin(&mut self, _: &RefusedSessions) {}

    fn taken(&mut self, _: &mut MapContents, _: &RefusedSessions) -> Result<()> {
        Ok(())
    }
}

/// Keeps the map, from time to time, and what is remembered beside it.
#[derive(Debug)]
pub struct MapStorage {
    path: PathBuf,
    target: MapTarget,
    interval: Duration,
    saved: Instant,
    is_changed: bool,
    version: Option<u64>,
}

impl MapStorage {
    /// # Arguments
    /// * `target`: of the map as it was read.
    /// * `interval`: time between two versions, at least.
    pub fn new(target: MapTarget, interval: Duration) -> MapStorage {
        let path = target.path().to_owned();
        MapStorage { path, target, interval, saved: Instant::now(), is_changed: false, version: None }
    }

    /// Where the map is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Saves what is not saved yet.
    ///
    /// # Returns
    /// The version that was saved last; `None` where there was nothing to save.
    ///
    /// # Errors
    /// The map cannot be written, or another program wrote it.
    pub fn save(&mut self, map: &mut MapContents) -> Result<Option<u64>> {
        if self.is_changed {
            // When a session was first stored is the same in all later versions.
            map.info.sessions = map.sessions_to_store();
            self.version = Some(self.target.save_next(map)?.version);
            (self.is_changed, self.saved) = (false, Instant::now());
        }
        Ok(self.version)
    }
}

impl Storage for MapStorage {
    fn begin(&mut self, known: &RefusedSessions) {
        // Written once more at the end, where a failure counts.
        if let Err(error) = known.write(&self.path) {
            tracing::warn!("{error:#}: a session that ends the program is begun again the next time");
        }
    }

    fn taken(&mut self, map: &mut MapContents, known: &RefusedSessions) -> Result<()> {
        self.is_changed = true;
        if self.saved.elapsed() >= self.interval {
            // Before, so that a program that ends while it saves is not put down to the session.
            self.begin(known);
            self.save(map)?;
        }
        Ok(())
    }
}
