//! What is wrong with live streams, and since when.

use super::stream::Stream;
use std::collections::BTreeMap;
use std::fmt;
use std::time::Duration;

/// A fault that happened is active for so long after it happened last.
const ACTIVE: Duration = Duration::from_secs(5);

/// Kinds of faults of a live stream. None of them ends a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[non_exhaustive]
pub enum FaultKind {
    /// Nothing has come since the start.
    Missing,
    /// Nothing comes any more.
    Silent,
    /// The rate is not the one that the calibration states.
    WrongRate,
    /// The clock of the stream jumped.
    ClockJump,
    /// Single stamps are far from those before and after.
    WrongStamp,
    /// Messages came too late to be sorted in.
    Late,
    /// Messages came twice.
    Duplicate,
    /// Readings are not finite.
    NotFinite,
    /// Messages cannot be read: encoding, size, damage.
    Unreadable,
    /// The camera sends one image again and again.
    Frozen,
    /// One camera of the pair has images without a partner.
    Unpaired,
    /// Images were dropped because the processor does not keep up.
    Overload,
    /// Images were dropped because no readings of the IMU came for them.
    WithoutImu,
}

/// A fault of a live stream that lasts, or happened in the last seconds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LiveFault {
    /// The stream.
    pub stream: Stream,
    /// The kind.
    pub kind: FaultKind,
    /// What is wrong and what to do, without the name of the stream.
    pub problem: String,
}

impl fmt::Display for LiveFault {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}: {}", self.stream, self.problem)
    }
}

/// How often something happened, and the last message about it.
#[derive(Debug)]
struct Entry {
    count: u64,
    last: Duration,
    problem: String,
}

/// Faults that happen at single messages.
#[derive(Debug, Default)]
pub(super) struct FaultLog {
    entries: BTreeMap<(Stream, FaultKind), Entry>,
}

impl FaultLog {
    /// Notes that something happened once more.
    pub(super) fn note(&mut self, stream: Stream, kind: FaultKind, now: Duration, problem: String) {
        let entry = Entry { count: 0, last: now, problem: String::new() };
        let entry = self.entries.entry((stream, kind)).or_insert(entry);
        (entry.count, entry.last, entry.problem) = (entry.count + 1, now, problem);
    }

    /// How often it happened.
    #[cfg(test)]
    pub(super) fn count(&self, stream: Stream, kind: FaultKind) -> u64 {
        self.entries.get(&(stream, kind)).map_or(0, |entry| entry.count)
    }

    /// How often a kind happened on all streams together.
    pub(super) fn total(&self, kind: FaultKind) -> u64 {
        self.entries.iter().filter(|((_, of), _)| *of == kind).map(|(_, entry)| entry.count).sum()
    }

    /// What happened in the last seconds.
    pub(super) fn active(&self, now: Duration) -> Vec<LiveFault> {
        let is_active = |entry: &Entry| now.saturating_sub(entry.last) <= ACTIVE;
        let fault = |(&(stream, kind), entry): (&(Stream, FaultKind), &Entry)| LiveFault {
            stream,
            kind,
            problem: format!("{} ({} so far)", entry.problem, entry.count),
        };
        self.entries.iter().filter(|(_, entry)| is_active(entry)).map(fault).collect()
    }
}
