//! What a camera sees at one instant.

use super::body::PlacedBody;
use super::projected::Projected;
use super::rays::{CameraRays, RayRange, Tile};
use super::sensor::Radiance;
use geometry::Pose;

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
    let fill = |tile| view.fill_tile(tile, &mut image, &mut seen);
    let filled: Vec<Option<u16>> = rays.tiles().iter().map(fill).collect();
    view.smooth_edges(&mut image, &seen, &filled);
    image
}

struct View<'a> {
    rays: &'a CameraRays,
    facing: &'a [Projected<'a>],
    /// Those that may be in the present tile.
    near: Vec<u16>,
}

impl View<'_> {
    /// Fills a part of the image.
    ///
    /// # Returns
    /// The rectangle that is all that is seen there.
    fn fill_tile(&mut self, tile: &Tile, image: &mut Radiance, seen: &mut [u16]) -> Option<u16> {
        let width = self.rays.width();
        let ([left, right], [top, bottom]) = (tile.columns, tile.rows);
        self.select(&tile.range);
        // Then no pixel has to ask for the nearest.
        let only = match self.near[..] {
            [index] if self.facing[usize::from(index)].fills(&tile.range) => Some(index),
            _ => None,
        };
        let steps = self.rays.steps(left.midpoint(right), top.midpoint(bottom));
        for y in top..bottom {
            let row = y * width + left..y * width + right;
            let (values, seen) = (&mut image.values[row.clone()], &mut seen[row]);
            let rays = self.rays.row(y, [left, right]);
            if let Some(index) = only {
                let wall = &self.facing[usize::from(index)];
                let texture = wall.smoothed(rays[0], wall.inverse_depth(rays[0]), &steps);
                seen.fill(index);
                for (value, ray) in values.iter_mut().zip(rays) {
                    *value = wall.grey(*ray, wall.inverse_depth(*ray), &texture);
                }
                continue;
            }
            // How smooth a rectangle looks hardly changes along a row of the tile.
            let mut last = None;
            for ((value, seen), ray) in values.iter_mut().zip(seen).zip(rays) {
                let Some((index, inverse_depth)) = self.nearest(*ray) else { continue };
                let seen_here = &self.facing[usize::from(index)];
                let texture = match last {
                    Some((of, texture)) if of == index => texture,
                    _ => seen_here.smoothed(*ray, inverse_depth, &steps),
                };
                last = Some((index, texture));
                *seen = index;
                *value = seen_here.grey(*ray, inverse_depth, &texture);
            }
        }
        only
    }

    /// Selects what may be in a part of the image.
    fn select(&mut self, range: &RayRange) {
        self.near.clear();
        self.near.extend(
            (0..self.facing.len() as u16).filter(|index| self.facing[usize::from(*index)].may_be_in(range)),
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
    ///
    /// # Arguments
    /// * `filled`: of each tile, the rectangle that is all that is seen there.
    fn smooth_edges(&mut self, image: &mut Radiance, seen: &[u16], filled: &[Option<u16>]) {
        let (width, height, tiles_a_row) = (self.rays.width(), self.rays.height(), self.rays.tiles_a_row());
        for (at, tile) in self.rays.tiles().iter().enumerate() {
            let is_like = |other: Option<usize>| {
                other.and_then(|other| filled.get(other)).is_none_or(|other| *other == filled[at])
            };
            let around =
                [at.checked_sub(1), Some(at + 1), at.checked_sub(tiles_a_row), Some(at + tiles_a_row)];
            // Neither it nor what is next to it has an edge.
            if filled[at].is_some() && around.into_iter().all(is_like) {
                continue;
            }
            for y in tile.rows[0]..tile.rows[1] {
                for x in tile.columns[0]..tile.columns[1] {
                    let pixel = y * width + x;
                    let differs = |other: usize| seen[other] != seen[pixel];
                    let is_edge = (x > 0 && differs(pixel - 1))
                        || (x + 1 < width && differs(pixel + 1))
                        || (y > 0 && differs(pixel - width))
                        || (y + 1 < height && differs(pixel + width));
                    if is_edge {
                        image.values[pixel] = self.smoothed_grey(x, y);
                    }
                }
            }
        }
    }

    /// The mean of several rays of a pixel.
    fn smoothed_grey(&mut self, x: usize, y: usize) -> f32 {
        self.select(&self.rays.range([x, x + 1], [y, y + 1]));
        let ray = self.rays.at(x, y);
        let steps = self.rays.steps(x, y);
        let greys = SUB_PIXELS.map(|[across, down]| {
            let beside = [0, 1].map(|axis| ray[axis] + across * steps[0][axis] + down * steps[1][axis]);
            self.nearest(beside).map_or(0.0, |(index, inverse_depth)| {
                let seen_here = &self.facing[usize::from(index)];
                let texture = seen_here.smoothed(beside, inverse_depth, &steps);
                seen_here.grey(beside, inverse_depth, &texture)
            })
        });
        greys.iter().sum::<f32>() / greys.len() as f32
    }
}
