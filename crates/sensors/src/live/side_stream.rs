//! A stream whose readings come out as they come in: the estimator knows which of them it waits for.

use super::fault::{FaultKind, FaultLog, LiveFault};
use super::lane::{Jump, Lane};
use super::stream::{Stream, check_stamp};
use crate::{GnssReading, WheelReading, push_newest};
use std::collections::VecDeque;
use std::time::Duration;

/// Readings that wait for the estimator, 100 s at 100 Hz; beyond, the oldest are left out.
const MAX_READINGS: usize = 10_000;

/// A reading of such a stream.
pub(super) trait SideReading: Sized {
    /// What is wrong where its numbers cannot be used.
    const UNUSABLE: &'static str;

    fn stamp_ns(&self) -> i64;

    /// The same at another time.
    fn at(self, stamp_ns: i64) -> Self;

    /// Whether its numbers can be used.
    fn is_usable(&self) -> bool;
}

impl SideReading for WheelReading {
    const UNUSABLE: &'static str =
        "readings of the wheels are not finite, and are not used; check the encoders";

    fn stamp_ns(&self) -> i64 {
        self.stamp_ns
    }

    fn at(self, stamp_ns: i64) -> Self {
        Self { stamp_ns, ..self }
    }

    fn is_usable(&self) -> bool {
        self.is_finite()
    }
}

impl SideReading for GnssReading {
    const UNUSABLE: &'static str =
        "positions of GNSS are not finite, or have no valid covariance, and are not used; check the receiver";

    fn stamp_ns(&self) -> i64 {
        self.stamp_ns
    }

    fn at(self, stamp_ns: i64) -> Self {
        Self { stamp_ns, ..self }
    }

    fn is_usable(&self) -> bool {
        self.is_valid()
    }
}

/// Readings on their way to the estimator.
#[derive(Debug)]
pub(super) struct SideStream<T> {
    stream: Stream,
    lane: Lane<T>,
    /// Not returned yet.
    readings: VecDeque<T>,
}

impl<T: SideReading> SideStream<T> {
    pub(super) fn new(stream: Stream) -> Self {
        Self { stream, lane: Lane::new(stream, None), readings: VecDeque::new() }
    }

    /// A message has arrived that holds no reading.
    pub(super) fn arrived(&mut self, now: Duration) {
        self.lane.arrived(now);
    }

    /// Takes a reading in.
    pub(super) fn take(
        &mut self,
        reading: T,
        now: Duration,
        newest_jump: &mut Option<Jump>,
        faults: &mut FaultLog,
    ) {
        self.lane.arrived(now);
        if !reading.is_usable() {
            return faults.note(self.stream, FaultKind::NotFinite, now, T::UNUSABLE.to_owned());
        }
        let stamp_ns = reading.stamp_ns();
        if !check_stamp(self.stream, stamp_ns, now, faults) {
            return;
        }
        for (stamp_ns, reading) in self.lane.admit((stamp_ns, reading), now, newest_jump, faults) {
            push_newest(&mut self.readings, reading.at(stamp_ns), MAX_READINGS);
        }
    }

    /// The oldest reading that was not returned yet.
    pub(super) fn pop(&mut self) -> Option<T> {
        self.readings.pop_front()
    }

    /// What is wrong with the stream as a whole.
    pub(super) fn state(&self, now: Duration) -> Option<LiveFault> {
        self.lane.state(now)
    }
}
