//! Correlation of two series of rates, and what it is worth.

use super::gyroscope_angles::GyroscopeAngles;
use super::image_rates::ImageRate;
use nalgebra::Vector3;

/// Intervals between images that a correlation is taken from at least.
const MIN_INTERVALS: usize = 40;

/// Rates of the images and of the gyroscope in the same intervals, each less its mean, rad/s.
///
/// Without the means the gyroscope's bias has no influence.
pub(super) struct RatePairs {
    images: Vec<Vector3<f64>>,
    gyroscope: Vec<Vector3<f64>>,
}

impl RatePairs {
    /// The pairs at a lag.
    ///
    /// # Arguments
    /// * `lag_ns`: added to the times of the images to obtain the gyroscope's.
    ///
    /// # Returns
    /// `None` where the gyroscope covers less than half of the intervals.
    pub(super) fn at(rates: &[ImageRate], gyroscope: &GyroscopeAngles, lag_ns: i64) -> Option<Self> {
        let both = rates.iter().filter_map(|image| {
            Some((image.rate, gyroscope.mean_rate(image.from_ns + lag_ns, image.to_ns + lag_ns)?))
        });
        let (images, gyroscope): (Vec<_>, Vec<_>) = both.unzip();
        let is_enough = images.len() >= MIN_INTERVALS.max(rates.len() / 2);
        is_enough.then(|| Self { images: centred(images), gyroscope: centred(gyroscope) })
    }

    /// Number of intervals.
    pub(super) fn len(&self) -> usize {
        self.images.len()
    }

    /// RMS of the gyroscope's rate about its mean, rad/s.
    pub(super) fn rms(&self) -> f64 {
        (square(&self.gyroscope) / self.len() as f64).sqrt()
    }

    /// Correlation of all components together, -1 to 1; 0 where a series is constant.
    pub(super) fn correlation(&self) -> f64 {
        let product: f64 = self.images.iter().zip(&self.gyroscope).map(|(a, b)| a.dot(b)).sum();
        let scale = (square(&self.images) * square(&self.gyroscope)).sqrt();
        if scale > 0.0 { product / scale } else { 0.0 }
    }

    /// Standard deviation of the correlation of unrelated series that have the autocorrelations of these, as if they turned
    /// about one axis.
    ///
    /// Source: Bartlett, "On the theoretical specification and sampling properties of autocorrelated time-series", 1946.
    pub(super) fn noise_correlation(&self) -> f64 {
        let product = |step| autocorrelation(&self.images, step) * autocorrelation(&self.gyroscope, step);
        let sum: f64 = (1..self.len() / 4).map(product).sum();
        ((1.0 + 2.0 * sum).max(1.0) / self.len() as f64).sqrt()
    }

    /// How many residuals in a row are worth one: 1 for white ones.
    ///
    /// The sum of the autocorrelations up to the first that is not positive (Geyer, "Practical Markov chain Monte Carlo", 1992).
    pub(super) fn dependence_of_residuals(&self) -> f64 {
        let gain = self.correlation() * (square(&self.images) / square(&self.gyroscope)).sqrt();
        let residuals: Vec<Vector3<f64>> =
            self.images.iter().zip(&self.gyroscope).map(|(image, rate)| image - rate * gain).collect();
        let steps = (1..residuals.len() / 4).map(|step| autocorrelation(&residuals, step));
        1.0 + 2.0 * steps.take_while(|value| *value > 0.0).sum::<f64>()
    }
}

fn centred(mut series: Vec<Vector3<f64>>) -> Vec<Vector3<f64>> {
    let mean = series.iter().sum::<Vector3<f64>>() / series.len() as f64;
    for value in &mut series {
        *value -= mean;
    }
    series
}

fn square(series: &[Vector3<f64>]) -> f64 {
    series.iter().map(Vector3::norm_squared).sum()
}

fn autocorrelation(series: &[Vector3<f64>], step: usize) -> f64 {
    let product: f64 = series.iter().zip(&series[step..]).map(|(a, b)| a.dot(b)).sum();
    let scale = square(series);
    if scale > 0.0 { product / scale } else { 0.0 }
}
