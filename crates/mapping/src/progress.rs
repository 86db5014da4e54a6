//! Progress of map building.

/// A stage of map building that can take long.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Stage {
    /// Selecting keyframes and extracting their features.
    KeyframeSelection,
    /// Matching pairs of keyframes.
    Matching,
    /// Triangulating the landmarks, one by one.
    Triangulation,
    /// Refining all landmarks and poses together.
    BundleAdjustment,
    /// Computing the joint covariance of the poses.
    Covariance,
}

impl Stage {
    /// Its name in a progress bar.
    pub fn label(self) -> &'static str {
        match self {
            Self::KeyframeSelection => "keyframes",
            Self::Matching => "matching",
            Self::Triangulation => "triangulation",
            Self::BundleAdjustment => "bundle adjustment",
            Self::Covariance => "covariance",
        }
    }
}

/// Callback with a stage, its steps done, and its steps in all.
pub type Progress<'a> = &'a mut dyn FnMut(Stage, usize, usize);
