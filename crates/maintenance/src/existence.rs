//! The probability that a landmark is there: a Bayes filter of two states.
//!
//! A landmark is there or gone, and changes its state at random, with rates whose sum `κ` is that of the half-life `T` and whose ratio
//! is that of the stationary distribution `π`:
//! ```text
//! p(t + Δ) = π + (p(t) - π) exp(-κ Δ),    κ = ln 2 / T
//! ```
//! A session that expected it multiplies the odds by the ratio of the likelihoods of what it saw, once a [drive](crate::drive).
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
