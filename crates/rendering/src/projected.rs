//! A rectangle as a camera sees it.
//!
//! A point of the plane `n . p = h` on the ray `z (x, y, 1)` has the inverse depth `w = (n . (x, y, 1)) / h`, which is linear in
//! the ray, and so are its coordinates on the plane times `w`. Whether a ray meets the rectangle needs no division, and
//! whether any ray of a part of the image does is a question about the corners of that part.

use super::body::Rectangle;
use super::rays::RayRange;
use super::texture::{SmoothedTexture, Texture};
use geometry::Pose;
use nalgebra::Vector3;

/// Rectangles meet without a gap although their edges are rounded, metres.
const OVERLAP_M: f32 = 1e-4;
/// A camera nearer than this to a plane does not see it, metres.
const MIN_DISTANCE_M: f64 = 1e-3;

/// A linear function of normalized coordinates: `by_x x + by_y y + constant`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Linear {
    by_x: f32,
    by_y: f32,
    constant: f32,
}

impl Linear {
    fn new(coefficients: &Vector3<f64>) -> Self {
        let [by_x, by_y, constant] = [0, 1, 2].map(|row| coefficients[row] as f32);
        Self { by_x, by_y, constant }
    }

    #[inline]
    fn at(self, [x, y]: [f32; 2]) -> f32 {
        self.by_x * x + self.by_y * y + self.constant
    }

    /// Its change along a step.
    fn change(self, step: [f32; 2]) -> f32 {
        self.by_x * step[0] + self.by_y * step[1]
    }

    fn max_over(self, range: &RayRange) -> f32 {
        self.at(range.middle) + self.spread_over(range)
    }

    fn min_over(self, range: &RayRange) -> f32 {
        self.at(range.middle) - self.spread_over(range)
    }

    fn spread_over(self, range: &RayRange) -> f32 {
        self.by_x.abs() * range.half[0] + self.by_y.abs() * range.half[1]
    }
}

/// A rectangle that faces the camera.
#[derive(Clone, Debug)]
pub(crate) struct Projected<'a> {
    /// Inverse depth, 1/m.
    inverse_depth: Linear,
    /// Coordinates on the rectangle times the inverse depth, and how much is left to the opposite side: none is negative
    /// where the rectangle is met.
    inside: [Linear; 4],
    texels_per_metre: [f32; 2],
    texture: &'a Texture,
    brightness: f32,
}

impl<'a> Projected<'a> {
    /// `None` where the camera is behind the rectangle.
    pub(crate) fn new(rectangle: &'a Rectangle, camera_from_body: &Pose) -> Option<Self> {
        let camera_from_rectangle = camera_from_body.compose(&rectangle.body_from_rectangle);
        let axis = |unit: Vector3<f64>| camera_from_rectangle.rotation * unit;
        let corner = camera_from_rectangle.translation;
        let normal = axis(Vector3::z());
        let distance = normal.dot(&corner);
        if distance < MIN_DISTANCE_M {
            return None;
        }
        let inverse_depth = normal / distance;
        let along = |direction: Vector3<f64>| direction - inverse_depth * direction.dot(&corner);
        let (u, v) = (along(axis(Vector3::x())), along(axis(Vector3::y())));
        let [width, height] = rectangle.size_m;
        let inside = [u, inverse_depth * width - u, v, inverse_depth * height - v];
        let [columns, rows] = rectangle.texture.size();
        Some(Self {
            inverse_depth: Linear::new(&inverse_depth),
            inside: inside.map(|linear| Linear::new(&linear)),
            texels_per_metre: [(columns as f64 / width) as f32, (rows as f64 / height) as f32],
            texture: &rectangle.texture,
            brightness: rectangle.brightness,
        })
    }

    /// Whether a ray of a part of the image may meet the rectangle.
    pub(crate) fn may_be_in(&self, range: &RayRange) -> bool {
        let nearest = self.inverse_depth.max_over(range);
        nearest > 0.0 && self.inside.iter().all(|linear| linear.max_over(range) >= -OVERLAP_M * nearest)
    }

    /// Whether every pixel of a part of the image has a ray that meets the rectangle.
    pub(crate) fn fills(&self, range: &RayRange) -> bool {
        range.is_whole
            && self.inverse_depth.min_over(range) > 0.0
            && self.inside.iter().all(|linear| linear.min_over(range) >= 0.0)
    }

    /// The inverse depth at which a ray meets the plane of the rectangle, 1/m.
    #[inline]
    pub(crate) fn inverse_depth(&self, ray: [f32; 2]) -> f32 {
        self.inverse_depth.at(ray)
    }

    /// The inverse depth (1/m) at which a ray meets the rectangle, if that is nearer than `than` (1/m, not negative).
    #[inline]
    pub(crate) fn meets(&self, ray: [f32; 2], than: f32) -> Option<f32> {
        let inverse_depth = self.inverse_depth.at(ray);
        let slack = -OVERLAP_M * inverse_depth;
        let [left, right, above, below] = &self.inside;
        // False for rays that are NaN.
        let is_met = inverse_depth > than
            && left.at(ray) >= slack
            && right.at(ray) >= slack
            && above.at(ray) >= slack
            && below.at(ray) >= slack;
        is_met.then_some(inverse_depth)
    }

    /// What a ray sees that meets the rectangle.
    ///
    /// # Arguments
    /// * `inverse_depth`: 1/m, of [`Projected::meets`].
    /// * `texture`: of [`Projected::smoothed`] at this ray or one near it.
    #[inline]
    pub(crate) fn grey(&self, ray: [f32; 2], inverse_depth: f32, texture: &SmoothedTexture<'_>) -> f32 {
        let depth = 1.0 / inverse_depth;
        let u = self.inside[0].at(ray) * depth * self.texels_per_metre[0];
        let v = self.inside[2].at(ray) * depth * self.texels_per_metre[1];
        self.brightness * texture.grey(u, v)
    }

    /// The texture as smooth as a pixel sees it whose ray meets the rectangle.
    ///
    /// # Arguments
    /// * `steps`: from this ray to those of the neighbouring pixels, along the row and down.
    pub(crate) fn smoothed(
        &self,
        ray: [f32; 2],
        inverse_depth: f32,
        steps: &[[f32; 2]; 2],
    ) -> SmoothedTexture<'a> {
        let depth = 1.0 / inverse_depth;
        // Texels from this pixel to its neighbour, squared.
        let moved = |step: [f32; 2]| {
            let nearer = self.inverse_depth.change(step);
            let along = |axis: usize| {
                let linear = self.inside[2 * axis];
                (linear.change(step) - linear.at(ray) * depth * nearer) * depth * self.texels_per_metre[axis]
            };
            along(0).powi(2) + along(1).powi(2)
        };
        let covered_squared = moved(steps[0]).max(moved(steps[1]));
        self.texture.at_level(0.5 * covered_squared.max(1e-6).log2())
    }
}
