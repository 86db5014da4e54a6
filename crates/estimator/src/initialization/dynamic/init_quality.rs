//! Whether an adjusted window can be believed.

use super::NotYet;
use super::adjustment::Adjusted;

/// Largest standard deviation of the way's length, as a part of it.
const SCALE_SIGMA: f64 = 0.04;
/// Largest sum of squares over its degrees of freedom. A front end whose pixels are twice as good as configured shows
/// 0.25; wrong extrinsics, time stamps or a wrong minimum show tens.
const CHI_SQUARE: f64 = 2.0;
/// Largest part of outlying sightings. Real tracks hold one in a hundred.
const OUTLIERS: f64 = 0.15;
/// Largest part of landmarks clearly behind the camera.
const BEHIND: f64 = 0.1;

/// Why a start was believed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InitQuality {
    /// Standard deviation of the length of the way through the window, as a part of it.
    pub sigma_scale: f64,
    /// Sum of squares over its degrees of freedom.
    pub chi_square: f64,
    /// Part of the sightings that were outliers.
    pub outliers: f64,
    /// Landmarks.
    pub landmarks: usize,
}

impl InitQuality {
    /// Judges an adjusted window.
    ///
    /// # Errors
    /// [`NotYet::Contradiction`], [`NotYet::ScaleUnknown`].
    pub fn new(adjusted: &Adjusted) -> Result<Self, NotYet> {
        let init_quality = Self {
            sigma_scale: adjusted.sigma_scale,
            chi_square: adjusted.reduced_chi_square,
            outliers: adjusted.outliers,
            landmarks: adjusted.estimate.landmarks.len(),
        };
        let behind =
            adjusted.estimate.landmarks.iter().filter(|entry| entry.landmark.inverse_depth < -0.05).count();
        let fits = init_quality.chi_square <= CHI_SQUARE
            && init_quality.outliers <= OUTLIERS
            && behind as f64 <= BEHIND * init_quality.landmarks as f64;
        if !fits {
            return Err(NotYet::Contradiction {
                chi_square: init_quality.chi_square,
                outliers: 100.0 * init_quality.outliers,
            });
        }
        let known = init_quality.sigma_scale <= SCALE_SIGMA;
        if !known {
            let percent = 100.0 * init_quality.sigma_scale;
            return Err(NotYet::ScaleUnknown { percent, need: 100.0 * SCALE_SIGMA });
        }
        Ok(init_quality)
    }
}
