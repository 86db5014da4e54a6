//! A factor on a variance, adapted by ratios of innovations to their expectation.

/// Largest ratio that counts: larger ones are outliers.
const MAX_RATIO: f64 = 4.0;
/// Number of ratios over which the gain decreases by half.
const HALF_LIFE: f64 = 100.0;
/// Largest factor: sensors that are a hundred times worse than stated are not understood.
const MAX_FACTOR: f64 = 1e4;

/// Distance from a bound (logarithm of the variance) that counts as at it.
const NEAR_BOUND: f64 = 0.05;
/// Mean ratio below which a factor at its lower bound is held up by it.
const HELD_RATIO: f64 = 0.8;

/// How a factor is adapted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Adaptation {
    /// Factor at the start.
    pub(super) start: f64,
    /// Smallest factor.
    pub(super) floor: f64,
    /// Gain of the first ratio.
    pub(super) first_gain: f64,
    /// Gain after many.
    pub(super) last_gain: f64,
}

/// A factor on a stated variance.
#[derive(Clone, Debug)]
pub(super) struct VarianceFactor {
    adaptation: Option<Adaptation>,
    log: f64,
    /// Logarithm of a further lower bound.
    held_above: f64,
    samples: f64,
    /// Mean of the newest ratios.
    mean_ratio: f64,
}

impl VarianceFactor {
    /// At the start of its adaptation.
    pub(super) fn new(adaptation: Adaptation) -> Self {
        Self { adaptation: Some(adaptation), log: adaptation.start.ln(), ..Self::fixed() }
    }

    /// From a factor that was learned before.
    pub(super) fn resumed(adaptation: Adaptation, factor: f64) -> Self {
        let log = factor.clamp(adaptation.floor, MAX_FACTOR).ln();
        Self { adaptation: Some(adaptation), log, samples: HALF_LIFE, ..Self::fixed() }
    }

    /// One, never adapted.
    pub(super) fn fixed() -> Self {
        Self { adaptation: None, log: 0.0, held_above: f64::NEG_INFINITY, samples: 0.0, mean_ratio: 1.0 }
    }

    /// Factor on the standard deviation.
    pub(super) fn sigma_factor(&self) -> f64 {
        (0.5 * self.log).exp()
    }

    /// Takes a squared innovation in units of its expectation at the factor of now. One that is not finite is left out.
    pub(super) fn update(&mut self, ratio: f64) {
        let Some(adaptation) = self.adaptation.filter(|_| ratio.is_finite()) else { return };
        self.samples += 1.0;
        let gain = (adaptation.first_gain * HALF_LIFE / (HALF_LIFE + self.samples)).max(adaptation.last_gain);
        let ratio = ratio.clamp(0.0, MAX_RATIO);
        self.mean_ratio += gain * (ratio - self.mean_ratio);
        self.set(self.log + gain * (ratio - 1.0));
    }

    /// Keeps the factor at least at a value that is known otherwise, from now on until another one is.
    pub(super) fn hold_above(&mut self, factor: f64) {
        if self.adaptation.is_some() && !factor.is_nan() {
            self.held_above = factor.ln();
            self.set(self.log);
        }
    }

    /// Whether the innovations would move the factor below its lower bound.
    pub(super) fn is_held_up(&self) -> bool {
        let [least, _] = self.bounds();
        self.adaptation.is_some() && self.log < least + NEAR_BOUND && self.mean_ratio < HELD_RATIO
    }

    /// Takes a measurement of the factor itself, which is averaged with those before.
    pub(super) fn average(&mut self, factor: f64) {
        let Some(adaptation) = self.adaptation.filter(|_| factor.is_finite() && factor > 0.0) else { return };
        self.samples += 1.0;
        let gain = (adaptation.first_gain / self.samples).max(adaptation.last_gain);
        self.set(self.log + gain * (factor.ln() - self.log));
    }

    fn set(&mut self, log: f64) {
        let [least, most] = self.bounds();
        self.log = log.clamp(least, most);
    }

    /// Logarithms of the smallest and the largest factor.
    fn bounds(&self) -> [f64; 2] {
        let floor = self.adaptation.map_or(1.0, |adaptation| adaptation.floor);
        let most = MAX_FACTOR.ln();
        [floor.ln().max(self.held_above).min(most), most]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{SeedableRng, rngs::StdRng};
    use rand_distr::{ChiSquared, Distribution as _};

    const ADAPTATION: Adaptation = Adaptation { start: 1.0, floor: 0.1, first_gain: 0.1, last_gain: 0.01 };

    /// The factor after many innovations with `rows` degrees of freedom and the variance `truth`.
    fn learned(truth: f64, rows: f64, outliers: usize) -> f64 {
        let mut rng = StdRng::seed_from_u64(7);
        let chi_squared = ChiSquared::new(rows).unwrap();
        let mut factor = VarianceFactor::new(ADAPTATION);
        for k in 0..4000 {
            let ratio = truth * chi_squared.sample(&mut rng) / rows / factor.sigma_factor().powi(2);
            let is_outlier = outliers > 0 && k % outliers == 0;
            factor.update(if is_outlier { 1e3 } else { ratio });
        }
        factor.sigma_factor().powi(2)
    }

    #[test]
    fn the_true_variance_is_learned() {
        for truth in [0.25, 1.0, 9.0, 100.0] {
            for rows in [3.0, 40.0] {
                let found = learned(truth, rows, 0);
                assert!((found / truth).ln().abs() < 0.25, "{found} for {truth} with {rows} rows");
            }
        }
    }

    #[test]
    fn outliers_have_a_bounded_influence() {
        let found = learned(1.0, 40.0, 20);
        assert!(found > 1.0 && found < 1.4, "one in twenty: {found}");
    }

    #[test]
    fn bounds_hold_and_nothing_moves_a_fixed_factor() {
        assert!((learned(1e-6, 40.0, 0) - ADAPTATION.floor).abs() < 1e-12);
        let mut factor = VarianceFactor::new(ADAPTATION);
        factor.update(f64::NAN);
        factor.average(f64::INFINITY);
        assert!((factor.sigma_factor() - 1.0).abs() < 1e-15);
        let mut fixed = VarianceFactor::fixed();
        fixed.update(4.0);
        fixed.average(9.0);
        assert!((fixed.sigma_factor() - 1.0).abs() < 1e-15);
        fixed.hold_above(4.0);
        assert_eq!((fixed.sigma_factor(), fixed.is_held_up()), (1.0, false));
        let mut averaged = VarianceFactor::new(Adaptation { first_gain: 1.0, ..ADAPTATION });
        averaged.average(4.0);
        assert!((averaged.sigma_factor() - 2.0).abs() < 1e-12, "the first measurement replaces the start");
    }
    #[test]
    fn a_factor_is_held_above_what_is_known_and_says_so_where_the_innovations_are_smaller() {
        let mut factor = VarianceFactor::new(ADAPTATION);
        let learn = |factor: &mut VarianceFactor, truth: f64| {
            (0..2000).for_each(|_| factor.update(truth / factor.sigma_factor().powi(2)));
        };
        factor.hold_above(9.0);
        learn(&mut factor, 4.0);
        assert!((factor.sigma_factor() - 3.0).abs() < 1e-12 && factor.is_held_up());
        learn(&mut factor, 16.0);
        assert!((factor.sigma_factor() - 4.0).abs() < 0.01 && !factor.is_held_up());
        learn(&mut factor, 9.0);
        assert!(
            (factor.sigma_factor() - 3.0).abs() < 0.01 && !factor.is_held_up(),
            "as large as it is known to be"
        );
        factor.hold_above(1.0);
        learn(&mut factor, 4.0);
        assert!((factor.sigma_factor() - 2.0).abs() < 0.01 && !factor.is_held_up());
    }
}
