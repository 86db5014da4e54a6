//! What a camera sees at one instant.

use super::body::PlacedBody;
use super::projected::{Projected, RayRange};
use super::rays::CameraRays;
use super::sensor::Radiance;
use geometry::Pose;

/// Side of the squares of pixels for which the rectangles in sight are selected.
const TILE: usize = 16;
/// Where a pixel sees two rectangles, rays at these parts of a pixel from its middle are averaged.
const SUB_PIXELS: [[f32; 2]; 4] = [[-0.375, -0.125], [0.125, -0.375], [0.375, 0.125], [-0.125, 0.375]];
/// Index of no rectangle.
const NOTHING: u16 = u16::MAX;

/// Renders what a camera sees. Where it sees no body it is black.
///
/// # Arguments
/// * `bodies`: opaque; the nearest is seen.
/// * `world_from_camera`: x right, y down, z forward.
pub fn render(bodies: &[PlacedBody<'_>], rays: &CameraRays, world_from_camera: &Pose) -> Radiance {
    let camera_from_world = world_from_camera.inverse();
    let facing = bodies.iter().flat_map(|placed| {
        let camera_from_body = camera_from_world.compose(&placed.world_from_body);
        placed
            .body
            .rectangles
            .iter()
            .filter_map(move |rectangle| Projected::new(rectangle, &camera_from_body))
    });
    let facing: Vec<Projected<'_>> = facing.collect();
    let mut image = Radiance::black(rays.width(), rays.height());
    let mut seen = vec![NOTHING; rays.width() * rays.height()];
    let mut view = View { rays, facing: &facing, near: Vec::new() };
    for top in (0..rays.height()).step_by(TILE) {
        for left in (0..rays.width()).step_by(TILE) {
            view.fill_tile(left, top, &mut image, &mut seen);
        }
    }
    view.smooth_edges(&mut image, &seen);
    image
}

struct View<'a> {
    rays: &'a CameraRays,
    facing: &'a [Projected<'a>],
    /// Those that may be in the present tile.
    near: Vec<u16>,
}

impl View<'_> {
    fn fill_tile(&mut self, left: usize, top: usize, image: &mut Radiance, seen: &mut [u16]) {
        let (width, height) = (self.rays.width(), self.rays.height());
        let (right, bottom) = ((left + TILE).min(width), (top + TILE).min(height));
        self.select(left, top, right, bottom);
        let steps = self.rays.steps(left.midpoint(right), top.midpoint(bottom));
        for y in top..bottom {
            // How smooth a rectangle looks hardly changes along a row of the tile.
            let mut last = None;
            for x in left..right {
                let ray = self.rays.at(x, y);
                let Some((index, inverse_depth)) = self.nearest(ray) else { continue };
                let seen_here = &self.facing[usize::from(index)];
                let texture = match last {
                    Some((of, texture)) if of == index => texture,
                    _ => seen_here.smoothed(ray, inverse_depth, &steps),
                };
                last = Some((index, texture));
                seen[y * width + x] = index;
                image.values[y * width + x] = seen_here.grey(ray, inverse_depth, &texture);
            }
        }
    }

    /// Selects what may be in a part of the image.
    fn select(&mut self, left: usize, top: usize, right: usize, bottom: usize) {
        let (mut low, mut high) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
        for y in top..bottom {
            for x in left..right {
                let ray = self.rays.at(x, y);
                // NaN changes neither.
                for axis in 0..2 {
                    if ray[axis] < low[axis] {
                        low[axis] = ray[axis];
                    }
                    if ray[axis] > high[axis] {
                        high[axis] = ray[axis];
                    }
                }
            }
        }
        // A pixel more, for the rays beside the middle of a pixel.
        let steps = self.rays.steps(left.midpoint(right), top.midpoint(bottom));
        let margin = [0, 1].map(|axis| (steps[0][axis].abs() + steps[1][axis].abs()).max(1e-5));
        let range = RayRange {
            middle: [0, 1].map(|axis| 0.5 * (low[axis] + high[axis])),
            half: [0, 1].map(|axis| 0.5 * (high[axis] - low[axis]) + margin[axis]),
        };
        self.near.clear();
        self.near.extend(
            (0..self.facing.len() as u16)
                .filter(|index| low[0] <= high[0] && self.facing[usize::from(*index)].may_be_in(&range)),
        );
    }

    /// The rectangle that a ray meets first, and its inverse depth there, 1/m.
    #[inline]
    fn nearest(&self, ray: [f32; 2]) -> Option<(u16, f32)> {
        let (mut nearest, mut inverse_depth) = (None, 0.0);
        for index in &self.near {
            if let Some(nearer) = self.facing[usize::from(*index)].meets(ray, inverse_depth) {
                (nearest, inverse_depth) = (Some(*index), nearer);
            }
        }
        nearest.map(|index| (index, inverse_depth))
    }

    /// Averages several rays where neighbouring pixels see different rectangles, so that edges have no steps.
    fn smooth_edges(&mut self, image: &mut Radiance, seen: &[u16]) {
        let (width, height) = (self.rays.width(), self.rays.height());
        for y in 0..height {
            for x in 0..width {
                let at = y * width + x;
                let differs = |other: usize| seen[other] != seen[at];
                let is_edge = (x > 0 && differs(at - 1))
                    || (x + 1 < width && differs(at + 1))
                    || (y > 0 && differs(at - width))
                    || (y + 1 < height && differs(at + width));
                if !is_edge {
                    continue;
                }
                self.select(x, y, x + 1, y + 1);
                let ray = self.rays.at(x, y);
                let steps = self.rays.steps(x, y);
                let greys = SUB_PIXELS.map(|[across, down]| {
                    let beside =
                        [0, 1].map(|axis| ray[axis] + across * steps[0][axis] + down * steps[1][axis]);
                    self.nearest(beside).map_or(0.0, |(index, inverse_depth)| {
                        let seen_here = &self.facing[usize::from(index)];
                        let texture = seen_here.smoothed(beside, inverse_depth, &steps);
                        seen_here.grey(beside, inverse_depth, &texture)
                    })
                });
                image.values[at] = greys.iter().sum::<f32>() / greys.len() as f32;
            }
        }
    }
}
