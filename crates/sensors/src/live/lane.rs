//! What every stream goes through when a message arrives: presence, clock, duplicates, rate.

use super::clock::{Admitted, StreamClock};
use super::fault::{FaultKind, FaultLog, LiveFault};
use super::stream::Stream;
use super::watch::{SILENT, StreamWatch};
use crate::push_newest;
use crate::stamps::CONFIRMING_NS;
use std::collections::VecDeque;
use std::time::Duration;

/// Stamps that are compared with those of new messages.
const RECENT: usize = 512;
/// A jump of the IMU's clock is believed after it has lasted for so long; that of other streams later, so that they find it.
const CONFIRM_IMU: Duration = Duration::from_nanos(CONFIRMING_NS as u64);
const CONFIRM: Duration = Duration::from_millis(150);
/// GNSS is silent after so long: receivers send a position a second, or fewer.
const SILENT_GNSS: Duration = Duration::from_secs(5);
/// Two streams jumped together if their jumps differ by less than this, nanoseconds.
const SAME_JUMP_NS: i64 = 100_000_000;
/// And if one came so soon after the other.
const SAME_JUMP_WITHIN: Duration = Duration::from_secs(5);

/// The newest jump of a clock.
#[derive(Clone, Copy, Debug)]
pub(super) struct Jump {
    by_ns: i64,
    at: Duration,
}

/// One stream.
#[derive(Debug)]
pub(super) struct Lane<T> {
    stream: Stream,
    clock: StreamClock<T>,
    watch: StreamWatch,
    recent: VecDeque<i64>,
}

impl<T> Lane<T> {
    pub(super) fn new(stream: Stream, stated_hz: Option<f64>) -> Self {
        let confirm = if stream == Stream::Imu { CONFIRM_IMU } else { CONFIRM };
        let silent = if stream == Stream::Gnss { SILENT_GNSS } else { SILENT };
        let (clock, watch) = (StreamClock::new(confirm), StreamWatch::new(silent, stated_hz));
        Self { stream, clock, watch, recent: VecDeque::with_capacity(RECENT) }
    }

    /// Takes a message in. A message that is refused for what it holds has arrived all the same.
    pub(super) fn arrived(&mut self, now: Duration) {
        self.watch.arrived(now);
    }

    /// The messages that can be used now, with continuous stamps.
    pub(super) fn admit(
        &mut self,
        (stamp_ns, item): (i64, T),
        now: Duration,
        newest_jump: &mut Option<Jump>,
        faults: &mut FaultLog,
    ) -> Vec<(i64, T)> {
        let agreed = |jump_ns: i64| match newest_jump {
            Some(jump)
                if (jump.by_ns - jump_ns).abs() < SAME_JUMP_NS
                    && now.saturating_sub(jump.at) < SAME_JUMP_WITHIN =>
            {
                jump.by_ns
            }
            _ => jump_ns,
        };
        let mut messages = match self.clock.admit(stamp_ns, now, item, agreed) {
            Admitted::Held => return Vec::new(),
            Admitted::Message(stamp_ns, item, wrong) => {
                for _ in 0..wrong {
                    let problem = format!(
                        "{} with stamps far from those before and after are not used; check the driver's clock",
                        self.stream.noun()
                    );
                    faults.note(self.stream, FaultKind::WrongStamp, now, problem);
                }
                vec![(stamp_ns, item)]
            }
            Admitted::Jumped(by_ns, messages) => {
                *newest_jump = Some(Jump { by_ns, at: now });
                let seconds = by_ns as f64 * 1e-9;
                let problem = format!(
                    "the clock jumped by {seconds:.3} s; the estimator's time goes on without the jump"
                );
                faults.note(self.stream, FaultKind::ClockJump, now, problem);
                messages
            }
        };
        messages.retain(|(stamp_ns, _)| self.is_new(*stamp_ns, now, faults));
        messages
    }

    fn is_new(&mut self, stamp_ns: i64, now: Duration, faults: &mut FaultLog) -> bool {
        if self.recent.contains(&stamp_ns) {
            let problem = format!("{} come twice; the second is not used", self.stream.noun());
            faults.note(self.stream, FaultKind::Duplicate, now, problem);
            return false;
        }
        push_newest(&mut self.recent, stamp_ns, RECENT);
        self.watch.accepted(stamp_ns);
        true
    }

    /// Usual distance of two messages, nanoseconds.
    pub(super) fn period_ns(&self) -> Option<i64> {
        self.watch.period_ns()
    }

    /// Whether messages come.
    pub(super) fn is_alive(&self, now: Duration) -> bool {
        self.watch.silence(now).is_none()
    }

    /// What is subtracted from the stamps, nanoseconds.
    pub(super) fn jumped_ns(&self) -> i64 {
        self.clock.jumped_ns()
    }

    /// What is wrong with the stream as a whole.
    pub(super) fn state(&self, now: Duration) -> Option<LiveFault> {
        let noun = self.stream.noun();
        let (kind, problem) = if let Some(silence) = self.watch.silence(now) {
            let seconds = silence.as_secs_f64();
            if self.watch.has_come() {
                (
                    FaultKind::Silent,
                    format!("no {noun} for {seconds:.1} s; check the driver and its connection"),
                )
            } else {
                (
                    FaultKind::Missing,
                    format!("no {noun} have come in {seconds:.1} s; check the driver and the topic"),
                )
            }
        } else {
            let (measured, stated) = self.watch.wrong_rate()?;
            let problem = format!(
                "{measured:.1} {noun} a second where the calibration states {stated:.1}; set the driver to that rate, or correct the \
                 calibration"
            );
            (FaultKind::WrongRate, problem)
        };
        Some(LiveFault { stream: self.stream, kind, problem })
    }
}
