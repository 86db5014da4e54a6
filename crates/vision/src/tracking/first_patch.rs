//! The patch of a track's first image, which all later images of the track are aligned with.
//!
//! Aligned with the image before, each image adds the error of its alignment: the error of a track is a random walk. Aligned
//! with one patch, the errors of its images are independent of each other. The linear part of the warp from the first image
//! takes up how the surroundings turn and grow in between.

use super::lucas_kanade::Warp;
use super::template::Template;
use nalgebra::Matrix2;

/// The patch of a track's first image.
#[derive(Clone)]
pub(super) struct FirstPatch {
    /// Boxed: nine kilobytes.
    template: Box<Template>,
    /// Linear part of the warp from the first image to the last one of the track.
    pub(super) linear: Matrix2<f32>,
}

/// Where a track is in the next image.
#[derive(Clone, Copy, Debug)]
pub(super) struct Followed {
    /// Warp of the patch in the image before.
    pub(super) warp: Warp,
    /// Linear part of the warp from the first image.
    pub(super) from_first: Matrix2<f32>,
}

impl FirstPatch {
    /// The patch of a template with its linear part.
    pub(super) fn new(template: &Template) -> Self {
        Self { template: Box::new(template.clone()), linear: Matrix2::identity() }
    }

    pub(super) fn template(&self) -> &Template {
        &self.template
    }

    /// The next image of the track, from the warp of its first patch. `None` if the warp has no inverse.
    pub(super) fn followed(&self, found: &Warp) -> Option<Followed> {
        let linear = found.linear * self.linear.try_inverse()?;
        Some(Followed { warp: Warp { centre: found.centre, linear }, from_first: found.linear })
    }
}

impl std::fmt::Debug for FirstPatch {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("FirstPatch").field("linear", &self.linear).finish_non_exhaustive()
    }
}
