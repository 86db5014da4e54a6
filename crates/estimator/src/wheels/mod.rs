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
/// Readings are kept for so long before the oldest image that waits, nanoseconds: the estimated time offset changes.
const KEPT_NS: i64 = 100_000_000;

/// Intervals that are kept until wheels are used: more than a window has.
const MAX_UNTRIED: usize = 32;

/// A clone, and its time by the clock of the IMU.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TimedClone {
    pub(crate) id: CloneId,
    pub(crate) stamp_ns: i64,
}

/// Two consecutive clones, and the readings between them.
#[derive(Clone, Debug)]
pub(crate) struct DueInterval {
    pub(crate) clones: [TimedClone; 2],
    /// The clone before them, and the one after them.
    pub(crate) before: Option<TimedClone>,
    pub(crate) after: Option<TimedClone>,
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
    /// The newest intervals that were tested while wheels are not used.
    pub(crate) untried: VecDeque<DueInterval>,
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

    /// Keeps an interval that was tested before wheels are used, for when they are.
    pub(crate) fn keep(&mut self, due: DueInterval) {
        push_newest(&mut self.untried, due, MAX_UNTRIED);
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
        let offset_ns = (time_offset_s * 1e9).round() as i64;
        while let (Some(&first), Some(&second), Some(&newest)) =
            (self.clones.front(), self.clones.get(1), self.clones.back())
        {
            let span_ns = [first.stamp_ns, second.stamp_ns];
            let is_late = newest.stamp_ns - first.stamp_ns > MAX_DELAY_NS;
            let found = match self.buffer.interval(span_ns[0] - offset_ns, span_ns[1] - offset_ns) {
                Interval::NotYet if !is_late => return None,
                Interval::Covered(readings) if span_ns[1] - span_ns[0] <= MAX_INTERVAL_NS => Some(readings),
                _ => None,
            };
            let before = std::mem::replace(&mut self.before, self.clones.pop_front());
            self.buffer.remove_before(second.stamp_ns - offset_ns - KEPT_NS);
            if let Some(readings) = found {
                let after = self.clones.get(1).copied();
                return Some(DueInterval { clones: [first, second], before, after, readings });
            }
            self.counts.missing += 1;
            self.watch.note_missing(span_ns[0], newest.stamp_ns);
        }
        None
    }
}
