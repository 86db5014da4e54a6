//! Slip, and wheels that report nonsense.
//!
//! A wheel that slips contradicts the state for a moment: its interval is rejected and counted. Wheels whose intervals are
//! rejected for most of a second are left out until they agree again for two. Nor are they used before they have agreed for a
//! quarter of a second in which wheels that report half of the motion would not have: a velocity that is hardly known yet passes any
//! test, as standing still does, and nonsense would become its value.

use std::collections::VecDeque;
use std::fmt;
use types::{BaseKind, MAX_WHEELS};

/// Time over which intervals are looked at, nanoseconds.
const WINDOW_NS: i64 = 1_000_000_000;
/// Time that the intervals of it must cover before wheels are left out, nanoseconds.
const MIN_SPAN_NS: i64 = 750_000_000;
/// Time in which wheels must have agreed before they are used, where nonsense would not have, nanoseconds.
const AGREED_NS: i64 = 250_000_000;
/// Time over which wheels that were left out must agree, nanoseconds.
const AGAIN_NS: i64 = 2_000_000_000;
/// Part of the time in which the intervals must be rejected, or must agree.
const MOST: f64 = 0.7;
/// Time without a usable reading after which the wheels are silent, nanoseconds.
const SILENT_NS: i64 = 800_000_000;
/// One wheel is to blame where its squared residuals are so many times those of any other.
const BLAME: f64 = 4.0;

/// A wheel, or the steering.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Wheel {
    /// That of a number of the readings.
    Of(BaseKind, usize),
    /// Several, or it cannot be told which.
    Several,
}

impl fmt::Display for Wheel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Of(BaseKind::Ackermann, 1) => f.write_str("the steering contradicts"),
            Self::Of(BaseKind::Ackermann, _) => f.write_str("the speed of the driven axle contradicts"),
            Self::Of(kind @ (BaseKind::Omni3 | BaseKind::Omni4), index) => {
                write!(f, "{} contradicts", kind.columns()[*index].replace('_', " "))
            }
            Self::Of(kind, index) => {
                write!(f, "the {} wheel contradicts", kind.columns()[*index].replace('_', " "))
            }
            Self::Several => f.write_str("the wheels contradict"),
        }
    }
}

/// Why the wheels are left out.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum WheelFault {
    /// What they turn is not how the body moves.
    #[error(
        "{wheel} cameras and IMU: wheel odometry is left out until they agree; check encoders, units and signs, radii, track \
         (wheelbase, reach) and base pose, and whether the wheels slip"
    )]
    Contradiction {
        /// Which one.
        wheel: Wheel,
    },
    /// There are no readings that can be used.
    #[error("no usable readings of the wheels for {seconds:.1} s: check the encoders and their stamps")]
    Silent {
        /// For how long, seconds.
        seconds: f64,
    },
}

/// The test of one interval.
#[derive(Clone, Copy, Debug)]
struct Tested {
    from_ns: i64,
    to_ns: i64,
    is_accepted: bool,
    /// Squared residuals of the wheels, m^2.
    squares: [f64; MAX_WHEELS],
}

/// The watch over the wheels.
#[derive(Clone, Debug)]
pub struct WheelWatch {
    base: BaseKind,
    tested: VecDeque<Tested>,
    /// For how long they have agreed where that tells something, less the time in which they have not; until it is enough, nanoseconds.
    agreed_ns: i64,
    contradicts: Option<Wheel>,
    /// Since when there are no usable readings, nanoseconds.
    missing_since_ns: Option<i64>,
    silent_s: Option<f64>,
}

impl WheelWatch {
    /// Nothing was tested yet.
    pub fn new(base: BaseKind) -> Self {
        Self {
            base,
            tested: VecDeque::new(),
            agreed_ns: 0,
            contradicts: None,
            missing_since_ns: None,
            silent_s: None,
        }
    }

    /// Takes in the test of an interval.
    ///
    /// # Arguments
    /// * `span_ns`: begin and end, nanoseconds.
    /// * `residual_m`: of each wheel, metres.
    /// * `is_telling`: whether wheels that report something else would have failed the test.
    pub fn note(
        &mut self,
        span_ns: [i64; 2],
        is_accepted: bool,
        residual_m: [f64; MAX_WHEELS],
        is_telling: bool,
    ) {
        let [from_ns, to_ns] = span_ns;
        (self.missing_since_ns, self.silent_s) = (None, None);
        self.tested.push_back(Tested { from_ns, to_ns, is_accepted, squares: residual_m.map(|r| r * r) });
        let window_ns = if self.contradicts.is_some() { AGAIN_NS } else { WINDOW_NS };
        while self.tested.front().is_some_and(|oldest| to_ns - oldest.from_ns > window_ns) {
            self.tested.pop_front();
        }
        if is_telling && !self.has_agreed() {
            let change_ns = if is_accepted { to_ns - from_ns } else { from_ns - to_ns };
            self.agreed_ns = (self.agreed_ns + change_ns).max(0);
        }
        match self.contradicts {
            None if self.covered_ns(|tested| !tested.is_accepted) > MIN_SPAN_NS as f64 * MOST
                && self.covered_ns(|_| true) >= MIN_SPAN_NS as f64
                && self.part(|tested| !tested.is_accepted) >= MOST =>
            {
                self.contradicts = Some(self.blamed());
                self.tested.clear();
            }
            Some(_)
                if self.covered_ns(|_| true) >= AGAIN_NS as f64 * 0.9
                    && self.part(|tested| tested.is_accepted) >= MOST =>
            {
                self.contradicts = None;
                self.tested.clear();
            }
            _ => {}
        }
    }

    /// Takes in that there are no usable readings for an interval.
    pub fn note_missing(&mut self, from_ns: i64, to_ns: i64) {
        let since_ns = *self.missing_since_ns.get_or_insert(from_ns);
        if to_ns - since_ns >= SILENT_NS {
            self.silent_s = Some((to_ns - since_ns) as f64 * 1e-9);
        }
    }

    /// Whether intervals that pass their test are used.
    pub fn is_trusted(&self) -> bool {
        self.has_agreed() && self.contradicts.is_none()
    }

    /// Whether they have agreed for long enough in intervals that tell.
    pub fn has_agreed(&self) -> bool {
        self.agreed_ns >= AGREED_NS
    }

    /// Why the wheels are left out.
    pub fn fault(&self) -> Option<WheelFault> {
        let silent = self.silent_s.map(|seconds| WheelFault::Silent { seconds });
        silent.or(self.contradicts.map(|wheel| WheelFault::Contradiction { wheel }))
    }

    fn covered_ns(&self, which: impl Fn(&Tested) -> bool) -> f64 {
        self.tested
            .iter()
            .filter(|tested| which(tested))
            .map(|tested| (tested.to_ns - tested.from_ns) as f64)
            .sum()
    }

    fn part(&self, which: impl Fn(&Tested) -> bool) -> f64 {
        self.covered_ns(which) / self.covered_ns(|_| true).max(1.0)
    }

    /// The wheel whose residuals are larger.
    fn blamed(&self) -> Wheel {
        let rejected = self.tested.iter().filter(|tested| !tested.is_accepted);
        let mut sums: Vec<(f64, usize)> = (0..self.base.columns().len()).map(|index| (0.0, index)).collect();
        for tested in rejected {
            for (sum, index) in &mut sums {
                *sum += tested.squares[*index];
            }
        }
        sums.sort_by(|one, other| other.0.total_cmp(&one.0));
        match sums.as_slice() {
            [(most, index), (next, _), ..] if *most > BLAME * next => Wheel::Of(self.base, *index),
            _ => Wheel::Several,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP_NS: i64 = 50_000_000;

    /// Intervals of 50 ms, each accepted or not.
    fn noted(watch: &mut WheelWatch, begin: i64, intervals: impl Iterator<Item = bool>) -> i64 {
        let mut next = begin;
        for is_accepted in intervals {
            watch.note([next * STEP_NS, (next + 1) * STEP_NS], is_accepted, [0.02, 0.001, 0.0, 0.0], true);
            next += 1;
        }
        next
    }

    #[test]
    fn half_a_second_of_slip_is_no_fault_and_a_second_of_nonsense_is() {
        let mut watch = WheelWatch::new(BaseKind::Differential);
        let now = noted(&mut watch, 0, (0..40).map(|_| true));
        let now = noted(&mut watch, now, (0..11).map(|_| false));
        assert!(watch.is_trusted());
        let now = noted(&mut watch, now, (0..30).map(|_| true));
        let now = noted(&mut watch, now, (0..19).map(|_| false));
        assert_eq!(
            watch.fault(),
            Some(WheelFault::Contradiction { wheel: Wheel::Of(BaseKind::Differential, 0) })
        );
        assert!(watch.fault().unwrap().to_string().starts_with("the left wheel contradicts"));
        let now = noted(&mut watch, now, (0..30).map(|_| true));
        assert!(!watch.is_trusted(), "they have to agree for two seconds");
        noted(&mut watch, now, (0..15).map(|_| true));
        assert!(watch.is_trusted() && watch.fault().is_none());
    }

    #[test]
    fn wheels_are_used_once_they_have_agreed_and_nonsense_from_the_start_never_is() {
        let mut watch = WheelWatch::new(BaseKind::Differential);
        assert!(!watch.is_trusted() && watch.fault().is_none());
        // One of the first intervals passes, as the velocity is not known yet.
        let now = noted(&mut watch, 0, (0..30).map(|k| k == 2));
        assert!(!watch.is_trusted() && watch.fault().is_some());
        noted(&mut watch, now, (0..50).map(|_| true));
        assert!(watch.is_trusted() && watch.fault().is_none());
        let mut watch = WheelWatch::new(BaseKind::Differential);
        noted(&mut watch, 0, (0..15).map(|_| true));
        assert!(watch.is_trusted());
    }

    #[test]
    fn passing_a_test_that_anything_passes_is_no_agreement() {
        let mut watch = WheelWatch::new(BaseKind::Differential);
        for k in 0..100 {
            watch.note([k * STEP_NS, (k + 1) * STEP_NS], true, [0.0; 4], false);
        }
        assert!(!watch.is_trusted());
        let now = noted(&mut watch, 100, (0..30).map(|k| k % 3 == 0));
        assert!(!watch.is_trusted(), "they pass now and then");
        noted(&mut watch, now, (0..60).map(|_| true));
        assert!(watch.is_trusted());
    }

    #[test]
    fn silence_is_a_fault() {
        let mut watch = WheelWatch::new(BaseKind::Differential);
        let now = noted(&mut watch, 0, (0..40).map(|_| true));
        for k in now..now + 16 {
            watch.note_missing(k * STEP_NS, (k + 1) * STEP_NS);
        }
        assert!(matches!(watch.fault(), Some(WheelFault::Silent { .. })));
        noted(&mut watch, now + 16, [true].into_iter());
        assert_eq!(watch.fault(), None);
    }
}
