//! Pyramidal Lucas-Kanade alignment of single patches with an affine warp, gain and bias, and a forward-backward check.
//!
//! From the coarsest level to the image itself only the translation is estimated (two parameters); at full resolution
//! the linear part of the warp is refined as well (six), so that rotation and zoom do not bias the position.
//!
//! Sources: Lucas & Kanade, IJCAI 1981; Bouguet, "Pyramidal implementation of the Lucas Kanade feature tracker",
//! Intel 2000; the inverse compositional step in `template`.

use super::block::{Block, HALF};
use super::template::Template;
use crate::image::Pyramid;
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
/// Pyramid levels of the backward alignment, which keeps the linear part. Its start is close: more levels would only
/// increase the risk of divergence.
const BACKWARD_LEVELS: usize = 2;
/// Maximum singular value of the linear part; the minimum is its inverse.
const MAX_STRETCH: f32 = 1.6;
/// A linear part this close to the identity is ignored while only the translation is estimated.
const IDENTITY_TOLERANCE: f32 = 0.03;

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
    let centre = align_translation(first, second, at, guess, options, options.levels)?;
    let prior = (SIGMA_SAMPLE / options.linear_sigma).powi(2);
    let template = Template::<6>::new(first.base(), at, prior).ok_or(AlignmentError::NoStructure)?;
    refine(&template, second, Warp { centre, ..*guess }, guess, options)
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
    let found = align(first, second, at, guess, options)?;
    let linear = found.warp.linear.try_inverse().ok_or(AlignmentError::Diverged)?;
    let start = Warp { centre: at, linear };
    let back = align_translation(second, first, found.warp.centre, &start, options, BACKWARD_LEVELS)?;
    if (back - at).norm() > options.max_backward_error {
        return Err(AlignmentError::BackwardCheck);
    }
    Ok(found)
}

/// Estimates the translation from the coarsest level to the finest. Returns the centre in pixels of the image.
fn align_translation(
    first: &Pyramid,
    second: &Pyramid,
    at: Vector2<f32>,
    guess: &Warp,
    options: &AlignmentOptions,
    levels: usize,
) -> Result<Vector2<f32>, AlignmentError> {
    let levels = levels.min(first.levels()).min(second.levels()).max(1);
    let mut warp = *guess;
    for level in (0..levels).rev() {
        let scale = 1.0 / (1u32 << level) as f32;
        // A finer level may have structure where a coarse one has none.
        let Some(template) = Template::<2>::new(first.level(level), at * scale, 0.0) else { continue };
        warp.centre = align_level(&template, second, level, &warp, options)? / scale;
    }
    Ok(warp.centre)
}

/// Estimates the translation at one level with the linear part fixed. Returns the centre in pixels of that level.
fn align_level(
    template: &Template<2>,
    second: &Pyramid,
    level: usize,
    warp: &Warp,
    options: &AlignmentOptions,
) -> Result<Vector2<f32>, AlignmentError> {
    let image = second.level(level);
    let mut centre = warp.centre / (1u32 << level) as f32;
    let is_identity = (warp.linear - Matrix2::identity()).amax() < IDENTITY_TOLERANCE;
    let mut block = Block::around(image, centre).ok_or(AlignmentError::Diverged)?;
    for _ in 0..options.iterations {
        let sample = |block: &Block| {
            if is_identity {
                block.grid(centre.add_scalar(-HALF))
            } else {
                block.warped(centre, &warp.linear)
            }
        };
        let seen = if let Some(seen) = sample(&block) {
            seen
        } else {
            block = Block::around(image, centre).ok_or(AlignmentError::Diverged)?;
            sample(&block).ok_or(AlignmentError::Diverged)?
        };
        let step = template.step(&seen, &[0.0; 4]).ok_or(AlignmentError::LowCorrelation)?;
        let delta = if is_identity { step } else { warp.linear * step };
        centre -= delta;
        if delta.norm_squared() < options.tolerance * options.tolerance {
            break;
        }
    }
    Ok(centre)
}

/// Refines translation and linear part at full resolution.
fn refine(
    template: &Template<6>,
    second: &Pyramid,
    mut warp: Warp,
    guess: &Warp,
    options: &AlignmentOptions,
) -> Result<Alignment, AlignmentError> {
    let image = second.base();
    let mut block = Block::around(image, warp.centre).ok_or(AlignmentError::Diverged)?;
    let sample = |block: &mut Block, warp: &Warp| {
        if let Some(seen) = block.warped(warp.centre, &warp.linear) {
            return Ok(seen);
        }
        *block = Block::around(image, warp.centre).ok_or(AlignmentError::Diverged)?;
        block.warped(warp.centre, &warp.linear).ok_or(AlignmentError::Diverged)
    };
    for _ in 0..options.iterations {
        let seen = sample(&mut block, &warp)?;
        let deviation = warp.linear - guess.linear;
        let deviation = [deviation.m11, deviation.m12, deviation.m21, deviation.m22];
        let delta = template.step(&seen, &deviation).ok_or(AlignmentError::LowCorrelation)?;
        // Inverse composition: the increment x -> x + D x + d of the template is undone in the image.
        let change = Matrix2::new(1.0 + delta[2], delta[3], delta[4], 1.0 + delta[5]);
        warp.linear *= change.try_inverse().ok_or(AlignmentError::Diverged)?;
        let moved = warp.linear * Vector2::new(delta[0], delta[1]);
        warp.centre -= moved;
        if !is_plausible(&warp.linear) {
            return Err(AlignmentError::Diverged);
        }
        let turned = delta.fixed_rows::<4>(2).amax() * HALF;
        if moved.amax().max(turned) < options.tolerance {
            break;
        }
    }
    if !is_inside(second, warp.centre) {
        return Err(AlignmentError::Diverged);
    }
    let correlation = template.correlation(sample(&mut block, &warp)?);
    if correlation < options.min_correlation {
        return Err(AlignmentError::LowCorrelation);
    }
    Ok(Alignment { warp, correlation })
}

fn is_plausible(linear: &Matrix2<f32>) -> bool {
    // Singular values s1 >= s2 of a 2x2 matrix: s1 s2 = |det|, s1^2 + s2^2 = |A|^2.
    let square = linear.norm_squared();
    let det = linear.determinant();
    let root = (square * square - 4.0 * det * det).max(0.0).sqrt();
    let (largest, smallest) = (0.5 * (square + root), 0.5 * (square - root));
    det > 0.0 && largest < MAX_STRETCH * MAX_STRETCH && smallest * MAX_STRETCH * MAX_STRETCH > 1.0
}

/// Whether all samples of the patch lie inside the image.
fn is_inside(pyramid: &Pyramid, centre: Vector2<f32>) -> bool {
    let image = pyramid.base();
    let within = |value: f32, side: usize| value >= HALF && value <= side as f32 - 1.0 - HALF;
    within(centre.x, image.width()) && within(centre.y, image.height())
}
