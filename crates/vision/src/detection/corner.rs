//! A corner, and the settings of the detector.

use nalgebra::Vector2;

/// Settings of [`super::detect_corners`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CornerOptions {
    /// Grid cells `[columns, rows]`.
    pub cells: [usize; 2],
    /// Minimum distance between two points, pixels.
    pub min_distance: f32,
    /// Minimum score of a corner, (grey levels / px)^2. Noise of one grey level scores about 0.3.
    pub min_score: f32,
    /// Margin at the image border without corners, pixels: a patch around a corner must lie inside the image.
    pub margin: f32,
}

impl Default for CornerOptions {
    /// Square cells of 94 x 96 pixels on a 752 x 480 image.
    fn default() -> Self {
        Self { cells: [8, 5], min_distance: 16.0, min_score: 12.0, margin: 10.0 }
    }
}

/// A corner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Corner {
    /// Sub-pixel position; (0, 0) is the centre of the top-left pixel.
    pub pixel: Vector2<f32>,
    /// Score, (grey levels / px)^2.
    pub score: f32,
}
