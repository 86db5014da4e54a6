//! Parts of an image.

use geometry::Camera;

/// Columns and rows of the parts.
const GRIDS: [[usize; 2]; 4] = [[8, 6], [6, 4], [4, 3], [3, 2]];
/// Features that a part must have in the mean: with fewer, chance decides what can be confirmed in it.
const FEATURES_OF_A_PART: usize = 6;

/// The finest grid that the features of an image allow.
pub(super) struct Grid {
    /// Columns and rows.
    parts: [usize; 2],
    /// Of the image, pixels.
    size: [f64; 2],
    /// Of the camera, pixels.
    focal: [f64; 2],
}

impl Grid {
    /// The grid of an image that has so many features.
    pub fn of(camera: &Camera, features: usize) -> Self {
        let is_fit = |parts: &&[usize; 2]| parts[0] * parts[1] * FEATURES_OF_A_PART <= features;
        let parts = *GRIDS.iter().find(is_fit).unwrap_or(&GRIDS[GRIDS.len() - 1]);
        Self { parts, size: [camera.width, camera.height].map(f64::from), focal: camera.focal }
    }

    /// Number of parts.
    pub fn len(&self) -> usize {
        self.parts[0] * self.parts[1]
    }

    /// How many parts an area fills that faces the camera.
    ///
    /// # Arguments
    /// * `area`: square metres.
    /// * `depth`: metres.
    pub fn filled_by(&self, area: f64, depth: f64) -> f64 {
        let side = |axis: usize| self.size[axis] / self.parts[axis] as f64 / self.focal[axis] * depth;
        (area / (side(0) * side(1))).min(self.len() as f64)
    }

    /// How many pixels each part holds.
    pub fn count(&self, pixels: impl Iterator<Item = [f64; 2]>) -> Vec<usize> {
        let mut counts = vec![0; self.len()];
        for pixel in pixels {
            let at = |axis: usize| {
                let share = pixel[axis] / self.size[axis];
                ((share * self.parts[axis] as f64).max(0.0) as usize).min(self.parts[axis] - 1)
            };
            counts[at(1) * self.parts[0] + at(0)] += 1;
        }
        counts
    }
}
