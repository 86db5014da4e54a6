//! How likely a session sees a landmark that is there, learned from what it saw.

use crate::existence::probability;

/// Sessions are told apart by how many of their keyframes expected a landmark: 1, 2, 3, or more.
const CLASSES: usize = 4;
/// Landmarks that a class must have to be believed as much as all classes together.
const SHARED_LANDMARKS: f64 = 20.0;
/// Rates stay within these: one session is never sure, and one that sees next to nothing says next to nothing.
const LIMITS: [f64; 2] = [0.1, 0.9];
/// Rounds of expectation and maximization.
const ROUNDS: usize = 20;

/// What a session shows of a landmark that it expected.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Shown {
    /// How many of its keyframes expected it, at least 1.
    pub(crate) exposures: usize,
    /// Whether one of them saw it.
    pub(crate) seen: bool,
    /// Log-odds that it was there, before the session.
    pub(crate) log_odds: f64,
}

/// The probability that a session sees a landmark that is there, by how many of its keyframes expected it.
///
/// Keyframes of one session are not independent, so a session counts once, with the rate of sessions that came as close.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct DetectionRates([f64; CLASSES]);

impl DetectionRates {
    /// The rates that make what was seen most likely.
    ///
    /// Landmarks that are gone are not seen either. So each counts with the probability that it is there, given what was seen of it and the
    /// rates: expectation and maximization in turn.
    ///
    /// Source: Dempster, Laird & Rubin, "Maximum likelihood from incomplete data via the EM algorithm", JRSS B 1977.
    pub(crate) fn learned(shown: &[Shown], false_sighting: f64) -> DetectionRates {
        let pooled = maximized(&shown.iter(), [0.0, 0.0], false_sighting);
        let class = |class: usize| {
            let of_class = shown.iter().filter(move |shown| class_of(shown.exposures) == class);
            maximized(&of_class, [SHARED_LANDMARKS * pooled, SHARED_LANDMARKS], false_sighting)
        };
        DetectionRates(std::array::from_fn(class))
    }

    /// The rate of a landmark that so many keyframes of the session expected.
    pub fn of(&self, exposures: usize) -> f64 {
        self.0[class_of(exposures)]
    }
}

fn class_of(exposures: usize) -> usize {
    exposures.clamp(1, CLASSES) - 1
}

/// The rate of one class.
///
/// # Arguments
/// * `before`: seen and expected landmarks that are there in any case.
fn maximized<'a>(
    shown: &(impl Iterator<Item = &'a Shown> + Clone),
    before: [f64; 2],
    false_sighting: f64,
) -> f64 {
    let mut rate: f64 = 0.5;
    for _ in 0..ROUNDS {
        let [mut seen, mut expected] = before;
        for of in shown.clone() {
            let weight = probability(crate::existence::updated(of.log_odds, of.seen, rate, false_sighting));
            seen += weight * f64::from(u8::from(of.seen));
            expected += weight;
        }
        if expected <= 0.0 {
            break;
        }
        rate = (seen / expected).clamp(LIMITS[0], LIMITS[1]);
    }
    rate
}
