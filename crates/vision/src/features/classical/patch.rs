//! Gradients on a grid rotated and scaled with the keypoint.

use super::plane::Plane;
use std::f32::consts::{FRAC_PI_2, PI, TAU};

/// Gradients on a square grid, row after row.
#[derive(Default)]
pub(super) struct Gradients {
    samples: Vec<f32>,
    /// Lengths.
    pub(super) lengths: Vec<f32>,
    /// Directions from the grid's x axis, radians in 0 to 2 pi.
    pub(super) directions: Vec<f32>,
}

impl Gradients {
    /// Samples `side * side` gradients around `centre` (pixels of the plane), `step` pixels apart, on axes rotated by
    /// `angle` (radians, x towards y).
    pub(super) fn sample(&mut self, plane: &Plane, centre: [f32; 2], step: f32, angle: f32, side: usize) {
        let wide = side + 2;
        let (sine, cosine) = (step * angle.sin(), step * angle.cos());
        let middle = 0.5 * (wide - 1) as f32;
        self.samples.clear();
        for row in 0..wide {
            let b = row as f32 - middle;
            self.samples.extend((0..wide).map(|column| {
                let a = column as f32 - middle;
                plane.bilinear(centre[0] + cosine * a - sine * b, centre[1] + sine * a + cosine * b)
            }));
        }
        self.lengths.clear();
        self.directions.clear();
        for row in 1..=side {
            let above = &self.samples[(row - 1) * wide + 1..];
            let here = &self.samples[row * wide..];
            let below = &self.samples[(row + 1) * wide + 1..];
            for column in 0..side {
                let (dx, dy) = (here[column + 2] - here[column], below[column] - above[column]);
                self.lengths.push((dx * dx + dy * dy).sqrt());
                self.directions.push(direction(dy, dx));
            }
        }
    }
}

/// `atan2(y, x)` in 0 to 2 pi, to 2e-3 radians; faster than the standard library, and identical on all platforms.
///
/// The arc tangent on 0 to 1 by the polynomial of Abramowitz & Stegun, 4.4.47, shortened.
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
