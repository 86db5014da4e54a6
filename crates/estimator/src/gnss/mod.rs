//! GNSS: positions of an antenna in the frame of the map, G.
//!
//! A reading is a measurement (`measurement`) of the two clones before and after it and of `global_from_local`; it is used at the first image behind it. Where
//! `global_from_local` is not known, readings and odometry are aligned (`alignment`) until the robot has driven far enough to know its yaw, and that
//! initializes it. An answer of the map then initializes it anew, since keyframes are more accurate.
//!
//! Errors of readings are alike for a while: orbits, atmosphere, reflections. A reading is tested with its own covariance, and
//! used with that of a reading that stands for its correlation time, `(1 + r) / (1 - r)` times as large, `r` the
//! correlation with the reading that was used before. What is rejected is counted, and watched ([`watch`]).

pub mod config;
pub mod report;
pub mod watch;

pub(crate) mod alignment;
pub(crate) mod measurement;
mod reading_order;

use crate::gate::Gate;
use crate::measurement::LinearizedMeasurement;
use crate::state::{ActiveState, CloneId};
use alignment::{Located, inflation};
use config::GnssConfig;
use geometry::PoseWithCovariance;
use measurement::Between;
use nalgebra::Matrix3;
use reading_order::ReadingOrder;
use report::GnssCounts;
use std::collections::VecDeque;
use types::{GnssReading, push_newest};
use watch::GnssWatch;

/// Clones whose times are remembered.
const MAX_CLONES: usize = 256;
/// Clones that are farther apart than this, nanoseconds: the antenna does not move straight between them.
const MAX_INTERVAL_NS: i64 = 500_000_000;
/// Readings that wait for an image, ten seconds at 20 Hz.
const MAX_WAITING: usize = 200;
/// Readings that are kept to be aligned, and the least time between them: five minutes.
const MAX_LOCATED: usize = 600;
const LOCATED_EVERY_NS: i64 = 490_000_000;

/// Why a reading was dropped.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum BadGnssReading {
    /// A number is not finite, or the covariance is not valid.
    #[error(
        "GNSS reading at {stamp_ns} ns dropped: its position is not finite, or its covariance is not positive definite"
    )]
    Invalid {
        /// Time of the reading, nanoseconds.
        stamp_ns: i64,
    },
    /// The reading is not newer than the one before.
    #[error(
        "GNSS reading at {stamp_ns} ns dropped: it is not newer than the one before, at {previous_ns} ns"
    )]
    NotNewer {
        /// Time of the reading, nanoseconds.
        stamp_ns: i64,
        /// Time of the reading before, nanoseconds.
        previous_ns: i64,
    },
}

/// GNSS of one filter.
#[derive(Clone, Debug)]
pub(crate) struct Gnss {
    pub(crate) config: GnssConfig,
    pub(crate) gate: Gate,
    pub(crate) watch: GnssWatch,
    pub(crate) counts: GnssCounts,
    /// Reused memory.
    pub(crate) rows: LinearizedMeasurement,
    /// The antenna in both frames, in order of time.
    pub(crate) located: VecDeque<Located>,
    /// Time of the last reading that was used, nanoseconds.
    pub(crate) last_used_ns: Option<i64>,
    /// Pose of the IMU in L before and after the updates at the newest image; `None` where there were none.
    pub(crate) correction: Option<[PoseWithCovariance; 2]>,
    waiting: VecDeque<GnssReading>,
    order: ReadingOrder,
    /// The newest clones with their times by the clock of the IMU.
    clones: VecDeque<(CloneId, i64)>,
}

impl Gnss {
    pub(crate) fn new(config: GnssConfig) -> Self {
        Self {
            config,
            gate: Gate::new(config.gate),
            watch: GnssWatch::default(),
            counts: GnssCounts::default(),
            rows: LinearizedMeasurement::default(),
            located: VecDeque::new(),
            last_used_ns: None,
            correction: None,
            waiting: VecDeque::new(),
            order: ReadingOrder::default(),
            clones: VecDeque::new(),
        }
    }

    /// Stores a reading, by the clock of the IMU from here on.
    pub(crate) fn push(&mut self, mut reading: GnssReading) -> Result<(), BadGnssReading> {
        let stamp_ns = reading.stamp_ns;
        let checked =
            if !reading.is_valid() || !reading.position.iter().all(|value| geometry::is_coordinate(*value)) {
                Err(BadGnssReading::Invalid { stamp_ns })
            } else {
                self.order.check(stamp_ns)
            };
        checked.inspect_err(|_| self.counts.refused += 1)?;
        if self.order.went_back() {
            // What waits for images that have never come was from the future.
            self.waiting.clear();
        }
        reading.stamp_ns += (self.config.time_offset_s * 1e9).round() as i64;
        if let Some((_, image_ns)) = self.clones.back() {
            self.watch.note_apart(reading.stamp_ns.saturating_sub(*image_ns));
        }
        reading.covariance += Matrix3::identity() * self.config.least_sigma_m.powi(2);
        self.counts.late += usize::from(push_newest(&mut self.waiting, reading, MAX_WAITING));
        Ok(())
    }

    pub(crate) fn add_clone(&mut self, id: CloneId, stamp_ns: i64) {
        push_newest(&mut self.clones, (id, stamp_ns), MAX_CLONES);
    }

    /// The oldest reading that has a clone behind it, with the clones about it.
    pub(crate) fn next_due(&mut self, state: &ActiveState) -> Option<(GnssReading, Between)> {
        while let Some(reading) = self.waiting.front().copied() {
            if self.clones.back().is_none_or(|(_, newest_ns)| *newest_ns < reading.stamp_ns) {
                return None;
            }
            self.waiting.pop_front();
            if let Some(between) = self.between(state, reading.stamp_ns) {
                return Some((reading, between));
            }
            self.counts.late += 1;
        }
        None
    }

    fn between(&self, state: &ActiveState, stamp_ns: i64) -> Option<Between> {
        let is_before = |(_, clone_ns): &&(CloneId, i64)| *clone_ns < stamp_ns;
        let in_state = |(id, clone_ns): &(CloneId, i64)| Some((state.clone_index(*id)?, *clone_ns));
        let (before, from_ns) = self.clones.iter().rev().filter(is_before).find_map(in_state)?;
        let (after, to_ns) = self.clones.iter().skip_while(is_before).find_map(in_state)?;
        let later = (stamp_ns - from_ns) as f64 / (to_ns - from_ns) as f64;
        (to_ns - from_ns <= MAX_INTERVAL_NS).then_some(Between { clones: [before, after], later })
    }

    /// Keeps a reading to be aligned, where it is not too near to the one before.
    pub(crate) fn locate(&mut self, located: Located) {
        let last_ns = self.located.back().map(|last| last.stamp_ns);
        if last_ns.is_some_and(|last_ns| located.stamp_ns - last_ns < LOCATED_EVERY_NS) {
            return;
        }
        push_newest(&mut self.located, located, MAX_LOCATED);
    }

    /// The covariance that a reading is used with: its own, inflated for what it has in common with the one that was used before.
    pub(crate) fn inflated(&self, reading: &GnssReading) -> Matrix3<f64> {
        let factor = self.last_used_ns.map_or(1.0, |last_ns| {
            let interval_s = (reading.stamp_ns - last_ns) as f64 * 1e-9;
            inflation(interval_s, self.config.correlation_time_s)
        });
        reading.covariance * factor
    }
}
