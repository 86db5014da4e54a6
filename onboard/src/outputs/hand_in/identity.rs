//! What identifies a session while it is recorded.

use estimator::ImuSample;
use hand_in::RecordedSoFar;
use map::sessions::RecordedDigest;
use std::collections::{BTreeSet, VecDeque};

/// The identity of a session: that which the ledger of a map would have of the same drive in a recording with images.
///
/// The ledger counts the readings from the first image to before the last one, so a reading counts once an image after it has come.
#[derive(Debug, Default)]
pub(super) struct SessionIdentity {
    digest: RecordedDigest,
    begun: bool,
    waiting: VecDeque<ImuSample>,
    written_samples: BTreeSet<u64>,
}

impl SessionIdentity {
    pub(super) fn reading(&mut self, reading: &ImuSample) {
        self.waiting.push_back(*reading);
    }

    pub(super) fn image(&mut self, stamp_ns: i64) {
        while let Some(reading) = self.waiting.pop_front_if(|reading| reading.stamp_ns < stamp_ns) {
            if self.begun {
                let [[a, b, c], [d, e, f]] = [reading.gyroscope, reading.accelerometer].map(<[f64; 3]>::from);
                self.digest.add_reading(reading.stamp_ns, [a, b, c, d, e, f]);
            }
        }
        self.begun = true;
        self.digest.add_image(stamp_ns);
    }

    /// The identity of what came so far.
    pub(super) fn so_far(&mut self) -> RecordedSoFar {
        let recorded = self.digest.clone().finish();
        let is_new = |sample: &u64| self.written_samples.insert(*sample);
        let new_samples = recorded.samples.digests().iter().copied().filter(is_new).collect();
        RecordedSoFar {
            id: recorded.id.to_bytes(),
            begin_ns: recorded.begin_ns,
            end_ns: recorded.end_ns,
            images: recorded.images,
            readings: recorded.readings,
            new_samples,
        }
    }

    /// Readings that wait are of a clock that was set by so many nanoseconds.
    pub(super) fn shift_clock(&mut self, by_ns: i64) {
        self.waiting.iter_mut().for_each(|reading| reading.stamp_ns = reading.stamp_ns.saturating_add(by_ns));
    }

    /// The identity of the next session; readings that came since the last image may be part of it.
    pub(super) fn begin_next(&mut self) {
        let waiting = std::mem::take(&mut self.waiting);
        *self = Self { waiting, ..Self::default() };
    }
}
