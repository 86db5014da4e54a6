//! Acceptance tests of a dynamic initialization.

use super::bundle_adjustment::Adjusted;
use super::error::DynamicInitError;

/// Maximum standard deviation of the scale, as a fraction.
const MAX_SCALE_SIGMA: f64 = 0.04;
/// Maximum reduced chi-square. A front end whose pixels are twice as accurate as configured has 0.25; wrong extrinsics,
/// wrong time stamps or a wrong minimum have tens.
const MAX_CHI_SQUARE: f64 = 2.0;
/// Maximum fraction of outlying observations. Real tracks have 0.01.
const MAX_OUTLIERS: f64 = 0.15;
/// Maximum fraction of landmarks behind the camera.
const MAX_BEHIND: f64 = 0.1;
/// Inverse depth below which a landmark is behind the camera, 1/m: significantly negative.
const BEHIND_INVERSE_DEPTH: f64 = -0.05;

/// Quality of a dynamic initialization.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InitQuality {
    /// Standard deviation of the scale of the trajectory, as a fraction.
    pub sigma_scale: f64,
    /// Reduced chi-square, 1 is expected.
    pub chi_square: f64,
    /// Fraction of outlying observations.
    pub outliers: f64,
    /// Number of landmarks.
    pub landmarks: usize,
}

impl InitQuality {
    /// Tests an adjusted window.
    ///
    /// # Errors
    /// [`DynamicInitError::Contradiction`], [`DynamicInitError::ScaleUnknown`].
    pub fn new(adjusted: &Adjusted) -> Result<Self, DynamicInitError> {
        let quality = Self {
            sigma_scale: adjusted.sigma_scale,
            chi_square: adjusted.reduced_chi_square,
            outliers: adjusted.outliers,
            landmarks: adjusted.bundle.landmarks.len(),
        };
        let behind = adjusted
            .bundle
            .landmarks
            .iter()
            .filter(|landmark| landmark.inverse_depth < BEHIND_INVERSE_DEPTH)
            .count();
        let fits = quality.chi_square <= MAX_CHI_SQUARE
            && quality.outliers <= MAX_OUTLIERS
            && behind as f64 <= MAX_BEHIND * quality.landmarks as f64;
        if !fits {
            return Err(DynamicInitError::Contradiction {
                chi_square: quality.chi_square,
                outliers: 100.0 * quality.outliers,
            });
        }
        let scale_is_known = quality.sigma_scale <= MAX_SCALE_SIGMA;
        if !scale_is_known {
            let percent = 100.0 * quality.sigma_scale;
            return Err(DynamicInitError::ScaleUnknown { percent, limit: 100.0 * MAX_SCALE_SIGMA });
        }
        Ok(quality)
    }
}
