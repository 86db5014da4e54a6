//! Robust losses of pixels.

use geometry::robust::huber;

/// Cauchy's loss counts residuals beyond this (standard deviations) as if they were of it, as for landmarks that are not visible.
const MAX_SIGMAS: f64 = 1e6;
/// Huber's loss counts landmarks that are not visible as a gross outlier: a residual of so many standard deviations.
const UNSEEN_SIGMAS: f64 = 10.0;

/// A robust loss, whose scale says how many standard deviations a residual may have.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Loss {
    /// Cauchy's: what is far beyond the scale hardly counts. For bundles with gross outliers and a scale that decreases.
    Cauchy,
    /// Huber's: linear beyond the scale. With an infinite scale, least squares.
    Huber,
}

impl Loss {
    /// Loss of a residual.
    ///
    /// # Arguments
    /// * `sigmas`: its length in standard deviations; infinite where the landmark is not visible.
    pub fn cost(self, sigmas: f64, scale: f64) -> f64 {
        match self {
            Loss::Cauchy => 0.5 * scale * scale * (sigmas.min(MAX_SIGMAS) / scale).powi(2).ln_1p(),
            Loss::Huber => huber(if sigmas.is_finite() { sigmas } else { UNSEEN_SIGMAS }, scale).1,
        }
    }

    /// One over the weight of a residual in iteratively reweighted least squares: 1 for short ones.
    pub fn attenuation(self, sigmas: f64, scale: f64) -> f64 {
        match self {
            Loss::Cauchy => 1.0 + (sigmas / scale).powi(2),
            Loss::Huber => huber(sigmas, scale).0.recip(),
        }
    }
}
