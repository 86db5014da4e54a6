//! Settings of the tracker.

use super::lucas_kanade::AlignmentOptions;
use super::outliers::OutlierOptions;
use super::stereo::StereoOptions;
use crate::detection::CornerOptions;
use crate::image::Equalization;
use crate::image::GrayImage;

/// Settings of a [`super::Tracker`].
///
/// # Example
/// ```
/// use vision::Equalization;
/// use vision::tracking::TrackerOptions;
/// let options = TrackerOptions::default().points(150).equalization(Equalization::Global);
/// assert_eq!(options.points, 150);
/// ```
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct TrackerOptions {
    /// Number of points to track.
    pub points: usize,
    /// Corner detection.
    pub corners: CornerOptions,
    /// Alignment from image to image.
    pub alignment: AlignmentOptions,
    /// Stereo matching.
    pub stereo: StereoOptions,
    /// Outlier rejection.
    pub outliers: OutlierOptions,
    /// Preprocessing of the images.
    pub equalization: Equalization,
    /// By camera: a mask of the size of its images; nothing is tracked where it is zero.
    pub masks: Vec<Option<GrayImage>>,
    /// Maximum interval between two images, nanoseconds; after a longer one all tracks end.
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
            masks: Vec::new(),
            max_gap_ns: 500_000_000,
        }
    }
}

impl TrackerOptions {
    /// Number of points to track.
    pub fn points(mut self, points: usize) -> Self {
        self.points = points;
        self
    }

    /// Preprocessing of the images.
    pub fn equalization(mut self, equalization: Equalization) -> Self {
        self.equalization = equalization;
        self
    }

    /// Sets the mask of a camera; nothing is tracked where it is zero.
    pub fn mask(mut self, camera: usize, mask: GrayImage) -> Self {
        self.masks.resize(self.masks.len().max(camera + 1), None);
        self.masks[camera] = Some(mask);
        self
    }

    /// The mask of a camera, if it has one.
    pub(super) fn mask_of(&self, camera: usize) -> Option<&GrayImage> {
        self.masks.get(camera)?.as_ref()
    }

    /// Maximum interval between two images, nanoseconds; after a longer one all tracks end.
    pub fn max_gap_ns(mut self, max_gap_ns: i64) -> Self {
        self.max_gap_ns = max_gap_ns;
        self
    }
}
