//! Selection of corners under a quota for each grid cell.

use super::corner::{Corner, CornerOptions};
use super::grid::Grid;
use super::score::{BORDER, Scorer};
use super::spacing::Spacing;
use crate::image::GrayImage;
use nalgebra::Vector2;

/// Detects corners in addition to existing points, strongest first within each pass.
///
/// Every grid cell has an equal quota of `wanted`. Cells below their quota are filled up to it first; the remaining
/// points come from the strongest corners left in the searched cells.
///
/// # Arguments
/// * `existing`: points that are tracked already, pixels. They count towards the quota of their cells.
/// * `mask`: no corner where it is zero. A mask whose size differs from the image's is ignored.
/// * `wanted`: total number of points, the existing ones included.
///
/// # Returns
/// At most `wanted - existing.len()` corners, at least `min_distance` pixels from each other and from `existing`.
///
/// # Example
/// ```
/// use vision::{CornerOptions, GrayImage, detect_corners};
///
/// let square = GrayImage::from_fn(120, 120, |x, y| {
///     if (40..80).contains(&x) && (40..80).contains(&y) { 200 } else { 50 }
/// });
/// let corners = detect_corners(&square, &[], None, 10, &CornerOptions::default());
/// assert_eq!(corners.len(), 4);
/// ```
pub fn detect_corners(
    image: &GrayImage,
    existing: &[Vector2<f32>],
    mask: Option<&GrayImage>,
    wanted: usize,
    options: &CornerOptions,
) -> Vec<Corner> {
    let missing = wanted.saturating_sub(existing.len());
    let (width, height) = (image.width(), image.height());
    if missing == 0 || width.min(height) <= 2 * BORDER {
        return Vec::new();
    }
    let mask = mask.filter(|mask| (mask.width(), mask.height()) == (width, height));
    let grid = Grid::new(image, options.cells);
    let quota = wanted.div_ceil(grid.cells());
    let mut occupied = vec![0usize; grid.cells()];
    let mut spacing = Spacing::new(image, options.min_distance);
    for point in existing {
        occupied[grid.cell_of(*point)] += 1;
        spacing.insert(*point);
    }
    let mut scorer = Scorer::default();
    let mut candidates = Vec::new();
    for (cell, count) in occupied.iter().enumerate() {
        if *count < quota {
            scorer.search(image, &grid.range(cell), options, mask, &mut candidates);
        }
    }
    candidates.sort_by(|a: &Corner, b| b.score.total_cmp(&a.score));
    let mut selected = Vec::with_capacity(missing);
    for limit in [quota, usize::MAX] {
        candidates.retain(|candidate| {
            let cell = grid.cell_of(candidate.pixel);
            if selected.len() == missing || occupied[cell] >= limit {
                return true;
            }
            if spacing.is_free(candidate.pixel) {
                spacing.insert(candidate.pixel);
                occupied[cell] += 1;
                selected.push(*candidate);
            }
            false
        });
    }
    selected
}
