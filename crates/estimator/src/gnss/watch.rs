//! GNSS that contradicts the state for long, does not follow odometry, or has another clock.
//!
//! A jump or a reflection is rejected for some readings, and counted. Where most readings are rejected for ten seconds, GNSS is left
//! out until most agree for as long, and that is an alarm. Which of both is wrong, the state or GNSS, is not known then: the
//! readings of a street between tall houses agree with each other, too. GNSS replaces `global_from_local` only if it contradicts
//! for a minute and on a way over which a lasting error of reflections changes, and if no map supports the state.
//!
//! Before `global_from_local` is known there is no state to contradict: positions that do not follow odometry on a way of some
//! length, and ones whose times are far from those of the images, initialize nothing. Both are alarms.

use nalgebra::Vector3;
use std::collections::VecDeque;

/// Time over which readings are looked at, nanoseconds.
const WINDOW_NS: i64 = 10_000_000_000;
/// Fewest readings in it that are judged.
const MIN_READINGS: usize = 5;
/// Part of the readings that must be rejected, or must agree.
const MOST: f64 = 0.7;
/// Time of contradiction after which GNSS may be right, nanoseconds.
const LONG_NS: i64 = 60_000_000_000;
/// Way on which it must contradict for that, metres.
const FAR_M: f64 = 50.0;
/// Least extent of the way by odometry on which positions that do not fit are an alarm, metres: what reflections at its begin can do is
/// waited for.
const MIN_EXTENT_M: f64 = 5.0;
/// Least time over which they do not fit, nanoseconds.
const UNALIGNED_NS: i64 = 20_000_000_000;
/// Readings in a row whose times are far from those of the images.
const MAX_APART: usize = 20;

/// Why GNSS is left out.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum GnssFault {
    /// Its positions are not where the state is.
    #[error(
        "GNSS contradicts the pose for {seconds:.0} s, by {metres:.1} m now: it is left out until they agree; reflections, or check its origin, \
         the antenna's position, the clock, and whether the map is in the frame of the positions"
    )]
    Contradiction {
        /// For how long, seconds.
        seconds: f64,
        /// How far the newest reading is from where it is expected, metres.
        metres: f64,
    },
    /// Its positions do not follow odometry, so that `global_from_local` is not initialized.
    #[error(
        "the positions of GNSS do not follow the odometry for {seconds:.0} s, and do not initialize the pose: by odometry the root mean square \
         distance from their mean is {local_m:.1} m, theirs is {global_m:.1} m; check their unit, their axes (east, north, up), the clock, the \
         standard deviations that they state, and whether they change at all"
    )]
    Unaligned {
        /// For how long, seconds.
        seconds: f64,
        /// Extent by odometry, metres.
        local_m: f64,
        /// Extent by the positions, metres.
        global_m: f64,
    },
    /// Its times are not those of the images.
    #[error(
        "the positions of GNSS are {seconds:.0} s {} the images: they are not used; check the clock of the receiver, and the time offset",
        if *ahead { "ahead of" } else { "behind" }
    )]
    Clock {
        /// By how much, seconds.
        seconds: f64,
        /// Whether they are ahead.
        ahead: bool,
    },
}

/// The test of one reading.
#[derive(Clone, Copy, Debug)]
struct Tested {
    stamp_ns: i64,
    is_accepted: bool,
}

/// A contradiction.
#[derive(Clone, Copy, Debug)]
struct Contradiction {
    since_ns: i64,
    until_ns: i64,
    metres: f64,
    /// Where it was noticed, in L.
    begin: Vector3<f64>,
    /// Largest distance from there since.
    way_m: f64,
}

/// The watch over GNSS.
#[derive(Clone, Debug, Default)]
pub(crate) struct GnssWatch {
    tested: VecDeque<Tested>,
    contradiction: Option<Contradiction>,
    unaligned: Option<GnssFault>,
    /// Readings in a row that are far from the images, and the newest one's time after them, nanoseconds.
    apart: usize,
    apart_ns: i64,
}

impl GnssWatch {
    /// Takes in the test of a reading.
    ///
    /// # Arguments
    /// * `in_local`: the antenna in L.
    /// * `metres`: distance of the reading from where it is expected.
    pub(crate) fn note(&mut self, stamp_ns: i64, is_accepted: bool, in_local: &Vector3<f64>, metres: f64) {
        // `global_from_local` is known, by the map where not by GNSS.
        self.unaligned = None;
        self.tested.push_back(Tested { stamp_ns, is_accepted });
        while self.tested.front().is_some_and(|oldest| stamp_ns - oldest.stamp_ns > WINDOW_NS) {
            self.tested.pop_front();
        }
        if let Some(contradiction) = &mut self.contradiction {
            (contradiction.until_ns, contradiction.metres) = (stamp_ns, metres);
            contradiction.way_m = contradiction.way_m.max((in_local - contradiction.begin).norm());
        }
        let first_ns = self.tested.front().map_or(stamp_ns, |oldest| oldest.stamp_ns);
        if self.tested.len() < MIN_READINGS || stamp_ns - first_ns < WINDOW_NS / 2 {
            return;
        }
        let accepted = self.tested.iter().filter(|tested| tested.is_accepted).count() as f64;
        let part = accepted / self.tested.len() as f64;
        if self.contradiction.is_none() && part <= 1.0 - MOST {
            let begin = *in_local;
            self.contradiction =
                Some(Contradiction { since_ns: first_ns, until_ns: stamp_ns, metres, begin, way_m: 0.0 });
        } else if self.contradiction.is_some() && part >= MOST {
            self.contradiction = None;
        }
    }

    /// Takes in positions that do not follow odometry.
    ///
    /// # Arguments
    /// * `extents_m`: root mean square distance from their mean, in L and in G.
    pub(crate) fn note_unaligned(&mut self, span_ns: i64, [local_m, global_m]: [f64; 2]) {
        if span_ns >= UNALIGNED_NS && local_m >= MIN_EXTENT_M {
            self.unaligned = Some(GnssFault::Unaligned { seconds: span_ns as f64 * 1e-9, local_m, global_m });
        }
    }

    /// Takes in the time of a reading after the newest image, nanoseconds.
    pub(crate) fn note_apart(&mut self, apart_ns: i64) {
        self.apart = if apart_ns.saturating_abs() > WINDOW_NS { self.apart + 1 } else { 0 };
        self.apart_ns = apart_ns;
    }

    /// Forgets what the state was tested by: it is another one.
    pub(crate) fn clear(&mut self) {
        let (apart, apart_ns) = (self.apart, self.apart_ns);
        *self = Self { apart, apart_ns, ..Self::default() };
    }

    /// Whether readings that pass their test are used.
    pub(crate) fn is_trusted(&self) -> bool {
        self.contradiction.is_none()
    }

    /// Since when GNSS contradicts the state, where it does for so long and so far that it may be right.
    pub(crate) fn long_since_ns(&self) -> Option<i64> {
        self.contradiction
            .filter(|found| found.until_ns - found.since_ns >= LONG_NS && found.way_m >= FAR_M)
            .map(|found| found.since_ns)
    }

    /// Why GNSS is left out.
    pub(crate) fn fault(&self) -> Option<GnssFault> {
        let contradiction = self.contradiction.map(|found| GnssFault::Contradiction {
            seconds: (found.until_ns - found.since_ns) as f64 * 1e-9,
            metres: found.metres,
        });
        let clock = (self.apart >= MAX_APART).then_some(GnssFault::Clock {
            seconds: self.apart_ns.unsigned_abs() as f64 * 1e-9,
            ahead: self.apart_ns > 0,
        });
        clock.or(contradiction).or(self.unaligned)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One reading a second, on a way of 1.5 m/s.
    fn noted(watch: &mut GnssWatch, from_s: i64, accepted: impl Iterator<Item = bool>) -> i64 {
        let mut next_s = from_s;
        for is_accepted in accepted {
            let place = Vector3::x() * (1.5 * next_s as f64);
            watch.note(next_s * 1_000_000_000, is_accepted, &place, if is_accepted { 0.3 } else { 6.0 });
            next_s += 1;
        }
        next_s
    }

    #[test]
    fn some_jumps_are_no_fault_and_ten_seconds_are() {
        let mut watch = GnssWatch::default();
        let now = noted(&mut watch, 0, (0..60).map(|k| k % 3 != 0));
        assert!(watch.is_trusted());
        let now = noted(&mut watch, now, (0..11).map(|_| false));
        assert!(!watch.is_trusted());
        assert!(matches!(watch.fault(), Some(GnssFault::Contradiction { metres: 6.0, .. })));
        let now = noted(&mut watch, now, (0..4).map(|_| true));
        assert!(!watch.is_trusted(), "most of ten seconds");
        noted(&mut watch, now, (0..8).map(|_| true));
        assert!(watch.is_trusted() && watch.fault().is_none());
    }

    #[test]
    fn positions_that_do_not_follow_odometry_are_a_fault_after_some_way() {
        let mut watch = GnssWatch::default();
        watch.note_unaligned(30_000_000_000, [2.0, 2000.0]);
        watch.note_unaligned(10_000_000_000, [20.0, 20_000.0]);
        assert_eq!(watch.fault(), None);
        watch.note_unaligned(30_000_000_000, [20.0, 20_000.0]);
        assert!(watch.fault().unwrap().to_string().contains("20.0 m, theirs is 20000.0 m"));
        assert!(watch.is_trusted(), "there is nothing yet to use them for");
        watch.clear();
        assert_eq!(watch.fault(), None);
        watch.note_unaligned(30_000_000_000, [20.0, 20_000.0]);
        watch.note(31_000_000_000, true, &Vector3::zeros(), 0.3);
        assert_eq!(watch.fault(), None, "the map initialized the pose, and positions agree with it");
    }

    #[test]
    fn times_far_from_the_images_are_a_fault_until_one_is_near() {
        let mut watch = GnssWatch::default();
        for _ in 0..19 {
            watch.note_apart(-3_600_000_000_000);
        }
        assert_eq!(watch.fault(), None);
        watch.note_apart(-3_600_000_000_000);
        assert!(watch.fault().unwrap().to_string().contains("3600 s behind the images"));
        watch.note_apart(i64::MIN);
        watch.note_apart(40_000_000);
        assert_eq!(watch.fault(), None);
    }

    #[test]
    fn only_a_long_contradiction_on_a_long_way_may_be_right() {
        let mut watch = GnssWatch::default();
        let now = noted(&mut watch, 0, (0..30).map(|_| true));
        let now = noted(&mut watch, now, (0..50).map(|_| false));
        assert_eq!(watch.long_since_ns(), None);
        noted(&mut watch, now, (0..30).map(|_| false));
        assert!(watch.long_since_ns().is_some_and(|since_ns| since_ns >= 25_000_000_000));
        let mut standing = GnssWatch::default();
        for second in 0..200 {
            standing.note(second * 1_000_000_000, false, &Vector3::zeros(), 6.0);
        }
        assert!(!standing.is_trusted() && standing.long_since_ns().is_none());
    }
}
