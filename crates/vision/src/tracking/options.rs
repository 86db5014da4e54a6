//! Settings of the tracker.

use super::lucas_kanade::AlignmentOptions;
use super::outliers::OutlierOptions;
use super::stereo::StereoOptions;
use crate::corners::CornerOptions;
use crate::equalization::Equalization;
use crate::image::GrayImage;

/// Settings of a [`super::Tracker`], to be changed one by one.
///
/// ```
/// use vision::Equalization;
/// use vision::tracking::TrackerOptions;
/// let options = TrackerOptions::default().points(150).equalization(Equalization::Global);
/// assert_eq!(options.points, 150);
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct TrackerOptions {
    /// How many points to keep in sight.
    pub points: usize,
    /// Which corners to take.
    pub corners: CornerOptions,
    /// How patches are found from image to image.
    pub alignment: AlignmentOptions,
    /// How they are found in the second camera.
    pub stereo: StereoOptions,
    /// Which tracks are thrown out.
    pub outliers: OutlierOptions,
    /// What is done to an image first.
    pub equalization: Equalization,
    /// Nothing is tracked where these are zero, one a camera; of the size of the camera's images.
    pub masks: [Option<GrayImage>; 2],
    /// Time between two images above which all tracks end, nanoseconds.
    pub max_gap_ns: i64,
}

impl Default for TrackerOptions {
    fn default() -> Self {
        Self {
            points: 200,
            corners: CornerOptions::default(),
            alignment: AlignmentOptions::default(),
            stereo: StereoOptions::default(),
            outliers: OutlierOptions::default(),
            equalization: Equalization::default(),
            masks: [None, None],
            max_gap_ns: 500_000_000,
        }
    }
}

impl TrackerOptions {
    /// How many points to keep in sight.
    pub fn points(mut self, points: usize) -> Self {
        self.points = points;
        self
    }

    /// What is done to an image first.
    pub fn equalization(mut self, equalization: Equalization) -> Self {
        self.equalization = equalization;
        self
    }

    /// Nothing is tracked where the mask of a camera (0 or 1) is zero.
    ///
    /// # Panics
    /// For a third camera.
    pub fn mask(mut self, camera: usize, mask: GrayImage) -> Self {
        self.masks[camera] = Some(mask);
        self
    }

    /// Time between two images above which all tracks end, nanoseconds.
    pub fn max_gap_ns(mut self, max_gap_ns: i64) -> Self {
        self.max_gap_ns = max_gap_ns;
        self
    }
}
