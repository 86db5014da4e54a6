//! Pyramidal Lucas-Kanade alignment of single patches, with a linear warp, brightness change and a check backward.
//!
//! From the coarsest level to the image itself the patch is moved (two parameters); then, at the resolution of the
//! image, its linear warp is refined as well (six), so that turning and zooming do not pull the position to one side.
//!
//! Sources: Lucas & Kanade, IJCAI 1981; Bouguet, "Pyramidal implementation of the Lucas Kanade feature tracker",
//! Intel 2000; the inverse compositional step in `template`.

use super::block::{Block, HALF};
use super::template::Template;
use crate::pyramid::Pyramid;
use nalgebra::{Matrix2, Vector2};

/// Where a patch is in another image, and how its surroundings are turned and stretched there.
///
/// A point that lay `offset` pixels from the patch's centre lies at `centre + linear * offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Warp {
    /// Pixel position of the centre.
    pub centre: Vector2<f32>,
    /// The linear part, without unit.
    pub linear: Matrix2<f32>,
}

impl Warp {
    /// A patch that was moved to `centre` and nothing else.
    pub fn moved_to(centre: Vector2<f32>) -> Self {
        Self { centre, linear: Matrix2::identity() }
    }
}

/// A patch that was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Found {
    /// Where.
    pub warp: Warp,
    /// Correlation coefficient of what is there with what was sought, -1 to 1.
    pub correlation: f32,
}

/// Why a patch was not found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Lost {
    /// It does not say where it is: plain, or a straight edge.
    #[error("the patch has no structure in two directions")]
    NoStructure,
    /// The alignment left the surroundings of its start, or the image.
    #[error("the alignment ran away or left the image")]
    RanAway,
    /// What is there looks different.
    #[error("what is at the place that was found looks different")]
    Different,
    /// From there, the way back does not lead to where it came from.
    #[error("tracking back leads elsewhere")]
    NotMutual,
}

/// Settings of the alignment. Tuned on rendered pairs (20 px, 10 deg, 10 % zoom) and `mh_01_handheld_16s`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AlignmentOptions {
    /// Pyramid levels to use, the image itself included. Each doubles the motion that can be followed: about 6 px
    /// at one level.
    pub levels: usize,
    /// Most steps at one level.
    pub iterations: usize,
    /// A step below this length ends a level, pixels of that level.
    pub tolerance: f32,
    /// Standard deviation of what is not known about the linear part, per element. Frames of a video change by a
    /// few percent, and a start from the gyroscope's rotation covers most of that.
    pub linear_sigma: f32,
    /// The correlation below which what was found is something else.
    pub min_correlation: f32,
    /// Furthest that tracking back may end from where it began, pixels.
    pub max_return_error: f32,
}

impl Default for AlignmentOptions {
    fn default() -> Self {
        Self {
            levels: 4,
            iterations: 10,
            tolerance: 0.02,
            linear_sigma: 0.1,
            min_correlation: 0.75,
            max_return_error: 0.5,
        }
    }
}

/// Noise of a sample that the prior on the linear part is weighed against, grey levels: sensor noise, interpolation
/// and what else differs between two images.
const SAMPLE_NOISE: f32 = 4.0;
/// Levels of the way back, which takes the linear part as it was found. It starts close by: a pyramid would only lead
/// it away from where it belongs.
const LEVELS_BACK: usize = 2;
/// Largest singular value that the linear part may reach or fall below the inverse of: beyond, it is no view of the
/// same surface any more.
const MAX_STRETCH: f32 = 1.6;
/// A linear part this close to the identity is left out at coarse levels, where only the position matters.
const PLAIN_LINEAR: f32 = 0.03;

/// Finds the patch around `at` (pixels of the first image) in the second image, from a first guess.
///
/// # Errors
/// [`Lost`], all but [`Lost::NotMutual`].
pub fn align(
    first: &Pyramid,
    second: &Pyramid,
    at: Vector2<f32>,
    guess: &Warp,
    options: &AlignmentOptions,
) -> Result<Found, Lost> {
    let centre = move_down(first, second, at, guess, options, options.levels)?;
    let prior = (SAMPLE_NOISE / options.linear_sigma).powi(2);
    let template = Template::<6>::new(first.base(), at, prior).ok_or(Lost::NoStructure)?;
    refine(&template, second, Warp { centre, ..*guess }, guess, options)
}

/// [`align`], then the same from what was found back to the first image, which must end where it began.
///
/// # Errors
/// [`Lost`].
pub fn align_mutually(
    first: &Pyramid,
    second: &Pyramid,
    at: Vector2<f32>,
    guess: &Warp,
    options: &AlignmentOptions,
) -> Result<Found, Lost> {
    let found = align(first, second, at, guess, options)?;
    let linear = found.warp.linear.try_inverse().ok_or(Lost::RanAway)?;
    let start = Warp { centre: at, linear };
    let back = move_down(second, first, found.warp.centre, &start, options, LEVELS_BACK)?;
    if (back - at).norm() > options.max_return_error {
        return Err(Lost::NotMutual);
    }
    Ok(found)
}

/// Moves a patch from the coarsest of some levels to the finest. Returns its centre.
fn move_down(
    first: &Pyramid,
    second: &Pyramid,
    at: Vector2<f32>,
    guess: &Warp,
    options: &AlignmentOptions,
    levels: usize,
) -> Result<Vector2<f32>, Lost> {
    let levels = levels.min(first.levels()).min(second.levels()).max(1);
    let mut warp = *guess;
    for level in (0..levels).rev() {
        let scale = 1.0 / (1u32 << level) as f32;
        // Where a coarse level has no structure the next finer one still may.
        let Some(template) = Template::<2>::new(first.level(level), at * scale, 0.0) else { continue };
        warp.centre = move_patch(&template, second, level, &warp, options)? / scale;
    }
    Ok(warp.centre)
}

/// Moves a patch at one level; the linear part stays as it is. Returns the centre in pixels of that level.
fn move_patch(
    template: &Template<2>,
    second: &Pyramid,
    level: usize,
    warp: &Warp,
    options: &AlignmentOptions,
) -> Result<Vector2<f32>, Lost> {
    let image = second.level(level);
    let mut centre = warp.centre / (1u32 << level) as f32;
    let plain = (warp.linear - Matrix2::identity()).amax() < PLAIN_LINEAR;
    let mut block = Block::around(image, centre).ok_or(Lost::RanAway)?;
    for _ in 0..options.iterations {
        let sample = |block: &Block| {
            if plain { block.grid(centre.add_scalar(-HALF)) } else { block.warped(centre, &warp.linear) }
        };
        let seen = if let Some(seen) = sample(&block) {
            seen
        } else {
            block = Block::around(image, centre).ok_or(Lost::RanAway)?;
            sample(&block).ok_or(Lost::RanAway)?
        };
        let step = template.step(&seen, &[0.0; 4]).ok_or(Lost::Different)?;
        let delta = if plain { step.delta } else { warp.linear * step.delta };
        centre -= delta;
        if delta.norm_squared() < options.tolerance * options.tolerance {
            break;
        }
    }
    Ok(centre)
}

/// Refines position and linear part at the resolution of the image.
fn refine(
    template: &Template<6>,
    second: &Pyramid,
    mut warp: Warp,
    guess: &Warp,
    options: &AlignmentOptions,
) -> Result<Found, Lost> {
    let image = second.base();
    let mut block = Block::around(image, warp.centre).ok_or(Lost::RanAway)?;
    let sample = |block: &mut Block, warp: &Warp| {
        if let Some(seen) = block.warped(warp.centre, &warp.linear) {
            return Ok(seen);
        }
        *block = Block::around(image, warp.centre).ok_or(Lost::RanAway)?;
        block.warped(warp.centre, &warp.linear).ok_or(Lost::RanAway)
    };
    for _ in 0..options.iterations {
        let seen = sample(&mut block, &warp)?;
        let off = warp.linear - guess.linear;
        let off = [off.m11, off.m12, off.m21, off.m22];
        let delta = template.step(&seen, &off).ok_or(Lost::Different)?.delta;
        // The template is off by x -> x + D x + d, so that the image has to be seen through its inverse.
        let change = Matrix2::new(1.0 + delta[2], delta[3], delta[4], 1.0 + delta[5]);
        warp.linear *= change.try_inverse().ok_or(Lost::RanAway)?;
        let moved = warp.linear * Vector2::new(delta[0], delta[1]);
        warp.centre -= moved;
        if !is_credible(&warp.linear) {
            return Err(Lost::RanAway);
        }
        let turned = delta.fixed_rows::<4>(2).amax() * HALF;
        if moved.amax().max(turned) < options.tolerance {
            break;
        }
    }
    if !is_inside(second, warp.centre) {
        return Err(Lost::RanAway);
    }
    let correlation = template.correlation(sample(&mut block, &warp)?);
    if correlation < options.min_correlation {
        return Err(Lost::Different);
    }
    Ok(Found { warp, correlation })
}

fn is_credible(linear: &Matrix2<f32>) -> bool {
    // Singular values s1 >= s2 of a 2x2 matrix: s1 s2 = |det|, s1^2 + s2^2 = |A|^2.
    let square = linear.norm_squared();
    let det = linear.determinant();
    let root = (square * square - 4.0 * det * det).max(0.0).sqrt();
    let (largest, smallest) = (0.5 * (square + root), 0.5 * (square - root));
    det > 0.0 && largest < MAX_STRETCH * MAX_STRETCH && smallest * MAX_STRETCH * MAX_STRETCH > 1.0
}

/// Whether the patch lies within the image with all of its samples.
fn is_inside(pyramid: &Pyramid, centre: Vector2<f32>) -> bool {
    let image = pyramid.base();
    let within = |value: f32, side: usize| value >= HALF && value <= side as f32 - 1.0 - HALF;
    within(centre.x, image.width()) && within(centre.y, image.height())
}
