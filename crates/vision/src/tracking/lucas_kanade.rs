//! Pyramidal Lucas-Kanade alignment of single patches with an affine warp, gain and bias, and a forward-backward check.
//!
//! From the coarsest level to the image itself only the translation is estimated (two parameters); at full resolution
//! the linear part of the warp is refined as well (six), so that rotation and zoom do not bias the position.
//!
//! Sources: Lucas & Kanade, IJCAI 1981; Bouguet, "Pyramidal implementation of the Lucas Kanade feature tracker",
//! Intel 2000; the inverse compositional step in `template`, the iterations in `search`.

use super::block::Block;
use super::first_patch::{FirstPatch, Followed};
use super::search::Search;
use super::template::Template;
use crate::image::{GrayImage, Pyramid};
use nalgebra::{Matrix2, Vector2};

/// Affine warp of a patch into another image: a point at `offset` pixels from the centre of the patch is at
/// `centre + linear * offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Warp {
    /// Pixel position of the centre.
    pub centre: Vector2<f32>,
    /// Linear part, dimensionless.
    pub linear: Matrix2<f32>,
}

impl Warp {
    /// A pure translation to `centre`.
    pub fn moved_to(centre: Vector2<f32>) -> Self {
        Self { centre, linear: Matrix2::identity() }
    }
}

/// An aligned patch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Alignment {
    /// Its warp in the second image.
    pub warp: Warp,
    /// Correlation coefficient with the template, -1 to 1.
    pub correlation: f32,
}

/// Why an alignment failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum AlignmentError {
    /// The template has no gradients in two directions (uniform, or a straight edge).
    #[error("the patch has no structure in two directions")]
    NoStructure,
    /// The iteration diverged or left the image.
    #[error("the alignment diverged or left the image")]
    Diverged,
    /// The correlation with the template is too low.
    #[error("the aligned patch differs from the template")]
    LowCorrelation,
    /// The backward alignment does not return to the start.
    #[error("the backward alignment ends too far from the start")]
    BackwardCheck,
}

/// Settings of the alignment. Tuned on rendered pairs (20 px, 10 deg, 10 % zoom) and `mh_01_handheld_16s`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AlignmentOptions {
    /// Pyramid levels, the image itself included. Each doubles the largest motion, about 6 px at one level.
    pub levels: usize,
    /// Maximum iterations per level.
    pub iterations: usize,
    /// Convergence threshold on the step, pixels of the level.
    pub tolerance: f32,
    /// Prior standard deviation of each element of the linear part around the initial guess. Frames of a video change by
    /// a few percent, most of which a prediction by the gyroscope covers.
    pub linear_sigma: f32,
    /// Minimum correlation coefficient with the template.
    pub min_correlation: f32,
    /// Maximum error of the forward-backward check, pixels.
    pub max_backward_error: f32,
}

impl Default for AlignmentOptions {
    fn default() -> Self {
        Self {
            levels: 4,
            iterations: 10,
            tolerance: 0.02,
            linear_sigma: 0.1,
            min_correlation: 0.75,
            max_backward_error: 0.5,
        }
    }
}

/// Standard deviation of a sample, grey levels, for weighting the prior on the linear part: sensor noise,
/// interpolation and other differences between two images.
const SIGMA_SAMPLE: f32 = 4.0;
/// Convergence threshold on the step while only the translation is estimated, pixels of the level: what is left is estimated
/// at the next level, or with the linear part.
const TRANSLATION_TOLERANCE: f32 = 0.1;
/// Pyramid levels of the backward alignment, which keeps the linear part. It starts where it should end: more levels would
/// only increase the risk of divergence.
const BACKWARD_LEVELS: usize = 1;

/// Aligns the patch around `at` (pixels of the first image) with the second image.
///
/// # Arguments
/// * `guess`: initial warp; its linear part is the mean of the prior.
///
/// # Errors
/// All of [`AlignmentError`] except [`AlignmentError::BackwardCheck`].
pub fn align(
    first: &Pyramid,
    second: &Pyramid,
    at: Vector2<f32>,
    guess: &Warp,
    options: &AlignmentOptions,
) -> Result<Alignment, AlignmentError> {
    Aligner::new().align([first, second], at, guess, options)
}

/// [`align`] followed by an alignment from the result back to the first image, which must end at `at`.
///
/// # Errors
/// [`AlignmentError`].
pub fn align_with_backward_check(
    first: &Pyramid,
    second: &Pyramid,
    at: Vector2<f32>,
    guess: &Warp,
    options: &AlignmentOptions,
) -> Result<Alignment, AlignmentError> {
    Aligner::new().align_with_backward_check([first, second], at, guess, options)
}

/// Weight of the prior on each element of the linear part.
fn prior(options: &AlignmentOptions) -> f32 {
    (SIGMA_SAMPLE / options.linear_sigma).powi(2)
}

/// Aligns patches; its memory is reused from patch to patch.
pub(super) struct Aligner {
    block: Block,
    template: Template,
}

impl Aligner {
    /// Boxed: several kilobytes.
    pub(super) fn new() -> Box<Self> {
        Box::new(Self { block: Block::new(), template: Template::new() })
    }

    /// See [`align`].
    fn align(
        &mut self,
        images: [&Pyramid; 2],
        at: Vector2<f32>,
        guess: &Warp,
        options: &AlignmentOptions,
    ) -> Result<Alignment, AlignmentError> {
        let (centre, has_template) = self.align_translation(images, at, guess, options, options.levels)?;
        has_template
            .then(|| self.template.add_linear_part(prior(options)))
            .flatten()
            .ok_or(AlignmentError::NoStructure)?;
        let start = Warp { centre, ..*guess };
        self.search(images[1].base(), start, options.iterations).warp(guess.linear, options)
    }

    /// See [`align_with_backward_check`].
    pub(super) fn align_with_backward_check(
        &mut self,
        images: [&Pyramid; 2],
        at: Vector2<f32>,
        guess: &Warp,
        options: &AlignmentOptions,
    ) -> Result<Alignment, AlignmentError> {
        let found = self.align(images, at, guess, options)?;
        self.check_backward(images, at, &found.warp, options)?;
        Ok(found)
    }

    /// The patch around a pixel, which later images are aligned with.
    ///
    /// `None` if it is outside the image or has no structure in two directions.
    pub(super) fn first_patch(
        &mut self,
        image: &Pyramid,
        at: Vector2<f32>,
        options: &AlignmentOptions,
    ) -> Option<FirstPatch> {
        self.block.clear();
        self.template.set(image.base(), at, &mut self.block)?;
        self.template.add_linear_part(prior(options))?;
        Some(FirstPatch::new(&self.template))
    }

    /// Follows a track from one image to another: the translation by the patch in the first of them, then the whole warp by
    /// the patch of the track's first image, and back.
    ///
    /// # Arguments
    /// * `at`: pixel in the first of both images.
    /// * `guess`: initial warp from there to the second image.
    ///
    /// # Errors
    /// [`AlignmentError`].
    pub(super) fn follow(
        &mut self,
        images: [&Pyramid; 2],
        at: Vector2<f32>,
        guess: &Warp,
        patch: &FirstPatch,
        options: &AlignmentOptions,
    ) -> Result<Followed, AlignmentError> {
        let (centre, has_template) = self.align_translation(images, at, guess, options, options.levels)?;
        if !has_template {
            return Err(AlignmentError::NoStructure);
        }
        let start = Warp { centre, linear: guess.linear * patch.linear };
        let search = Search {
            template: patch.template(),
            image: images[1].base(),
            block: &mut self.block,
            start,
            iterations: options.iterations,
        };
        let found = search.warp(start.linear, options)?.warp;
        let followed = patch.followed(&found).ok_or(AlignmentError::Diverged)?;
        self.check_backward(images, at, &followed.warp, options)?;
        Ok(followed)
    }

    /// Aligns from the end of `warp` back to the first image, which must end at `at`.
    fn check_backward(
        &mut self,
        images: [&Pyramid; 2],
        at: Vector2<f32>,
        warp: &Warp,
        options: &AlignmentOptions,
    ) -> Result<(), AlignmentError> {
        let linear = warp.linear.try_inverse().ok_or(AlignmentError::Diverged)?;
        let start = Warp { centre: at, linear };
        let back = [images[1], images[0]];
        let (end, _) = self.align_translation(back, warp.centre, &start, options, BACKWARD_LEVELS)?;
        if (end - at).norm() > options.max_backward_error {
            return Err(AlignmentError::BackwardCheck);
        }
        Ok(())
    }

    /// Estimates the translation from the coarsest level to the finest.
    ///
    /// # Returns
    /// The centre in pixels of the image, and whether the template is that of the image itself: not where it has no
    /// structure there.
    fn align_translation(
        &mut self,
        images: [&Pyramid; 2],
        at: Vector2<f32>,
        guess: &Warp,
        options: &AlignmentOptions,
        levels: usize,
    ) -> Result<(Vector2<f32>, bool), AlignmentError> {
        let [first, second] = images;
        let levels = levels.min(first.levels()).min(second.levels()).max(1);
        let mut centre = guess.centre;
        let mut has_template = false;
        for level in (0..levels).rev() {
            let scale = 1.0 / (1u32 << level) as f32;
            self.block.clear();
            has_template = self.template.set(first.level(level), at * scale, &mut self.block).is_some();
            // A finer level may have structure where a coarse one has none.
            if has_template {
                self.block.clear();
                let start = Warp { centre: centre * scale, ..*guess };
                centre = self
                    .search(second.level(level), start, options.iterations)
                    .translation(TRANSLATION_TOLERANCE)?
                    / scale;
            }
        }
        Ok((centre, has_template))
    }

    fn search<'a>(&'a mut self, image: &'a GrayImage, start: Warp, iterations: usize) -> Search<'a> {
        Search { template: &self.template, image, block: &mut self.block, start, iterations }
    }
}
