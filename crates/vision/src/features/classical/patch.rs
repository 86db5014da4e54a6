//! Gradients on a grid rotated and scaled with the keypoint.

use super::plane::Plane;
use pulp::{Arch, NullaryFnOnce};
use std::f32::consts::{FRAC_PI_2, PI, TAU};

/// Gradients on a square grid, row after row.
///
/// `LANES` samples of a row are computed together: two more than gradients at least, a multiple of eight.
#[derive(Default)]
pub(super) struct Gradients<const LANES: usize> {
    samples: Vec<[f32; LANES]>,
    /// Lengths.
    pub(super) lengths: Vec<f32>,
    /// Directions from the grid's x axis, radians in 0 to 2 pi.
    pub(super) directions: Vec<f32>,
}

impl<const LANES: usize> Gradients<LANES> {
    /// Samples `side * side` gradients around `centre` (pixels of the plane), `step` pixels apart, on axes rotated by
    /// `angle` (radians, x towards y).
    pub(super) fn sample(&mut self, plane: &Plane, centre: [f32; 2], step: f32, angle: f32, side: usize) {
        let axis = [step * angle.cos(), step * angle.sin()];
        Arch::new().dispatch(Sample { gradients: self, plane, centre, axis, side });
    }
}

/// See [`Gradients::sample`].
struct Sample<'a, const LANES: usize> {
    gradients: &'a mut Gradients<LANES>,
    plane: &'a Plane,
    centre: [f32; 2],
    /// From one sample to the next in a row, pixels.
    axis: [f32; 2],
    side: usize,
}

impl<const LANES: usize> NullaryFnOnce for Sample<'_, LANES> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { gradients, plane, centre, axis: [cosine, sine], side } = self;
        let wide = side + 2;
        let middle = 0.5 * (wide - 1) as f32;
        gradients.samples.resize(wide, [0.0; LANES]);
        for (row, samples) in gradients.samples.iter_mut().enumerate() {
            let b = row as f32 - middle;
            let (mut xs, mut ys) = ([0.0; LANES], [0.0; LANES]);
            for column in 0..LANES {
                let a = column as f32 - middle;
                xs[column] = centre[0] + cosine * a - sine * b;
                ys[column] = centre[1] + sine * a + cosine * b;
            }
            plane.bilinear(&xs, &ys, wide, samples);
        }
        gradients.lengths.resize(side * side, 0.0);
        gradients.directions.resize(side * side, 0.0);
        let lengths = gradients.lengths.chunks_exact_mut(side);
        let directions = gradients.directions.chunks_exact_mut(side);
        for (rows, (lengths, directions)) in gradients.samples.windows(3).zip(lengths.zip(directions)) {
            let (above, here, below) = (&rows[0][1..=side], &rows[1], &rows[2][1..=side]);
            let (before, after) = (&here[..side], &here[2..side + 2]);
            for column in 0..side {
                let (dx, dy) = (after[column] - before[column], below[column] - above[column]);
                lengths[column] = (dx * dx + dy * dy).sqrt();
                directions[column] = direction(dy, dx);
            }
        }
    }
}

/// `atan2(y, x)` in 0 to 2 pi, to 2e-3 radians; faster than the standard library, and identical on all platforms.
///
/// The arc tangent on 0 to 1 by the polynomial of Abramowitz & Stegun, 4.4.47, shortened.
#[inline(always)]
fn direction(y: f32, x: f32) -> f32 {
    let (large, small) = (x.abs().max(y.abs()), x.abs().min(y.abs()));
    let ratio = small / large.max(f32::MIN_POSITIVE);
    let square = ratio * ratio;
    let octant = ((-0.046_496_47 * square + 0.159_314_22) * square - 0.327_622_77) * square * ratio + ratio;
    let quadrant = if y.abs() > x.abs() { FRAC_PI_2 - octant } else { octant };
    let half = if x < 0.0 { PI - quadrant } else { quadrant };
    if y < 0.0 { TAU - half } else { half }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_are_those_of_the_library() {
        for step in 0..720 {
            let angle = (step as f32 + 0.3) * TAU / 720.0;
            let error = direction(3.0 * angle.sin(), 3.0 * angle.cos()) - angle;
            assert!(error.abs() < 2e-3, "{angle}: {error}");
        }
        assert!(direction(0.0, 0.0).abs() < f32::EPSILON);
    }
}
