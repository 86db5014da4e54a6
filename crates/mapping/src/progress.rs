//! Progress of map building.

/// A stage of map building that can take long.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Stage {
    /// Running odometry over the recording, before [`crate::build_map_from_odometry`].
    Odometry,
    /// Selecting keyframes and extracting their features.
    KeyframeSelection,
    /// Extracting features of a further kind in images that a map keeps.
    Extraction,
    /// Finding places that are seen again.
    PlaceRecognition,
    /// Matching pairs of keyframes.
    Matching,
    /// Triangulating the landmarks, one by one.
    Triangulation,
    /// Refining all landmarks and poses together.
    BundleAdjustment,
    /// Computing the joint covariance of the poses.
    Covariance,
    /// Finding places that look alike.
    Aliasing,
}

impl Stage {
    /// Its name in a progress bar.
    pub fn label(self) -> &'static str {
        match self {
            Self::Odometry => "odometry",
            Self::KeyframeSelection => "keyframes",
            Self::Extraction => "extraction",
            Self::PlaceRecognition => "places",
            Self::Matching => "matching",
            Self::Triangulation => "triangulation",
            Self::BundleAdjustment => "bundle adjustment",
            Self::Covariance => "covariance",
            Self::Aliasing => "aliasing",
        }
    }
}

/// Callback with a stage, its steps done, and its steps in all.
pub type Progress<'a> = &'a mut dyn FnMut(Stage, usize, usize);
