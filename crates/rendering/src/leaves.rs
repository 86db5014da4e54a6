//! Random textures: shapes of all sizes that fall on each other, as leaves do.
//!
//! With as much area for each octave of sizes, the picture looks alike from every distance, as natural images do: corners
//! are found at every scale, and no part occurs twice.
//!
//! Source: Lee, Mumford & Huang, "Occlusion models for natural images", IJCV 2001.

use super::texture::Texture;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use std::f32::consts::TAU;
use std::ops::Range;

/// Radii of the shapes, metres.
const RADII_M: [f32; 2] = [0.012, 0.5];
/// Every point would be covered so often, on average, if all shapes were discs; they have about half of their area.
const COVERAGE: f32 = 8.0;
/// Grey levels of the shapes: of a wall in a lit room, so that a gain of a third does not saturate.
const GREYS: [f32; 2] = [25.0, 190.0];
/// Largest change of grey from the middle of a shape to its border.
const SHADING: f32 = 18.0;
/// Beyond the border of a shape, texels: what is farther is not painted, with half a texel for rounding.
const MARGIN: f32 = 1.0;
/// Farther inside the border than this, texels, a shape hides what is below it: half a texel, with room for rounding.
const HIDES: f32 = 0.51;
/// Smallest part of a side's normal along a row with which the side bounds the row.
const LEAST_NORMAL: f32 = 1e-3;
/// Most sides of a shape.
const MAX_SIDES: usize = 6;

/// A convex shape.
struct Leaf {
    /// Centre, texels.
    centre: [f32; 2],
    /// Distance of the corners from the centre, texels.
    radius: f32,
    /// Normals of the sides and their distances from the centre, texels; a disc has none.
    sides: Vec<([f32; 2], f32)>,
    grey: f32,
    /// Change of grey a texel.
    slope: [f32; 2],
}

/// A random texture.
///
/// # Arguments
/// * `size`: `[columns, rows]`.
/// * `texels_per_metre`: the smallest shapes have a radius of 12 mm, the largest of 0.5 m.
///
/// # Panics
/// If a side is shorter than two texels.
pub fn random_texture(size: [usize; 2], texels_per_metre: f32, seed: u64) -> Texture {
    let mut rng = StdRng::seed_from_u64(seed);
    let [width, height] = size;
    let mut texels = vec![GREYS[0].midpoint(GREYS[1]) as u8; width * height];
    let radii = RADII_M.map(|radius| radius * texels_per_metre);
    // Density r^-3 between the two radii: the mean area of a shape is pi times the mean square of r.
    let [small, large] = radii;
    let mean_square = 2.0 * (large / small).ln() / (small.powi(-2) - large.powi(-2));
    let margin = large;
    let area = (width as f32 + 2.0 * margin) * (height as f32 + 2.0 * margin);
    let count = (COVERAGE * area / (std::f32::consts::PI * mean_square)) as usize;
    let mut distances = Vec::new();
    for _ in 0..count {
        let share: f32 = rng.random_range(0.0..1.0);
        let radius = (small.powi(-2) - share * (small.powi(-2) - large.powi(-2))).powf(-0.5);
        // From beyond the border, too, so that it is like the rest.
        let centre = [
            rng.random_range(0.0..width as f32 + 2.0 * margin) - margin,
            rng.random_range(0.0..height as f32 + 2.0 * margin) - margin,
        ];
        Leaf::random(&mut rng, centre, radius).paint(size, &mut texels, &mut distances);
    }
    Texture::from_texels(size, texels)
}

impl Leaf {
    fn random(rng: &mut StdRng, centre: [f32; 2], radius: f32) -> Self {
        let count = rng.random_range(2..=MAX_SIDES);
        let turn: f32 = rng.random_range(0.0..TAU);
        let sides = (0..count).filter(|_| count > 2).map(|side| {
            let angle = turn + (side as f32 + rng.random_range(-0.25..0.25)) * TAU / count as f32;
            let distance = radius * rng.random_range(0.4..0.8);
            ([angle.cos(), angle.sin()], distance)
        });
        let sides = sides.collect();
        let grey = rng.random_range(GREYS[0]..GREYS[1]);
        let (steep, angle): (f32, f32) =
            (rng.random_range(0.0..SHADING) / radius, rng.random_range(0.0..TAU));
        Self { centre, radius, sides, grey, slope: [steep * angle.cos(), steep * angle.sin()] }
    }

    /// Paints the shape over what is there; texels on its border are mixed.
    fn paint(&self, [width, height]: [usize; 2], texels: &mut [u8], distances: &mut Vec<f32>) {
        for row in
            texels_between(self.centre[1] - self.radius - 1.0, self.centre[1] + self.radius + 1.0, height)
        {
            let y = row as f32 + 0.5 - self.centre[1];
            let Some([from, to]) = self.extent(y) else { continue };
            let columns = texels_between(self.centre[0] + from, self.centre[0] + to, width);
            let inner = self.interior(y, &columns);
            let texels = &mut texels[row * width..][..width];
            for border in [columns.start..inner.start, inner.end..columns.end] {
                self.distances(y, border.start as f32 + 0.5, border.len(), distances);
                for ((column, texel), distance) in border.clone().zip(&mut texels[border]).zip(&*distances) {
                    let opacity = (0.5 - *distance).clamp(0.0, 1.0);
                    if opacity > 0.0 {
                        *texel = self.mixed(*texel, column, y, opacity);
                    }
                }
            }
            for (column, texel) in inner.clone().zip(&mut texels[inner]) {
                *texel = self.mixed(*texel, column, y, 1.0);
            }
        }
    }

    /// A texel with the shape over it.
    #[inline]
    fn mixed(&self, texel: u8, column: usize, y: f32, opacity: f32) -> u8 {
        let x = column as f32 + 0.5 - self.centre[0];
        let grey = self.grey + self.slope[0] * x + self.slope[1] * y;
        let before = f32::from(texel);
        (before + opacity * (grey - before)).clamp(0.0, 255.0) as u8
    }

    /// The columns among some in which the shape hides what is below it, in the row `y`; empty at their end where there are none.
    fn interior(&self, y: f32, columns: &Range<usize>) -> Range<usize> {
        let none = columns.end..columns.end;
        let reach = self.radius - HIDES;
        if reach <= y.abs() {
            return none;
        }
        let half = (reach * reach - y * y).sqrt();
        let [mut from, mut to] = [-half, half];
        for ([nx, ny], distance) in &self.sides {
            let room = distance - HIDES - ny * y;
            if *nx > LEAST_NORMAL {
                to = to.min(room / nx);
            } else if *nx < -LEAST_NORMAL {
                from = from.max(room / nx);
            } else if room < LEAST_NORMAL * self.radius {
                return none;
            }
        }
        let begin = ((self.centre[0] + from - 0.5).ceil().max(0.0) as usize).max(columns.start);
        let end = ((self.centre[0] + to + 0.5).floor().max(0.0) as usize).min(columns.end);
        if begin < end { begin..end } else { none }
    }

    /// Range of `x` in the row `y` that the shape covers, with a texel of margin; `None` where it covers nothing.
    fn extent(&self, y: f32) -> Option<[f32; 2]> {
        let reach = self.radius + MARGIN;
        let half = (reach * reach - y * y).max(0.0).sqrt();
        let [mut from, mut to] = [-half, half];
        for ([nx, ny], distance) in &self.sides {
            let room = distance + MARGIN - ny * y;
            // One that is nearly parallel to the row bounds no part of it.
            if *nx > LEAST_NORMAL {
                to = to.min(room / nx);
            } else if *nx < -LEAST_NORMAL {
                from = from.max(room / nx);
            }
        }
        (from <= to).then_some([from, to])
    }

    /// Distances to the border, texels, negative inside, of the texels of a row beginning with that at `first_x`.
    fn distances(&self, y: f32, first_x: f32, count: usize, distances: &mut Vec<f32>) {
        let x = |index: usize| first_x + index as f32 - self.centre[0];
        distances.clear();
        distances.extend((0..count).map(|index| (x(index) * x(index) + y * y).sqrt() - self.radius));
        for ([nx, ny], distance) in &self.sides {
            for (index, largest) in distances.iter_mut().enumerate() {
                *largest = largest.max(nx * x(index) + ny * y - distance);
            }
        }
    }
}

/// The texels of a row or column of so many whose middles are between two coordinates.
fn texels_between(from: f32, to: f32, count: usize) -> Range<usize> {
    let begin = (from.max(0.0) as usize).min(count);
    begin..((to + 1.0).max(0.0) as usize).clamp(begin, count)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_texels_that_a_shape_does_not_reach_are_all_that_is_skipped() {
        let size = [90, 70];
        let mut rng = StdRng::seed_from_u64(2);
        let (mut painted, mut expected) = (vec![100; size[0] * size[1]], vec![100; size[0] * size[1]]);
        for _ in 0..300 {
            let centre = [rng.random_range(-20.0..110.0), rng.random_range(-20.0..90.0)];
            let radius = rng.random_range(1.0..40.0);
            let leaf = Leaf::random(&mut rng, centre, radius);
            leaf.paint(size, &mut painted, &mut Vec::new());
            for (index, texel) in expected.iter_mut().enumerate() {
                let at = |index: usize, axis: usize| index as f32 + 0.5 - centre[axis];
                let (x, y) = (at(index % size[0], 0), at(index / size[0], 1));
                let sides = leaf.sides.iter().map(|([nx, ny], distance)| nx * x + ny * y - distance);
                let distance = sides.fold((x * x + y * y).sqrt() - leaf.radius, f32::max);
                let opacity = (0.5 - distance).clamp(0.0, 1.0);
                let grey = leaf.grey + leaf.slope[0] * x + leaf.slope[1] * y;
                let before = f32::from(*texel);
                *texel = (before + opacity * (grey - before)).clamp(0.0, 255.0) as u8;
            }
            assert_eq!(painted, expected);
        }
    }

    #[test]
    fn a_texture_is_its_seed_s_and_has_contrast_at_every_scale() {
        let size = [400, 300];
        let texture = random_texture(size, 250.0, 3);
        assert_eq!(texture, random_texture(size, 250.0, 3));
        assert_ne!(texture, random_texture(size, 250.0, 4));
        for level in 0..5_usize {
            let step = 1 << level;
            let at = |u: usize, v: usize| texture.sample(u as f32, v as f32, level as f32);
            let (mut squares, mut count) = (0.0, 0.0);
            for v in (0..size[1]).step_by(step) {
                for u in (0..size[0] - step).step_by(step) {
                    squares += (at(u + step, v) - at(u, v)).powi(2);
                    count += 1.0;
                }
            }
            let contrast = f32::sqrt(squares / count);
            assert!((6.0..60.0).contains(&contrast), "{contrast} at level {level}");
        }
    }
}
