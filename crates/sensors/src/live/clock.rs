//! Jumps of a stream's clock, told from messages that are merely late.
//!
//! A message cannot arrive before it was made, so the largest difference `stamp - arrival` of the last seconds is that of a
//! message with next to no delay. A late message has a smaller difference, and its stamp still follows the one before. The clock has
//! jumped where several messages in a row are ahead of that difference, or behind stamps that came before. From then on the jump is
//! subtracted: the stamps that leave here are continuous.

use crate::stamps::{BACKWARD_NS, CONFIRMING};
use std::time::Duration;

/// Smallest jump forward that is told from jitter, nanoseconds.
const FORWARD_NS: i64 = 400_000_000;
/// So many suspects are held at most; then the jump is believed.
const MAX_SUSPECTS: usize = 512;
/// The least delay is that of the last one or two of these, nanoseconds of arrival.
const WINDOW: Duration = Duration::from_secs(10);
/// Before the stream is so old its least delay is not known.
const LEARNING: Duration = Duration::from_secs(1);

/// Makes the stamps of one stream continuous.
#[derive(Debug)]
pub(super) struct StreamClock<T> {
    /// A jump is believed after it has lasted for so long.
    confirm: Duration,
    /// Subtracted from every stamp, nanoseconds.
    jumped_ns: i64,
    least_delay: LeastDelay,
    newest: Option<(i64, Duration)>,
    suspects: Vec<Suspect<T>>,
}

/// A message whose stamp is far from what was expected.
#[derive(Debug)]
struct Suspect<T> {
    stamp_ns: i64,
    arrival: Duration,
    item: T,
}

/// What the clock makes of a message.
#[derive(Debug)]
pub(super) enum Admitted<T> {
    /// Its continuous stamp. So many suspects before it had wrong stamps.
    Message(i64, T, usize),
    /// It is held until the next ones tell.
    Held,
    /// The clock has jumped by so much, nanoseconds, and these are the messages since.
    Jumped(i64, Vec<(i64, T)>),
}

impl<T> StreamClock<T> {
    pub(super) fn new(confirm: Duration) -> Self {
        let least_delay = LeastDelay::default();
        Self { confirm, jumped_ns: 0, least_delay, newest: None, suspects: Vec::new() }
    }

    /// What is subtracted from the stamps, nanoseconds.
    pub(super) fn jumped_ns(&self) -> i64 {
        self.jumped_ns
    }

    /// Takes a message in.
    ///
    /// # Arguments
    /// * `agreed`: replaces a jump by the one that another stream of the same computer had, if that is about the same.
    pub(super) fn admit(
        &mut self,
        stamp_ns: i64,
        arrival: Duration,
        item: T,
        agreed: impl FnOnce(i64) -> i64,
    ) -> Admitted<T> {
        let continuous_ns = stamp_ns.saturating_sub(self.jumped_ns);
        if !self.is_suspect(continuous_ns, arrival) {
            let wrong = self.suspects.len();
            self.suspects.clear();
            self.take(continuous_ns, arrival);
            return Admitted::Message(continuous_ns, item, wrong);
        }
        // Suspects that contradict each other are no jump.
        let ahead = |stamp_ns: i64, arrival: Duration| i128::from(stamp_ns) - arrival.as_nanos() as i128;
        let first = self.suspects.first().map(|first| ahead(first.stamp_ns, first.arrival));
        if first.is_some_and(|first| (first - ahead(stamp_ns, arrival)).abs() > i128::from(FORWARD_NS)) {
            self.suspects.clear();
        }
        self.suspects.push(Suspect { stamp_ns, arrival, item });
        let lasted = arrival.saturating_sub(self.suspects[0].arrival);
        let is_long = self.suspects.len() >= CONFIRMING && lasted >= self.confirm;
        if is_long || self.suspects.len() >= MAX_SUSPECTS { self.jump(agreed) } else { Admitted::Held }
    }

    fn is_suspect(&self, stamp_ns: i64, arrival: Duration) -> bool {
        let Some((newest_ns, newest_arrival)) = self.newest else { return false };
        if stamp_ns < newest_ns.saturating_sub(BACKWARD_NS) {
            return true;
        }
        let elapsed_ns = arrival.saturating_sub(newest_arrival).as_nanos() as i64;
        let leap_ns = stamp_ns.saturating_sub(newest_ns).saturating_sub(elapsed_ns);
        leap_ns > FORWARD_NS && self.least_delay.excess(stamp_ns, arrival).is_some_and(|ns| ns > FORWARD_NS)
    }

    fn take(&mut self, stamp_ns: i64, arrival: Duration) {
        self.least_delay.add(stamp_ns, arrival);
        if self.newest.is_none_or(|(newest_ns, _)| stamp_ns >= newest_ns) {
            self.newest = Some((stamp_ns, arrival));
        }
    }

    /// Believes the jump that the suspects show.
    fn jump(&mut self, agreed: impl FnOnce(i64) -> i64) -> Admitted<T> {
        let suspects = std::mem::take(&mut self.suspects);
        let excess = |suspect: &Suspect<T>| {
            self.least_delay.excess_or_zero(suspect.stamp_ns - self.jumped_ns, suspect.arrival)
        };
        let shown_ns = suspects.iter().map(excess).max().unwrap_or_default();
        // The first message after the jump stays behind the last one before.
        let first_ns = suspects.first().map_or(0, |first| first.stamp_ns - self.jumped_ns);
        let newest_ns = self.newest.map_or(first_ns, |(newest_ns, _)| newest_ns);
        let jump_ns = agreed(shown_ns.min(first_ns.saturating_sub(newest_ns).saturating_sub(1)));
        self.jumped_ns = self.jumped_ns.saturating_add(jump_ns);
        let mut messages = Vec::with_capacity(suspects.len());
        for Suspect { stamp_ns, arrival, item } in suspects {
            let continuous_ns = stamp_ns.saturating_sub(self.jumped_ns);
            self.take(continuous_ns, arrival);
            messages.push((continuous_ns, item));
        }
        Admitted::Jumped(jump_ns, messages)
    }
}

/// The largest `stamp - arrival` of the last ten to twenty seconds, nanoseconds.
#[derive(Debug, Default)]
struct LeastDelay {
    began: Option<Duration>,
    bucket: Duration,
    current_ns: Option<i64>,
    previous_ns: Option<i64>,
}

impl LeastDelay {
    fn add(&mut self, stamp_ns: i64, arrival: Duration) {
        self.began.get_or_insert(arrival);
        if arrival.saturating_sub(self.bucket) > WINDOW {
            (self.bucket, self.previous_ns) = (arrival, self.current_ns.take());
        }
        let ahead_ns = stamp_ns.saturating_sub(arrival.as_nanos() as i64);
        self.current_ns = Some(self.current_ns.map_or(ahead_ns, |ns| ns.max(ahead_ns)));
    }

    /// How far a message is ahead of the one with the least delay; `None` while that is not known.
    fn excess(&self, stamp_ns: i64, arrival: Duration) -> Option<i64> {
        let is_known = self.began.is_some_and(|began| arrival.saturating_sub(began) >= LEARNING);
        is_known.then(|| self.excess_or_zero(stamp_ns, arrival))
    }

    fn excess_or_zero(&self, stamp_ns: i64, arrival: Duration) -> i64 {
        let least = self.current_ns.into_iter().chain(self.previous_ns).max();
        least.map_or(0, |least| stamp_ns.saturating_sub(arrival.as_nanos() as i64).saturating_sub(least))
    }
}
