//! The iterations that align a template with an image: of the translation at one pyramid level, and of the whole warp.

use super::block::Block;
use super::lucas_kanade::{Alignment, AlignmentError, AlignmentOptions, Warp};
use super::patch::{HALF, Patch, ZERO};
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
    pub(super) block: &'a mut Block,
    /// The initial warp, in pixels of `image`.
    pub(super) start: Warp,
    pub(super) options: &'a AlignmentOptions,
}

impl Search<'_> {
    /// Estimates the translation with the linear part fixed. Returns the centre.
    pub(super) fn translation(self) -> Result<Vector2<f32>, AlignmentError> {
        let is_identity = (self.start.linear - Matrix2::identity()).amax() < IDENTITY_TOLERANCE;
        if is_identity {
            Arch::new().dispatch(GridSearch(self))
        } else {
            Arch::new().dispatch(WarpedSearch(self))
        }
    }

    /// Estimates translation and linear part.
    ///
    /// # Arguments
    /// * `expected`: mean of the prior of the linear part.
    pub(super) fn warp(self, expected: Matrix2<f32>) -> Result<Alignment, AlignmentError> {
        Arch::new().dispatch(WarpSearch { search: self, expected })
    }

    /// Loads the block around the present centre.
    #[inline(always)]
    fn load(&mut self) -> Result<(), AlignmentError> {
        self.block.load(self.image, self.start.centre).ok_or(AlignmentError::Diverged)
    }

    /// The patch under the present warp.
    #[inline(always)]
    fn sample(&mut self, seen: &mut Patch) -> Result<(), AlignmentError> {
        let warp = &self.start;
        if self.block.warped(warp.centre, &warp.linear, seen).is_none() {
            self.load()?;
            self.block.pack();
            let warp = &self.start;
            self.block.warped(warp.centre, &warp.linear, seen).ok_or(AlignmentError::Diverged)?;
        }
        Ok(())
    }
}

/// The translation where the linear part is the identity.
struct GridSearch<'a>(Search<'a>);

impl NullaryFnOnce for GridSearch<'_> {
    type Output = Result<Vector2<f32>, AlignmentError>;

    #[inline(always)]
    fn call(self) -> Self::Output {
        let Self(mut search) = self;
        let tolerance = search.options.tolerance;
        search.load()?;
        for _ in 0..search.options.iterations {
            let first = search.start.centre.add_scalar(-HALF);
            let step = match search.template.grid_step(search.block, first) {
                Ok(Some(step)) => step,
                Ok(None) => {
                    search.load()?;
                    let step = search.template.grid_step(search.block, first);
                    step.map_err(|_| AlignmentError::LowCorrelation)?.ok_or(AlignmentError::Diverged)?
                }
                Err(_) => return Err(AlignmentError::LowCorrelation),
            };
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
struct WarpedSearch<'a>(Search<'a>);

impl NullaryFnOnce for WarpedSearch<'_> {
    type Output = Result<Vector2<f32>, AlignmentError>;

    #[inline(always)]
    fn call(self) -> Self::Output {
        let Self(mut search) = self;
        let tolerance = search.options.tolerance;
        search.load()?;
        search.block.pack();
        let mut seen = ZERO;
        for _ in 0..search.options.iterations {
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
}

impl NullaryFnOnce for WarpSearch<'_> {
    type Output = Result<Alignment, AlignmentError>;

    #[inline(always)]
    fn call(self) -> Self::Output {
        let Self { mut search, expected } = self;
        let (tolerance, min_correlation) = (search.options.tolerance, search.options.min_correlation);
        search.load()?;
        search.block.pack();
        let mut seen = ZERO;
        for _ in 0..search.options.iterations {
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
            if moved.amax().max(turned) < tolerance {
                break;
            }
        }
        if !is_inside(search.image, search.start.centre) {
            return Err(AlignmentError::Diverged);
        }
        search.sample(&mut seen)?;
        let correlation = search.template.correlation(&seen);
        if correlation < min_correlation {
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
