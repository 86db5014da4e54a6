//! The rays of a camera's pixels.

use geometry::Camera;
use nalgebra::Vector2;

/// Rays of a part of the image: middle and half sides of a rectangle in normalized coordinates that has them and those of half a
/// pixel beside.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct RayRange {
    pub(crate) middle: [f32; 2],
    pub(crate) half: [f32; 2],
    /// Every pixel has a ray.
    pub(crate) is_whole: bool,
}

/// A square of pixels, or what is left of one at the border.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Tile {
    /// From one and to before another.
    pub(crate) columns: [usize; 2],
    pub(crate) rows: [usize; 2],
    pub(crate) range: RayRange,
}

/// Side of a tile, pixels.
const TILE: usize = 16;

/// The undistorted ray of every pixel, computed once for a camera.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraRays {
    width: usize,
    height: usize,
    /// Normalized coordinates `(x / z, y / z)`, row after row; NaN where the camera model has no ray.
    rays: Vec<[f32; 2]>,
    /// Tiles of the image, row after row.
    tiles: Vec<Tile>,
}

impl CameraRays {
    /// The rays of a camera. A pixel outside of the range of its distortion model sees nothing.
    pub fn new(camera: &Camera) -> Self {
        let (width, height) = (camera.width as usize, camera.height as usize);
        let ray = |index: usize| {
            let pixel = Vector2::new((index % width) as f64, (index / width) as f64);
            camera.unproject(&pixel).map_or([f32::NAN; 2], |ray| [ray.x as f32, ray.y as f32])
        };
        let rays = (0..width * height).map(ray).collect();
        let mut camera = Self { width, height, rays, tiles: Vec::new() };
        let parts = |side: usize| (0..side).step_by(TILE).map(move |from| [from, (from + TILE).min(side)]);
        let tile = |rows, columns| Tile { columns, rows, range: camera.range(columns, rows) };
        camera.tiles =
            parts(height).flat_map(|rows| parts(width).map(move |columns| tile(rows, columns))).collect();
        camera
    }

    /// Squares that the image is parted into, row after row.
    pub(crate) fn tiles(&self) -> &[Tile] {
        &self.tiles
    }

    /// How many tiles a row has.
    pub(crate) fn tiles_a_row(&self) -> usize {
        self.width.div_ceil(TILE)
    }

    /// Columns of the image.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows of the image.
    pub fn height(&self) -> usize {
        self.height
    }

    /// The ray of a pixel.
    #[inline]
    pub(crate) fn at(&self, x: usize, y: usize) -> [f32; 2] {
        self.rays[y * self.width + x]
    }

    /// How far apart the rays of neighbouring pixels are, along the row and down, at a pixel.
    pub(crate) fn steps(&self, x: usize, y: usize) -> [[f32; 2]; 2] {
        let between = |a: [f32; 2], b: [f32; 2], pixels: usize| {
            let pixels = pixels.max(1) as f32;
            [(b[0] - a[0]) / pixels, (b[1] - a[1]) / pixels]
        };
        let (left, right) = (x.saturating_sub(1), (x + 1).min(self.width - 1));
        let (above, below) = (y.saturating_sub(1), (y + 1).min(self.height - 1));
        [
            between(self.at(left, y), self.at(right, y), right - left),
            between(self.at(x, above), self.at(x, below), below - above),
        ]
    }

    /// The rays of a row from a column to before another one.
    #[inline]
    pub(crate) fn row(&self, y: usize, [left, right]: [usize; 2]) -> &[[f32; 2]] {
        &self.rays[y * self.width + left..y * self.width + right]
    }

    /// The rays of some columns and rows. It is NaN, which nothing is in, where none has a ray.
    pub(crate) fn range(&self, [left, right]: [usize; 2], [top, bottom]: [usize; 2]) -> RayRange {
        let (mut low, mut high) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
        let mut is_whole = true;
        for y in top..bottom {
            for ray in self.row(y, [left, right]) {
                is_whole &= !ray[0].is_nan();
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
        let steps = self.steps(left.midpoint(right), top.midpoint(bottom));
        let margin = [0, 1].map(|axis| (steps[0][axis].abs() + steps[1][axis].abs()).max(1e-5));
        RayRange {
            middle: [0, 1].map(|axis| 0.5 * (low[axis] + high[axis])),
            half: [0, 1].map(|axis| 0.5 * (high[axis] - low[axis]) + margin[axis]),
            is_whole,
        }
    }
}
