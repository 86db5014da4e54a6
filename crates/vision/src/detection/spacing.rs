//! Minimum distance between points.

use crate::image::GrayImage;
use nalgebra::Vector2;

/// Points in square bins, for queries by distance.
pub(crate) struct Spacing {
    distance: f32,
    across: usize,
    bins: Vec<Vec<Vector2<f32>>>,
}

impl Spacing {
    /// An empty set with a minimum distance in pixels (at least 1).
    pub(crate) fn new(image: &GrayImage, distance: f32) -> Self {
        let distance = distance.max(1.0);
        let count = |side: usize| (side as f32 / distance) as usize + 1;
        let across = count(image.width());
        Self { distance, across, bins: vec![Vec::new(); across * count(image.height())] }
    }

    fn bin(&self, point: Vector2<f32>) -> [usize; 2] {
        let index = |value: f32, count: usize| ((value / self.distance).max(0.0) as usize).min(count - 1);
        [index(point.x, self.across), index(point.y, self.bins.len() / self.across)]
    }

    /// Adds a point.
    pub(crate) fn insert(&mut self, point: Vector2<f32>) {
        let [x, y] = self.bin(point);
        self.bins[y * self.across + x].push(point);
    }

    /// Whether no point is closer than the minimum distance.
    pub(crate) fn is_free(&self, point: Vector2<f32>) -> bool {
        let [x, y] = self.bin(point);
        let down = self.bins.len() / self.across;
        for row in y.saturating_sub(1)..(y + 2).min(down) {
            for column in x.saturating_sub(1)..(x + 2).min(self.across) {
                let near =
                    |other: &Vector2<f32>| (other - point).norm_squared() < self.distance * self.distance;
                if self.bins[row * self.across + column].iter().any(near) {
                    return false;
                }
            }
        }
        true
    }
}
