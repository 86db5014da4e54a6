//! Wheel odometry: how the base moved between two clones, from the speeds of its wheels.
//!
//! The readings between two consecutive images are [preintegrated](preintegration) to a planar motion of the base with its
//! covariance and its Jacobians with respect to its geometry and the time offset, [linearized](linearization) at the motion of the clones. It is a [measurement] of both clones and of the
//! [calibration] of the wheels, which is a part of the state; all of it is estimated online with its uncertainty, since an
//! error of a radius is the same in all intervals and is not averaged away as their noise is. Off the floor, and unless its
//! wheels roll so sideways, the base does not move, except by what [`WheelNoise`](config::WheelNoise) states.
//!
//! A chi-square test rejects intervals with slip; wheels whose readings are nonsense are left out ([watch]). An interval is
//! used at the first image behind its last reading.
//!
//! Source: Lee, Eckenhoff, Yang, Geneva & Huang, "Visual-inertial-wheel odometry with online calibration", IROS 2020.

pub mod buffer;
pub mod calibration;
pub mod config;
pub mod kinematics;
pub mod linearization;
pub mod measurement;
pub mod preintegration;
pub mod report;
pub mod watch;

use crate::gate::Gate;
use crate::measurement::LinearizedMeasurement;
use crate::state::CloneId;
use buffer::{Interval, WheelBuffer, WheelInterval};
use config::WheelConfig;
use report::WheelCounts;
use std::collections::VecDeque;
use types::push_newest;
use watch::WheelWatch;

/// Readings that are later than this behind an image are not waited for, nanoseconds.
const MAX_DELAY_NS: i64 = 500_000_000;
/// Longest interval that is preintegrated, nanoseconds: the base does not stay in one plane for long.
const MAX_INTERVAL_NS: i64 = 2_000_000_000;
/// Readings are kept for so long before the oldest image that waits or was kept, nanoseconds: the estimated time offset changes.
const KEPT_NS: i64 = 100_000_000;

/// Intervals that are kept until wheels are used: more than a window has.
const MAX_UNTRIED: usize = 32;

/// A clone, and its time by the clock of the IMU.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TimedClone {
    pub(crate) id: CloneId,
    pub(crate) stamp_ns: i64,
}

/// Two consecutive clones, with those before and after them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ConsecutiveClones {
    pub(crate) both: [TimedClone; 2],
    pub(crate) before: Option<TimedClone>,
    pub(crate) after: Option<TimedClone>,
}

/// Two consecutive clones, and the readings between them.
#[derive(Clone, Debug)]
pub(crate) struct DueInterval {
    pub(crate) clones: ConsecutiveClones,
    pub(crate) readings: WheelInterval,
}

/// The wheels of one filter.
#[derive(Clone, Debug)]
pub(crate) struct WheelOdometry {
    pub(crate) config: WheelConfig,
    pub(crate) buffer: WheelBuffer,
    pub(crate) gate: Gate,
    pub(crate) watch: WheelWatch,
    pub(crate) counts: WheelCounts,
    /// Reused memory.
    pub(crate) rows: LinearizedMeasurement,
    /// Clones whose interval was not used yet; the first one ends the last that was.
    clones: VecDeque<TimedClone>,
    /// The clone before the first of them.
    before: Option<TimedClone>,
    /// The clones of the newest intervals that were tested while wheels are not used.
    untried: VecDeque<ConsecutiveClones>,
}

impl WheelOdometry {
    /// Nothing was read yet.
    pub(crate) fn new(config: WheelConfig) -> Self {
        Self {
            config,
            buffer: WheelBuffer::default(),
            gate: Gate::new(config.noise.gate),
            watch: WheelWatch::new(config.base.kind()),
            counts: WheelCounts::default(),
            rows: LinearizedMeasurement::default(),
            clones: VecDeque::new(),
            before: None,
            untried: VecDeque::new(),
        }
    }

    /// Keeps an interval that was tested and not used, for when wheels are.
    pub(crate) fn keep(&mut self, clones: ConsecutiveClones) {
        push_newest(&mut self.untried, clones, MAX_UNTRIED);
    }

    /// Takes the intervals that were kept, in the order of time.
    pub(crate) fn take_untried(&mut self) -> VecDeque<ConsecutiveClones> {
        std::mem::take(&mut self.untried)
    }

    /// Forgets the intervals that were kept and begin at a clone that is gone.
    pub(crate) fn retain_untried(&mut self, is_there: impl Fn(CloneId) -> bool) {
        self.untried.retain(|clones| is_there(clones.both[0].id));
    }

    /// Notes that an interval cannot be used: there are no readings of it, or they came when its clones were gone.
    ///
    /// # Arguments
    /// * `from_ns`: its begin, nanoseconds.
    /// * `now_ns`: time of the newest clone, nanoseconds.
    pub(crate) fn note_missing(&mut self, from_ns: i64, now_ns: i64) {
        self.counts.missing += 1;
        self.watch.note_missing(from_ns, now_ns);
    }

    /// The readings between two clones.
    ///
    /// # Arguments
    /// * `time_offset_s`: added to the stamp of a reading to obtain the IMU's time, seconds.
    pub(crate) fn readings_between(&self, clones: &ConsecutiveClones, time_offset_s: f64) -> Interval {
        let [from_ns, to_ns] = clones.both.map(|clone| clone.stamp_ns - nanoseconds(time_offset_s));
        match self.buffer.interval(from_ns, to_ns) {
            Interval::Covered(_) if to_ns - from_ns > MAX_INTERVAL_NS => Interval::Missing,
            found => found,
        }
    }

    /// Takes in a new clone.
    ///
    /// # Arguments
    /// * `stamp_ns`: by the clock of the IMU, nanoseconds.
    pub(crate) fn add_clone(&mut self, id: CloneId, stamp_ns: i64) {
        self.clones.push_back(TimedClone { id, stamp_ns });
    }

    /// The oldest interval whose readings are there; intervals that will never have them are skipped.
    ///
    /// # Arguments
    /// * `time_offset_s`: added to the stamp of a reading to obtain the IMU's time, seconds.
    pub(crate) fn next_due(&mut self, time_offset_s: f64) -> Option<DueInterval> {
        while let (Some(&first), Some(&second), Some(&newest)) =
            (self.clones.front(), self.clones.get(1), self.clones.back())
        {
            let after = self.clones.get(2).copied();
            let clones = ConsecutiveClones { both: [first, second], before: self.before, after };
            let is_late = newest.stamp_ns - first.stamp_ns > MAX_DELAY_NS;
            let found = self.readings_between(&clones, time_offset_s);
            if found == Interval::NotYet && !is_late {
                return None;
            }
            self.before = self.clones.pop_front();
            let oldest_ns = self.untried.front().map_or(first.stamp_ns, |kept| kept.both[0].stamp_ns);
            self.buffer.remove_before(oldest_ns - nanoseconds(time_offset_s) - KEPT_NS);
            if let Interval::Covered(readings) = found {
                return Some(DueInterval { clones, readings });
            }
            self.note_missing(first.stamp_ns, newest.stamp_ns);
        }
        None
    }
}

/// Seconds as nanoseconds.
fn nanoseconds(seconds: f64) -> i64 {
    (seconds * 1e9).round() as i64
}

#[cfg(test)]
mod tests {
    use super::*;
    use types::{BaseKind, WheelBase, WheelReading};

    #[test]
    fn an_interval_that_was_kept_is_cut_anew_with_another_time_offset() {
        let base = WheelBase::new(BaseKind::Differential, 0.10, 0.50);
        let mut wheels = WheelOdometry::new(WheelConfig::new(base));
        for k in 0..100 {
            wheels.buffer.push(WheelReading::new(k * 20_000_000, [1.0, 1.0])).unwrap();
        }
        for k in 2..18 {
            wheels.add_clone(CloneId(k), k as i64 * 100_000_000);
            if let Some(due) = wheels.next_due(0.0) {
                wheels.keep(due.clones);
            }
        }
        let kept = wheels.take_untried();
        assert_eq!(kept.len(), 15);
        for clones in kept {
            for offset_s in [0.0, 0.05, -0.05] {
                let Interval::Covered(cut) = wheels.readings_between(&clones, offset_s) else {
                    panic!("readings are gone")
                };
                let begin_ns = clones.both[0].stamp_ns - nanoseconds(offset_s);
                assert_eq!(cut.readings[0].stamp_ns, begin_ns);
            }
        }
    }
}
