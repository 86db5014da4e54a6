//! The probability that a landmark is there: a Bayes filter of two states.
//!
//! A landmark is there or gone, and changes its state at random, with rates whose sum `κ` is that of the half-life `T` and whose ratio
//! is that of the stationary distribution `π`:
//! ```text
//! p(t + Δ) = π + (p(t) - π) exp(-κ Δ),    κ = ln 2 / T
//! ```
//! A session that expected it multiplies the odds by the ratio of the likelihoods of what it saw, once a [drive](crate::drive).
//!
//! A session that is handed in after a later one has counted is evidence of a time before the one for which the odds are stated. What it shows
//! at `t` counts by how likely the landmark was there at `t`, between its last sighting at `s` and the time `e` of the odds, where it is there or
//! gone at `e`:
//! ```text
//! there: same(t - s) same(e - t) / same(e - s),    gone: same(t - s) (1 - same(e - t)) / (1 - same(e - s)),    same(Δ) = (1 + exp(-κ Δ)) / 2
//! ```
//!
//! Source: the two-state case of the forward recursion, Rabiner, "A tutorial on hidden Markov models", Proc. IEEE 1989, III.A; the filter
//! of persistence of features is due to Rosen, Mason & Leonard, ICRA 2016.

/// Probability that a landmark of which nothing is known any more is there: neither.
const STATIONARY: f64 = 0.5;
/// Log-odds stay within these: 1 in 10^6.
const MAX_LOG_ODDS: f64 = 13.8;

/// How the existence of landmarks changes by itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExistenceModel {
    half_life_ns: f64,
}

impl ExistenceModel {
    /// # Arguments
    /// * `half_life_ns`: time in which a probability comes half the way to that of a landmark of which nothing is known (ns).
    pub fn new(half_life_ns: f64) -> ExistenceModel {
        ExistenceModel { half_life_ns }
    }

    /// The log-odds after some time without a session that passed.
    ///
    /// # Arguments
    /// * `elapsed_ns`: negative ones, of sessions that were handed in late, count as none.
    ///
    /// # Example
    /// ```
    /// use maintenance::{ExistenceModel, log_odds, probability};
    /// let model = ExistenceModel::new(1e9);
    /// let after = probability(model.predicted(log_odds(0.9), 1_000_000_000));
    /// assert!((after - 0.7).abs() < 1e-12);
    /// ```
    pub fn predicted(&self, before: f64, elapsed_ns: i64) -> f64 {
        let kept = (-(elapsed_ns.max(0) as f64) / self.half_life_ns).exp2();
        log_odds(STATIONARY + (probability(before) - STATIONARY) * kept)
    }

    /// How likely a landmark was there before the time of its odds, by whether it is there at that time.
    ///
    /// # Arguments
    /// * `times_ns`: when it was seen last, the time before, and that of the odds, after it.
    pub(crate) fn in_between(self, [seen_ns, then_ns, stated_ns]: [i64; 3]) -> ThereThen {
        let other = |elapsed_ns: i64| {
            -(-std::f64::consts::LN_2 * elapsed_ns as f64 / self.half_life_ns).exp_m1() * (1.0 - STATIONARY)
        };
        let (before, after) = (then_ns.saturating_sub(seen_ns), stated_ns.saturating_sub(then_ns));
        let all = other(stated_ns.saturating_sub(seen_ns));
        let was_there = 1.0 - other(before);
        ThereThen {
            if_there: was_there * (1.0 - other(after)) / (1.0 - all),
            if_gone: was_there * other(after) / all,
        }
    }
}

/// How likely a landmark was there at a time before that of its odds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ThereThen {
    /// Where it is there at the time of the odds, and ...
    pub(crate) if_there: f64,
    /// ... where it is gone then.
    pub(crate) if_gone: f64,
}

impl ThereThen {
    /// The log-odds that it was there.
    pub(crate) fn log_odds(&self, stated: f64) -> f64 {
        let there = probability(stated);
        log_odds(there * self.if_there + (1.0 - there) * self.if_gone)
    }

    /// The log-odds, for the later time, after a session of the earlier one that expected the landmark; as of [`updated`].
    pub(crate) fn updated(&self, stated: f64, seen: bool, detection: f64, false_sighting: f64) -> f64 {
        let shown = |rate: f64| if seen { rate } else { 1.0 - rate };
        let likelihood = |there: f64| there * shown(detection) + (1.0 - there) * shown(false_sighting);
        let ratio = likelihood(self.if_there) / likelihood(self.if_gone);
        (stated + ratio.ln()).clamp(-MAX_LOG_ODDS, MAX_LOG_ODDS)
    }
}

/// The log-odds after a session that expected the landmark.
///
/// # Arguments
/// * `detection`: probability that such a session sees it where it is there.
/// * `false_sighting`: the same where it is gone.
pub(crate) fn updated(before: f64, seen: bool, detection: f64, false_sighting: f64) -> f64 {
    let ratio = if seen { detection / false_sighting } else { (1.0 - detection) / (1.0 - false_sighting) };
    (before + ratio.ln()).clamp(-MAX_LOG_ODDS, MAX_LOG_ODDS)
}

/// The probability of log-odds.
pub fn probability(log_odds: f64) -> f64 {
    (1.0 + (-log_odds).exp()).recip()
}

/// The natural logarithm of the odds of a probability, within 1 in 10^6.
pub fn log_odds(probability: f64) -> f64 {
    (probability.ln() - (-probability).ln_1p()).clamp(-MAX_LOG_ODDS, MAX_LOG_ODDS)
}

#[cfg(test)]
mod tests {
    use super::*;

    const DAY_NS: i64 = 86_400_000_000_000;
    const RATES: [f64; 2] = [0.7, 0.03];

    /// The odds after evidence in the order of time, of a landmark that was there on day 0.
    fn in_order(model: ExistenceModel, shown: &[(i64, bool)]) -> f64 {
        let mut state = (MAX_LOG_ODDS, 0);
        for &(day, seen) in shown {
            let before = model.predicted(state.0, (day - state.1) * DAY_NS);
            state = (updated(before, seen, RATES[0], RATES[1]), day);
        }
        state.0
    }

    #[test]
    fn what_comes_late_counts_as_if_it_had_come_in_time() {
        let model = ExistenceModel::new(90.0 * DAY_NS as f64);
        for (late, last) in [(3, 10), (9, 10), (20, 200), (190, 200)] {
            for [seen_late, seen_last] in [[true, false], [false, false]] {
                let exact = in_order(model, &[(late, seen_late), (last, seen_last)]);
                let before = in_order(model, &[(last, seen_last)]);
                let then = model.in_between([0, late * DAY_NS, last * DAY_NS]);
                let found = then.updated(before, seen_late, RATES[0], RATES[1]);
                assert!((found - exact).abs() < 1e-3, "{late} {last} {seen_late}: {found}, {exact}");
            }
        }
    }

    #[test]
    fn an_old_sighting_brings_back_less_than_a_new_one() {
        let model = ExistenceModel::new(90.0 * DAY_NS as f64);
        let gone = log_odds(0.08);
        let day = |day: i64| model.in_between([0, day * DAY_NS, 40 * DAY_NS]).updated(gone, true, 0.7, 0.03);
        let new = updated(gone, true, 0.7, 0.03);
        // Right after the last sighting it says nothing, right before the last miss it says all.
        assert!((day(0) - gone).abs() < 1e-9 && (new - day(40)).abs() < 1e-9);
        assert!((1..=40).all(|at| day(at) > day(at - 1)));
        assert!(probability(day(20)) < 0.2 && probability(new) > 0.6, "{}", probability(day(20)));
    }
}
