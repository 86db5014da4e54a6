//! Errors of the dynamic initialization.

/// Why the dynamic initialization failed. Further images may make it succeed.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DynamicInitError {
    /// The window is too short.
    #[error("{have} images, {need} are needed")]
    TooFewImages {
        /// Images in the window.
        have: usize,
        /// Images needed.
        need: usize,
    },
    /// The IMU samples do not cover the window.
    #[error("IMU samples are missing between the images")]
    NoImu,
    /// The images share too few features.
    #[error("{have} features could be tracked, {need} are needed: more light or more texture")]
    TooFewTracks {
        /// Tracks in the window.
        have: usize,
        /// Tracks needed.
        need: usize,
    },
    /// The tracks have no parallax.
    #[error("the tracks have no parallax: translate the camera, do not only rotate it")]
    NoParallax,
    /// No motion fits tracks and IMU samples together.
    #[error(
        "tracks and IMU contradict each other (reduced chi-square {chi_square:.1}, {outliers:.0} % outliers): check \
         extrinsics, time stamps and noise"
    )]
    Contradiction {
        /// Reduced chi-square, 1 is expected.
        chi_square: f64,
        /// Outlying observations, percent.
        outliers: f64,
    },
    /// The scale is too uncertain.
    #[error("scale sigma {percent:.1} % exceeds {limit:.1} %: change the speed or the direction")]
    ScaleUnknown {
        /// Standard deviation of the scale, percent.
        percent: f64,
        /// The largest that is accepted, percent.
        limit: f64,
    },
}
