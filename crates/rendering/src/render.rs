//! What a camera sees at one instant.

use super::body::PlacedBody;
use super::projected::{Met, Projected, RayRange};
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
        let steps = self.rays.steps((left + right) / 2, (top + bottom) / 2);
        for y in top..bottom {
            for x in left..right {
                let Some((index, met)) = self.nearest(self.rays.at(x, y)) else { continue };
                seen[y * width + x] = index;
                image.values[y * width + x] = self.facing[usize::from(index)].grey(&met, &steps);
            }
        }
    }

    /// Selects what may be in a part of the image.
    fn select(&mut self, left: usize, top: usize, right: usize, bottom: usize) {
        let (mut low, mut high) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
        for y in top..bottom {
            for x in left..right {
                let ray = self.rays.at(x, y);
                for axis in 0..2 {
                    // Neither is changed by NaN.
                    low[axis] = low[axis].min(ray[axis]);
                    high[axis] = high[axis].max(ray[axis]);
                }
            }
        }
        // Half a pixel more, for the rays beside the middle of a pixel.
        let margin = [0, 1].map(|axis| (high[axis] - low[axis]) / TILE as f32 + 1e-5);
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

    #[inline]
    fn nearest(&self, ray: [f32; 2]) -> Option<(u16, Met)> {
        let mut nearest: Option<(u16, Met)> = None;
        for index in &self.near {
            let than = nearest.as_ref().map_or(0.0, |(_, met)| met.inverse_depth);
            if let Some(met) = self.facing[usize::from(*index)].meets(ray, than) {
                nearest = Some((*index, met));
            }
        }
        nearest
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
                    let nearest = self.nearest(beside);
                    nearest.map_or(0.0, |(index, met)| self.facing[usize::from(index)].grey(&met, &steps))
                });
                image.values[at] = greys.iter().sum::<f32>() / greys.len() as f32;
            }
        }
    }
}
