//! Gaussian scale space and extrema of its differences.
//!
//! Source: Lowe, IJCV 2004, sections 3 and 4.

use super::plane::Plane;
use crate::image::marked;
use pulp::{Arch, NullaryFnOnce};

/// Assumed blur of the camera image, pixels.
const CAMERA_SIGMA: f32 = 0.5;
/// Blur (pixels of the octave) of the first level of each octave; Lowe's.
const FIRST_SIGMA: f32 = 1.6;
/// Levels per octave (the blur doubles); Lowe's.
pub(super) const LEVELS: usize = 3;
/// Minimum width and height of an octave, pixels: a descriptor must fit.
const MIN_SIDE: usize = 24;
/// Border without extrema, pixels of the octave.
const BORDER: usize = 5;
/// Largest ratio of the principal curvatures; Lowe's. Beyond it a point is not localized along an edge.
const MAX_CURVATURE_RATIO: f32 = 10.0;
/// Maximum offset of a refined extremum from its pixel and level: slightly above one half, so that an extremum between two
/// pixels does not alternate.
const MAX_OFFSET: f32 = 0.6;
/// Maximum number of steps of the refinement.
const MAX_STEPS: usize = 5;

/// An extremum of the difference of Gaussians.
#[derive(Clone, Copy, Debug)]
pub(super) struct Extremum {
    /// Octave it was found in.
    pub(super) octave: usize,
    /// Level of the octave whose blur is nearest to its scale.
    pub(super) level: usize,
    /// Pixels of the octave.
    pub(super) position: [f32; 2],
    /// Standard deviation of the blur, pixels of the octave.
    pub(super) sigma: f32,
    /// Size of the difference, grey levels.
    pub(super) response: f32,
}

/// Images of one size with blur increasing by factors of `2^(1/LEVELS)`.
#[derive(Default)]
pub(super) struct Octave {
    /// Size of a pixel of this octave in pixels of the image.
    pub(super) pixel_size: f32,
    /// `LEVELS + 3` images.
    pub(super) levels: Vec<Plane>,
    /// Each level except the first minus the previous one.
    differences: Vec<Plane>,
}

/// The octaves of an image; memory is reused for the next image.
#[derive(Default)]
pub(super) struct ScaleSpace {
    octaves: Vec<Octave>,
    /// Number of octaves of the current image.
    used: usize,
    base: Plane,
}

impl ScaleSpace {
    /// Builds the scale space of an image.
    ///
    /// # Arguments
    /// * `doubled`: whether the first octave has twice the resolution of the image.
    pub(super) fn build(&mut self, image: &Plane, doubled: bool) {
        let (mut pixel_size, blur) = if doubled { (0.5, 2.0 * CAMERA_SIGMA) } else { (1.0, CAMERA_SIGMA) };
        if doubled {
            self.base.double(image);
        } else {
            self.base.clone_from(image);
        }
        let first_blur = (FIRST_SIGMA * FIRST_SIGMA - blur * blur).sqrt();
        self.used = 0;
        while self.base.width.min(self.base.height) >= MIN_SIDE {
            if self.used == self.octaves.len() {
                self.octaves.push(Octave::new());
            }
            let octave = &mut self.octaves[self.used];
            octave.build(&self.base, pixel_size, (self.used == 0).then_some(first_blur));
            self.base.halve(&octave.levels[LEVELS]);
            self.used += 1;
            pixel_size *= 2.0;
        }
    }

    /// The octaves, finest first.
    pub(super) fn octaves(&self) -> &[Octave] {
        &self.octaves[..self.used]
    }

    /// Pixel of an extremum in the image.
    pub(super) fn pixel_of(&self, extremum: &Extremum) -> [f32; 2] {
        extremum.position.map(|coordinate| coordinate * self.octaves[extremum.octave].pixel_size)
    }

    /// Refined extrema with a response of at least `threshold` grey levels, without edges.
    pub(super) fn extrema(&self, threshold: f32) -> Vec<Extremum> {
        let mut found = Vec::new();
        for (index, octave) in self.octaves().iter().enumerate() {
            octave.extrema(index, threshold, &mut found);
        }
        found
    }
}

impl Octave {
    fn new() -> Self {
        let planes = |count| vec![Plane::default(); count];
        Self { pixel_size: 1.0, levels: planes(LEVELS + 3), differences: planes(LEVELS + 2) }
    }

    /// `blur`: additional blur of the first level with respect to `base`, if any.
    fn build(&mut self, base: &Plane, pixel_size: f32, blur: Option<f32>) {
        self.pixel_size = pixel_size;
        match blur {
            Some(sigma) => self.levels[0].blur(base, sigma, None),
            None => self.levels[0].clone_from(base),
        }
        for level in 1..self.levels.len() {
            let (sigma, before) = (sigma_of(level as f32), sigma_of(level as f32 - 1.0));
            let increment = (sigma * sigma - before * before).sqrt();
            let (below, above) = self.levels.split_at_mut(level);
            above[0].blur(&below[level - 1], increment, Some(&mut self.differences[level - 1]));
        }
    }

    fn extrema(&self, octave: usize, threshold: f32, found: &mut Vec<Extremum>) {
        let (width, height) = (self.levels[0].width, self.levels[0].height);
        let mut candidate = vec![false; width];
        for level in 1..=LEVELS {
            let stack =
                [&self.differences[level - 1], &self.differences[level], &self.differences[level + 1]];
            for y in BORDER..height - BORDER {
                // Half the threshold: the refined response may exceed that of the pixel.
                let least = 0.5 * threshold;
                Arch::new().dispatch(MarkCandidates { plane: stack[1], y, least, marks: &mut candidate });
                for x in marked(&candidate[BORDER..width - BORDER]).map(|index| index + BORDER) {
                    if is_extreme(stack, x, y) {
                        found.extend(refine(&self.differences, octave, [level, x, y], threshold));
                    }
                }
            }
        }
    }
}

/// Blur of a (fractional) level, pixels of the octave.
fn sigma_of(level: f32) -> f32 {
    FIRST_SIGMA * (level / LEVELS as f32).exp2()
}

/// Marks the pixels of row `y` above `least` that exceed their four neighbours.
struct MarkCandidates<'a> {
    plane: &'a Plane,
    y: usize,
    least: f32,
    marks: &'a mut [bool],
}

impl NullaryFnOnce for MarkCandidates<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { plane, y, least, marks } = self;
        let inner = plane.width - 2;
        let row = plane.row(y);
        let (above, below) = (&plane.row(y - 1)[1..=inner], &plane.row(y + 1)[1..=inner]);
        let (left, here, right) = (&row[..inner], &row[1..=inner], &row[2..]);
        for (x, mark) in marks[1..=inner].iter_mut().enumerate() {
            let value = here[x];
            let high = left[x].max(right[x]).max(above[x].max(below[x]));
            let low = left[x].min(right[x]).min(above[x].min(below[x]));
            let lead = (value - high).max(low - value);
            // One comparison, so that the compiler vectorizes.
            *mark = lead.min(value.abs() - least) > 0.0;
        }
    }
}

/// Whether a pixel of the middle plane is larger, or smaller, than its 26 neighbours.
fn is_extreme(stack: [&Plane; 3], x: usize, y: usize) -> bool {
    let value = stack[1].row(y)[x];
    let sign = value.signum();
    // The own plane first, it rejects most pixels. Equal neighbours are not extrema.
    let beats = |plane: &Plane, rows: [usize; 3], own: bool| {
        rows.iter().all(|&row| {
            let three = &plane.row(row)[x - 1..=x + 1];
            three
                .iter()
                .enumerate()
                .all(|(k, &other)| (own && row == y && k == 1) || sign * value > sign * other)
        })
    };
    let rows = [y - 1, y, y + 1];
    beats(stack[1], [y, y - 1, y + 1], true) && beats(stack[0], rows, false) && beats(stack[2], rows, false)
}

/// Sub-pixel refinement from `[level, x, y]`; `None` if weak, on an edge, or not converged.
fn refine(differences: &[Plane], octave: usize, start: [usize; 3], threshold: f32) -> Option<Extremum> {
    let [mut level, mut x, mut y] = start;
    let (width, height) = (differences[0].width, differences[0].height);
    for _ in 0..MAX_STEPS {
        let fit = Parabola::around(&differences[level - 1..=level + 1], x, y);
        let offset = fit.top()?;
        if offset.iter().all(|step| step.abs() <= MAX_OFFSET) {
            let response = fit.height(&offset).abs();
            if response < threshold || fit.is_edge() {
                return None;
            }
            let sigma = sigma_of(level as f32 + offset[2]);
            let position = [x as f32 + offset[0], y as f32 + offset[1]];
            return Some(Extremum { octave, level, position, sigma, response });
        }
        x = moved(x, offset[0], BORDER, width - BORDER)?;
        y = moved(y, offset[1], BORDER, height - BORDER)?;
        level = moved(level, offset[2], 1, LEVELS + 1)?;
    }
    None
}

/// `index + offset` rounded, if it is in `from..to`.
fn moved(index: usize, offset: f32, from: usize, to: usize) -> Option<usize> {
    let target = (index as f32 + offset).round();
    (target >= from as f32 && target < to as f32).then_some(target as usize)
}

/// The second-order expansion of the difference of Gaussians in x, y and level.
struct Parabola {
    value: f32,
    gradient: [f32; 3],
    /// xx, yy, ss, xy, xs, ys.
    hessian: [f32; 6],
}

impl Parabola {
    fn around(stack: &[Plane], x: usize, y: usize) -> Self {
        let at = |level: usize, dx: usize, dy: usize| stack[level].row(y + dy - 1)[x + dx - 1];
        let value = at(1, 1, 1);
        let gradient = [
            0.5 * (at(1, 2, 1) - at(1, 0, 1)),
            0.5 * (at(1, 1, 2) - at(1, 1, 0)),
            0.5 * (at(2, 1, 1) - at(0, 1, 1)),
        ];
        let hessian = [
            at(1, 2, 1) + at(1, 0, 1) - 2.0 * value,
            at(1, 1, 2) + at(1, 1, 0) - 2.0 * value,
            at(2, 1, 1) + at(0, 1, 1) - 2.0 * value,
            0.25 * (at(1, 2, 2) - at(1, 0, 2) - at(1, 2, 0) + at(1, 0, 0)),
            0.25 * (at(2, 2, 1) - at(2, 0, 1) - at(0, 2, 1) + at(0, 0, 1)),
            0.25 * (at(2, 1, 2) - at(2, 1, 0) - at(0, 1, 2) + at(0, 1, 0)),
        ];
        Self { value, gradient, hessian }
    }

    /// Where the gradient vanishes, relative to the pixel and level; `None` where the Hessian is singular.
    fn top(&self) -> Option<[f32; 3]> {
        let [xx, yy, ss, xy, xs, ys] = self.hessian;
        let hessian = nalgebra::Matrix3::new(xx, xy, xs, xy, yy, ys, xs, ys, ss);
        let step = hessian.try_inverse()? * nalgebra::Vector3::from(self.gradient);
        Some([-step.x, -step.y, -step.z])
    }

    /// The value at its top.
    fn height(&self, top: &[f32; 3]) -> f32 {
        self.value + 0.5 * self.gradient.iter().zip(top).map(|(slope, step)| slope * step).sum::<f32>()
    }

    /// Whether the principal curvatures in the image differ too much, or in sign.
    fn is_edge(&self) -> bool {
        let [xx, yy, _, xy, ..] = self.hessian;
        let (trace, determinant) = (xx + yy, xx * yy - xy * xy);
        let limit = (MAX_CURVATURE_RATIO + 1.0).powi(2) / MAX_CURVATURE_RATIO;
        determinant <= 0.0 || trace * trace >= limit * determinant
    }
}
