//! The iterations that align a template with an image: of the translation at one pyramid level, and of the whole warp.

use super::block::Block;
use super::lucas_kanade::{Alignment, AlignmentError, AlignmentOptions, Warp};
use super::patch::{HALF, Patch, SIDE, ZERO};
use super::template::Template;
use crate::image::GrayImage;
use nalgebra::{Matrix2, Vector2};
use pulp::{Arch, NullaryFnOnce};

/// Maximum singular value of the linear part; the minimum is its inverse.
const MAX_STRETCH: f32 = 1.6;
/// A linear part this close to the identity is ignored while only the translation is estimated.
const IDENTITY_TOLERANCE: f32 = 0.03;

/// What both searches need.
pub(super) struct Search<'a> {
    pub(super) template: &'a Template,
    /// The image, or a level of its pyramid.
    pub(super) image: &'a GrayImage,
    /// What it holds is of `image`, or nothing.
    pub(super) block: &'a mut Block,
    /// The initial warp, in pixels of `image`.
    pub(super) start: Warp,
    /// The most there are.
    pub(super) iterations: usize,
}

impl Search<'_> {
    /// Estimates the translation with the linear part fixed, until a step is shorter than `tolerance`. Returns the centre.
    pub(super) fn translation(self, tolerance: f32) -> Result<Vector2<f32>, AlignmentError> {
        let is_identity = (self.start.linear - Matrix2::identity()).amax() < IDENTITY_TOLERANCE;
        if is_identity {
            Arch::new().dispatch(GridSearch { search: self, tolerance })
        } else {
            Arch::new().dispatch(WarpedSearch { search: self, tolerance })
        }
    }

    /// Estimates translation and linear part.
    ///
    /// # Arguments
    /// * `expected`: mean of the prior of the linear part.
    pub(super) fn warp(
        self,
        expected: Matrix2<f32>,
        options: &AlignmentOptions,
    ) -> Result<Alignment, AlignmentError> {
        Arch::new().dispatch(WarpSearch { search: self, expected, options })
    }

    /// The patch under the present warp.
    #[inline(always)]
    fn sample(&mut self, seen: &mut Patch) -> Result<(), AlignmentError> {
        let warp = &self.start;
        if self.block.warped(warp.centre, &warp.linear, seen).is_none() {
            self.block.pack(self.image, warp.centre).ok_or(AlignmentError::Diverged)?;
            self.block.warped(warp.centre, &warp.linear, seen).ok_or(AlignmentError::Diverged)?;
        }
        Ok(())
    }
}

/// The translation where the linear part is the identity.
struct GridSearch<'a> {
    search: Search<'a>,
    tolerance: f32,
}

impl NullaryFnOnce for GridSearch<'_> {
    type Output = Result<Vector2<f32>, AlignmentError>;

    #[inline(always)]
    fn call(self) -> Self::Output {
        let Self { mut search, tolerance } = self;
        for _ in 0..search.iterations {
            let first = search.start.centre.add_scalar(-HALF);
            let grid = search.block.grid(search.image, first, SIDE, SIDE).ok_or(AlignmentError::Diverged)?;
            let step = search.template.grid_step(&grid).map_err(|_| AlignmentError::LowCorrelation)?;
            let step = Vector2::from(step);
            search.start.centre -= step;
            if step.norm_squared() < tolerance * tolerance {
                break;
            }
        }
        Ok(search.start.centre)
    }
}

/// The translation with any linear part.
struct WarpedSearch<'a> {
    search: Search<'a>,
    tolerance: f32,
}

impl NullaryFnOnce for WarpedSearch<'_> {
    type Output = Result<Vector2<f32>, AlignmentError>;

    #[inline(always)]
    fn call(self) -> Self::Output {
        let Self { mut search, tolerance } = self;
        let mut seen = ZERO;
        for _ in 0..search.iterations {
            search.sample(&mut seen)?;
            let step = search.template.step(&seen).map_err(|_| AlignmentError::LowCorrelation)?;
            let step = search.start.linear * Vector2::from(step);
            search.start.centre -= step;
            if step.norm_squared() < tolerance * tolerance {
                break;
            }
        }
        Ok(search.start.centre)
    }
}

/// Translation and linear part.
struct WarpSearch<'a> {
    search: Search<'a>,
    expected: Matrix2<f32>,
    options: &'a AlignmentOptions,
}

impl NullaryFnOnce for WarpSearch<'_> {
    type Output = Result<Alignment, AlignmentError>;

    #[inline(always)]
    fn call(self) -> Self::Output {
        let Self { mut search, expected, options } = self;
        let mut seen = ZERO;
        let mut is_converged = false;
        for _ in 0..search.iterations {
            search.sample(&mut seen)?;
            let warp = &mut search.start;
            let deviation = warp.linear - expected;
            let deviation = [deviation.m11, deviation.m12, deviation.m21, deviation.m22];
            let delta = search.template.linear_step(&seen, &deviation);
            let delta = delta.map_err(|_| AlignmentError::LowCorrelation)?;
            // Inverse composition: the increment x -> x + D x + d of the template is undone in the image.
            let change = Matrix2::new(1.0 + delta[2], delta[3], delta[4], 1.0 + delta[5]);
            warp.linear *= change.try_inverse().ok_or(AlignmentError::Diverged)?;
            let moved = warp.linear * Vector2::new(delta[0], delta[1]);
            warp.centre -= moved;
            if !is_plausible(&warp.linear) {
                return Err(AlignmentError::Diverged);
            }
            let turned = delta[2..].iter().fold(0.0f32, |most, value| most.max(value.abs())) * HALF;
            is_converged = moved.amax().max(turned) < options.tolerance;
            if is_converged {
                break;
            }
        }
        if !is_inside(search.image, search.start.centre) {
            return Err(AlignmentError::Diverged);
        }
        // The last patch differs by less than the tolerance from the one under the final warp.
        if !is_converged {
            search.sample(&mut seen)?;
        }
        let correlation = search.template.correlation(&seen);
        if correlation < options.min_correlation {
            return Err(AlignmentError::LowCorrelation);
        }
        Ok(Alignment { warp: search.start, correlation })
    }
}

#[inline(always)]
fn is_plausible(linear: &Matrix2<f32>) -> bool {
    // Singular values s1 >= s2 of a 2x2 matrix: s1 s2 = |det|, s1^2 + s2^2 = |A|^2.
    let square = linear.norm_squared();
    let det = linear.determinant();
    let root = (square * square - 4.0 * det * det).max(0.0).sqrt();
    let (largest, smallest) = (0.5 * (square + root), 0.5 * (square - root));
    det > 0.0 && largest < MAX_STRETCH * MAX_STRETCH && smallest * MAX_STRETCH * MAX_STRETCH > 1.0
}

/// Whether all samples of the patch lie inside the image.
#[inline(always)]
fn is_inside(image: &GrayImage, centre: Vector2<f32>) -> bool {
    let within = |value: f32, side: usize| value >= HALF && value <= side as f32 - 1.0 - HALF;
    within(centre.x, image.width()) && within(centre.y, image.height())
}
