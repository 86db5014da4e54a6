//! The grid that distributes corners over the image.

use crate::image::GrayImage;
use nalgebra::Vector2;
use std::ops::Range;

/// A grid of cells over an image.
pub(super) struct Grid {
    cells: [usize; 2],
    size: [usize; 2],
}

impl Grid {
    pub(super) fn new(image: &GrayImage, cells: [usize; 2]) -> Self {
        let size = [image.width(), image.height()];
        Self { cells: [cells[0].clamp(1, size[0]), cells[1].clamp(1, size[1])], size }
    }

    pub(super) fn cells(&self) -> usize {
        self.cells[0] * self.cells[1]
    }

    pub(super) fn cell_of(&self, point: Vector2<f32>) -> usize {
        let index = |value: f32, axis: usize| {
            let pixel = (value.round().max(0.0) as usize).min(self.size[axis] - 1);
            (pixel * self.cells[axis] / self.size[axis]).min(self.cells[axis] - 1)
        };
        index(point.y, 1) * self.cells[0] + index(point.x, 0)
    }

    /// Pixel ranges `[x, y]` of a cell.
    pub(super) fn range(&self, cell: usize) -> [Range<usize>; 2] {
        let along = |index: usize, axis: usize| {
            let bound = |k: usize| (k * self.size[axis]).div_ceil(self.cells[axis]);
            bound(index)..bound(index + 1)
        };
        [along(cell % self.cells[0], 0), along(cell / self.cells[0], 1)]
    }
}
