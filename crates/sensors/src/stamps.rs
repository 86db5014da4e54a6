//! Stamps of a recorded stream: single wrong ones are left out, what came out of order is sorted.
//!
//! The rule is that of live streams (`live::clock`), applied to a stream whose end is known: few messages that are far from
//! those before and after have wrong stamps; where many are, the clock has stepped. A step forward is a gap. From a step back on, stamps go
//! on as if there had been none.

/// A message that is older than the newest one by more than this is not merely out of order, nanoseconds.
pub(crate) const BACKWARD_NS: i64 = 300_000_000;
/// A step of a clock is believed after so many messages,
pub(crate) const CONFIRMING: usize = 3;
/// and after it has lasted for so long, nanoseconds.
pub(crate) const CONFIRMING_NS: i64 = 100_000_000;

/// So many messages with wrong stamps are named, the others counted.
const MAX_NAMED: usize = 3;
/// So many of the next messages tell which of two few are wrong.
const NEXT: usize = 5;
/// The first and the last messages of a stream have no others on one side. They are wrong if they are further away than
/// this where they were not recorded so much earlier or later, nanoseconds,
const END_GAP_NS: i64 = 5_000_000_000;
/// or, where it is not known when they were recorded, further than this: an hour.
const UNKNOWN_END_GAP_NS: i64 = 3_600_000_000_000;
/// Steps of two streams are one step of their computer's clock if they differ by less, nanoseconds,
const SAME_STEP_NS: i64 = 100_000_000;
/// and were recorded within this, nanoseconds.
const SAME_STEP_WITHIN_NS: i64 = 5_000_000_000;

/// A message whose stamp is wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Outlier {
    /// Number of the message in the order of recording.
    pub(crate) index: usize,
    /// How far it is ahead of the messages around it; negative for one behind them, nanoseconds.
    pub(crate) ahead_ns: i64,
}

impl Outlier {
    /// How far it is from the others.
    pub(crate) fn describe(&self) -> String {
        let side = if self.ahead_ns > 0 { "ahead of" } else { "behind" };
        format!("{:.1} s {side} those around it", self.ahead_ns.unsigned_abs() as f64 * 1e-9)
    }
}

/// A step back of the stream's clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Step {
    /// When its first message was recorded, nanoseconds; 0 where that is not known.
    pub(crate) log_ns: i64,
    /// Added to the clock: negative, nanoseconds.
    pub(crate) by_ns: i64,
}

/// The messages of a stream in order of time.
#[derive(Debug, Default, PartialEq, Eq)]
pub(crate) struct StampOrder {
    /// Stamps, strictly increasing, and the numbers of their messages.
    pub(crate) sorted: Vec<(i64, usize)>,
    /// Messages that are left out because of their stamps.
    pub(crate) outliers: Vec<Outlier>,
    /// Steps back of the clock, which are taken out of the stamps.
    pub(crate) steps: Vec<Step>,
    /// Messages that were recorded after later ones.
    pub(crate) out_of_order: usize,
    /// Messages with a stamp that another one has; the first of them is used.
    pub(crate) doubled: usize,
}

/// Name of a stream in messages about its stamps.
pub(crate) struct Told<'a> {
    /// The stream.
    pub(crate) name: &'a str,
    /// One of its messages, by its number in the order of recording.
    pub(crate) which: &'a dyn Fn(usize) -> String,
    /// Several of them.
    pub(crate) all: &'a str,
}

impl StampOrder {
    /// Warns of what is left out, and of steps of the clock.
    ///
    /// # Arguments
    /// * `stamps`: in the order of recording.
    pub(crate) fn tell(&self, stamps: &[i64], Told { name, which, all }: &Told<'_>) {
        for outlier in self.outliers.iter().take(MAX_NAMED) {
            let (message, stamp_ns) = (which(outlier.index), stamps[outlier.index]);
            tracing::warn!(
                "{name}: the stamp of {message}, {stamp_ns} ns, is {}; it is left out",
                outlier.describe()
            );
        }
        if let Some(more) = self.outliers.len().checked_sub(MAX_NAMED).filter(|more| *more > 0) {
            tracing::warn!("{name}: {more} more {all} with stamps like these are left out");
        }
        for step in &self.steps {
            tracing::warn!(
                "{name}: the clock went back by {:.3} s; from there on stamps go on without the step",
                -step.by_ns as f64 * 1e-9
            );
        }
        if self.doubled > 0 {
            tracing::warn!(
                "{name}: {} {all} have the stamp of another one, the first of which is used",
                self.doubled
            );
        }
    }

    /// What was out of order, in words.
    ///
    /// # Arguments
    /// * `count`: of all messages.
    /// * `all`: their name.
    pub(crate) fn describe_order(&self, count: usize, all: &str) -> String {
        format!(
            "{} of {count} {all} came after later ones, and are sorted by their stamps",
            self.out_of_order
        )
    }
}

/// Puts the messages of a stream in order.
///
/// # Arguments
/// * `stamps`: in the order of recording, nanoseconds.
/// * `logs`: when they were recorded, nanoseconds; empty where that is not known. They may be useless.
/// * `known_steps`: of another stream of the same computer, whose values are preferred.
pub(crate) fn order(stamps: &[i64], logs: &[i64], known_steps: &[Step]) -> StampOrder {
    let mut check = Check { stamps, logs, outliers: Vec::new() };
    let epochs = check.epochs();
    let mut order = StampOrder::default();
    let mut stepped_ns = 0_i64;
    let mut newest: Option<(i64, usize)> = None;
    for epoch in epochs {
        let Some(&first) = epoch.first() else { continue };
        if let Some((newest_ns, last)) = newest {
            let step = check.step((newest_ns.saturating_add(stepped_ns), last), first, known_steps);
            stepped_ns = stepped_ns.saturating_add(step.by_ns);
            order.steps.push(step);
        }
        for index in epoch {
            let stamp_ns = stamps[index].saturating_sub(stepped_ns);
            match newest {
                Some((newest_ns, _)) if stamp_ns < newest_ns => order.out_of_order += 1,
                _ => newest = Some((stamp_ns, index)),
            }
            order.sorted.push((stamp_ns, index));
        }
    }
    // Stable, so that the first of two with the same stamp stays the first.
    order.sorted.sort_by_key(|(stamp_ns, _)| *stamp_ns);
    let all = order.sorted.len();
    order.sorted.dedup_by_key(|(stamp_ns, _)| *stamp_ns);
    order.doubled = all - order.sorted.len();
    order.outliers = check.outliers;
    order.outliers.sort_by_key(|outlier| outlier.index);
    order
}

/// Median interval of sorted stamps, nanoseconds; `None` where there is none.
#[cfg(feature = "bags")]
pub(crate) fn median_interval_ns(stamps: impl Iterator<Item = i64> + Clone) -> Option<i64> {
    let mut intervals: Vec<i64> =
        stamps.clone().zip(stamps.skip(1)).map(|(a, b)| b.saturating_sub(a)).collect();
    if intervals.is_empty() {
        return None;
    }
    let middle = intervals.len() / 2;
    Some(*intervals.select_nth_unstable(middle).1).filter(|&interval_ns| interval_ns > 0)
}

/// A stream while its stamps are looked through.
struct Check<'a> {
    stamps: &'a [i64],
    logs: &'a [i64],
    outliers: Vec<Outlier>,
}

impl Check<'_> {
    /// The messages with right stamps between the steps back of the clock, each epoch in the order of recording.
    fn epochs(&mut self) -> Vec<Vec<usize>> {
        let mut epochs = vec![Vec::new()];
        // Of the present epoch: its messages, and the newest stamp up to each of them.
        let (mut kept, mut newest): (Vec<usize>, Vec<i64>) = (Vec::new(), Vec::new());
        let mut index = 0;
        while let Some(&stamp_ns) = self.stamps.get(index) {
            let newest_ns = newest.last().copied().unwrap_or(stamp_ns);
            if stamp_ns >= newest_ns.saturating_sub(BACKWARD_NS) {
                kept.push(index);
                newest.push(newest_ns.max(stamp_ns));
                index += 1;
                continue;
            }
            // Either few before are ahead, or few from here on are behind, or the clock stepped back.
            let begin = newest.partition_point(|ns| *ns <= stamp_ns.saturating_add(BACKWARD_NS));
            let ahead =
                Run { messages: kept.len() - begin, lasted_ns: newest_ns.saturating_sub(newest[begin]) };
            let behind = self.behind(index, newest_ns);
            let is_ahead_wrong = !ahead.is_confirmed()
                && (behind.is_confirmed() || !self.is_behind_wrong(index, newest_ns, ahead, behind));
            if is_ahead_wrong {
                for wrong in kept.drain(begin..) {
                    let ahead_ns = self.stamps[wrong].saturating_sub(stamp_ns);
                    self.outliers.push(Outlier { index: wrong, ahead_ns });
                }
                newest.truncate(begin);
            } else if !behind.is_confirmed() {
                for wrong in index..index + behind.messages {
                    let ahead_ns = self.stamps[wrong].saturating_sub(newest_ns);
                    self.outliers.push(Outlier { index: wrong, ahead_ns });
                }
                index += behind.messages;
            } else {
                epochs.push(Vec::new());
                let at = epochs.len() - 2;
                epochs[at] = std::mem::take(&mut kept);
                newest.clear();
            }
        }
        if let Some(last) = epochs.last_mut() {
            *last = kept;
        }
        self.cut_ends(&mut epochs);
        epochs
    }

    /// The messages from `index` on that are behind, as many as it takes to believe that the clock stepped.
    fn behind(&self, index: usize, newest_ns: i64) -> Run {
        let is_behind = |ns: &&i64| **ns < newest_ns.saturating_sub(BACKWARD_NS);
        let mut run = Run { messages: 0, lasted_ns: 0 };
        let (mut low_ns, mut high_ns) = (i64::MAX, i64::MIN);
        for &ns in self.stamps[index..].iter().take_while(is_behind) {
            (low_ns, high_ns) = (low_ns.min(ns), high_ns.max(ns));
            run = Run { messages: run.messages + 1, lasted_ns: high_ns.saturating_sub(low_ns) };
            if run.is_confirmed() {
                break;
            }
        }
        run
    }

    /// Of few messages that are ahead of few others: whether those behind are wrong, as the next ones tell.
    fn is_behind_wrong(&self, index: usize, newest_ns: i64, ahead: Run, behind: Run) -> bool {
        let next = self.stamps[index + behind.messages..].iter().take(NEXT);
        let (mut for_ahead, mut for_behind) = (0, 0);
        for ns in next {
            let is_ahead = *ns >= newest_ns.saturating_sub(BACKWARD_NS);
            *if is_ahead { &mut for_ahead } else { &mut for_behind } += 1;
        }
        (for_ahead, ahead.messages) > (for_behind, behind.messages)
    }

    /// Leaves out the first and the last few messages of a stream where they are far from all others.
    fn cut_ends(&mut self, epochs: &mut [Vec<usize>]) {
        let (stamps, logs) = (self.stamps, self.logs);
        let of = |values: &[i64], index: usize| values.get(index).copied();
        let is_far = |a: usize, b: usize, logs_tell: bool| {
            let gap_ns = stamps[b].saturating_sub(stamps[a]);
            match of(logs, a).zip(of(logs, b)).filter(|_| logs_tell) {
                Some((from, to)) => gap_ns.saturating_sub(to.saturating_sub(from)) > END_GAP_NS,
                None => gap_ns > UNKNOWN_END_GAP_NS,
            }
        };
        let is_confirmed = |group: &[usize]| {
            let lasted_ns = match group {
                [first, .., last] => stamps[*last].saturating_sub(stamps[*first]),
                _ => 0,
            };
            Run { messages: group.len(), lasted_ns }.is_confirmed()
        };
        if let Some(first) = epochs.first_mut() {
            let tell = self.logs_tell(first);
            let cuts = 1..first.len().saturating_sub(CONFIRMING - 1);
            let cuts = cuts.take_while(|&at| !is_confirmed(&first[..at]));
            let cut = cuts.filter(|&at| is_far(first[at - 1], first[at], tell)).last();
            for wrong in first.drain(..cut.unwrap_or(0)).collect::<Vec<_>>() {
                let ahead_ns = stamps[wrong].saturating_sub(stamps[first[0]]);
                self.outliers.push(Outlier { index: wrong, ahead_ns });
            }
        }
        if let Some(last) = epochs.last_mut() {
            let tell = self.logs_tell(last);
            let cuts = (CONFIRMING..last.len()).rev().take_while(|&at| !is_confirmed(&last[at..]));
            let cut = cuts.filter(|&at| is_far(last[at - 1], last[at], tell)).last();
            let Some(at) = cut else { return };
            for wrong in last.drain(at..).collect::<Vec<_>>() {
                let ahead_ns = stamps[wrong].saturating_sub(stamps[last[at - 1]]);
                self.outliers.push(Outlier { index: wrong, ahead_ns });
            }
        }
    }

    /// Whether the times of recording run as the stamps do, the ends left aside: those of a converted recording do not.
    fn logs_tell(&self, epoch: &[usize]) -> bool {
        let Some(inner) = epoch.get(CONFIRMING - 1..epoch.len().saturating_sub(CONFIRMING - 1)) else {
            return false;
        };
        let (Some(&a), Some(&b)) = (inner.first(), inner.last()) else { return false };
        let Some((from, to)) = self.logs.get(a).zip(self.logs.get(b)) else { return false };
        let (logged, stamped) = (to.saturating_sub(*from), self.stamps[b].saturating_sub(self.stamps[a]));
        stamped > 0 && (logged.saturating_sub(stamped)).saturating_abs() < stamped / 2
    }

    /// The step of the clock between two messages: what its stamps show, less the time that passed.
    fn step(&self, (newest_ns, last): (i64, usize), first: usize, known: &[Step]) -> Step {
        let log = |index: usize| self.logs.get(index).copied().unwrap_or(0);
        let passed_ns = log(first).saturating_sub(log(last)).clamp(0, END_GAP_NS);
        let by_ns = self.stamps[first].saturating_sub(newest_ns).saturating_sub(passed_ns.max(1));
        let is_same = |step: &&Step| {
            step.by_ns.abs_diff(by_ns) < SAME_STEP_NS.unsigned_abs()
                && step.log_ns.abs_diff(log(first)) < SAME_STEP_WITHIN_NS.unsigned_abs()
        };
        let by_ns = known.iter().find(is_same).map_or(by_ns, |step| step.by_ns);
        Step { log_ns: log(first), by_ns }
    }
}

/// Messages in a row that are far from those on one side.
#[derive(Clone, Copy)]
struct Run {
    messages: usize,
    lasted_ns: i64,
}

impl Run {
    /// Whether they are no mistakes.
    fn is_confirmed(self) -> bool {
        self.messages >= CONFIRMING && self.lasted_ns >= CONFIRMING_NS
    }
}
