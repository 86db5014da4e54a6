//! The distortion models by their names and lists of coefficients, as files have them.

use super::distortion::Distortion;

impl Distortion {
    /// The name of the model in calibrations: Kalibr's or EuRoC's; `thin-prism-fisheye` is COLMAP's.
    ///
    /// [`Self::Rational`] is `radial-tangential` with more coefficients than four.
    pub fn name(&self) -> &'static str {
        match self {
            Self::None => "none",
            Self::RadialTangential(_) | Self::Rational(_) => "radial-tangential",
            Self::Equidistant(_) => "equidistant",
            Self::Fov(_) => "fov",
            Self::ThinPrismFisheye(_) => "thin-prism-fisheye",
            Self::DoubleSphere { .. } => "ds",
            Self::Eucm { .. } => "eucm",
            Self::Omni { .. } => "omni",
        }
    }

    /// The coefficients in the order of the model.
    ///
    /// Of [`Self::Rational`] the first 5, 8 or 12, as many as are not zero.
    ///
    /// ```
    /// use geometry::Distortion;
    /// assert_eq!(Distortion::DoubleSphere { xi: -0.2, alpha: 0.6 }.coefficients(), [-0.2, 0.6]);
    /// let mut k = [0.0; 12];
    /// k[4] = 0.01;
    /// assert_eq!(Distortion::Rational(k).coefficients(), [0.0, 0.0, 0.0, 0.0, 0.01]);
    /// ```
    pub fn coefficients(&self) -> Vec<f64> {
        match *self {
            Self::None => Vec::new(),
            Self::RadialTangential(k) | Self::Equidistant(k) => k.to_vec(),
            Self::Fov(omega) => vec![omega],
            Self::Rational(k) => {
                let count = [5, 8].into_iter().find(|&count| k[count..].iter().all(|value| *value == 0.0));
                k[..count.unwrap_or(k.len())].to_vec()
            }
            Self::ThinPrismFisheye(k) => k.to_vec(),
            Self::DoubleSphere { xi, alpha } => vec![xi, alpha],
            Self::Eucm { alpha, beta } => vec![alpha, beta],
            Self::Omni { xi, distortion: [k1, k2, p1, p2] } => vec![xi, k1, k2, p1, p2],
        }
    }

    /// The simplest model of OpenCV with 4, 5, 8 or 12 coefficients in its order; `None` for another number.
    ///
    /// Where all beyond the first four are zero it is [`Self::RadialTangential`], otherwise [`Self::Rational`].
    ///
    /// ```
    /// use geometry::Distortion;
    /// let plain = Distortion::from_opencv(&[-0.3, 0.1, 0.0, 0.0, 0.0]);
    /// assert_eq!(plain, Some(Distortion::RadialTangential([-0.3, 0.1, 0.0, 0.0])));
    /// assert!(matches!(Distortion::from_opencv(&[-0.3, 0.1, 0.0, 0.0, 0.02]), Some(Distortion::Rational(_))));
    /// assert_eq!(Distortion::from_opencv(&[-0.3, 0.1]), None);
    /// ```
    pub fn from_opencv(coefficients: &[f64]) -> Option<Self> {
        let &[k1, k2, p1, p2, ref rest @ ..] = coefficients else { return None };
        if !matches!(coefficients.len(), 4 | 5 | 8 | 12) {
            return None;
        }
        if rest.iter().all(|value| *value == 0.0) {
            return Some(Self::RadialTangential([k1, k2, p1, p2]));
        }
        let mut all = [0.0; 12];
        all[..coefficients.len()].copy_from_slice(coefficients);
        Some(Self::Rational(all))
    }
}
