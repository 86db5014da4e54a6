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
pub struct Belief {
    /// Standard deviation of the length of the way through the window, as a part of it.
    pub scale_sigma: f64,
    /// Sum of squares over its degrees of freedom.
    pub chi_square: f64,
    /// Part of the sightings that were outliers.
    pub outliers: f64,
    /// Landmarks.
    pub landmarks: usize,
}

impl Belief {
    /// Judges an adjusted window.
    ///
    /// # Errors
    /// [`NotYet::Contradiction`], [`NotYet::ScaleUnknown`].
    pub fn new(adjusted: &Adjusted) -> Result<Self, NotYet> {
        let belief = Self {
            scale_sigma: adjusted.scale_sigma,
            chi_square: adjusted.reduced_chi_square,
            outliers: adjusted.outliers,
            landmarks: adjusted.estimate.landmarks.len(),
        };
        let behind =
            adjusted.estimate.landmarks.iter().filter(|entry| entry.landmark.inverse_depth < -0.05).count();
        let fits = belief.chi_square <= CHI_SQUARE
            && belief.outliers <= OUTLIERS
            && behind as f64 <= BEHIND * belief.landmarks as f64;
        if !fits {
            return Err(NotYet::Contradiction {
                chi_square: belief.chi_square,
                outliers: 100.0 * belief.outliers,
            });
        }
        let known = belief.scale_sigma <= SCALE_SIGMA;
        if !known {
            let percent = 100.0 * belief.scale_sigma;
            return Err(NotYet::ScaleUnknown { percent, need: 100.0 * SCALE_SIGMA });
        }
        Ok(belief)
    }
}
