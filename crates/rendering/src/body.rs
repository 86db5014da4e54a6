//! What can be seen: textured rectangles, and bodies that are made of them.

use super::leaves::random_texture;
use super::texture::Texture;
use geometry::Pose;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use std::sync::Arc;

/// Resolution of the textures of rooms and boxes. At 2 m a pixel of a camera with a focal length of 460 px covers one texel.
const TEXELS_PER_METRE: f32 = 230.0;
/// Brightness of surfaces that look along x, y and z, as if the light came from above and from one side.
const BRIGHTNESS: [f32; 3] = [0.94, 0.86, 1.0];

/// A textured rectangle, seen from one side.
///
/// # Coordinate systems
/// Its frame: x along the texture's rows, y down its columns, z away from the viewer; the origin is the texture's first
/// corner.
#[derive(Clone, Debug, PartialEq)]
pub struct Rectangle {
    /// The rectangle in the frame of its body.
    pub body_from_rectangle: Pose,
    /// Length along x and y, metres.
    pub size_m: [f64; 2],
    /// What is painted on it, over its whole size.
    pub texture: Arc<Texture>,
    /// Factor on the texture's grey levels.
    pub brightness: f32,
}

/// Rectangles that move together.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Body {
    /// The rectangles, in the frame of the body.
    pub rectangles: Vec<Rectangle>,
}

/// A body at its place.
#[derive(Clone, Copy, Debug)]
pub struct PlacedBody<'a> {
    /// The body in the world.
    pub world_from_body: Pose,
    /// The body.
    pub body: &'a Body,
}

impl Body {
    /// An empty room, seen from inside, with random textures that are all different.
    ///
    /// Its frame: the middle of the floor, z up.
    ///
    /// # Arguments
    /// * `size_m`: along x, y and z, metres; each positive.
    pub fn room(size_m: [f64; 3], seed: u64) -> Self {
        Self::sides(size_m, seed, 1.0)
    }

    /// A box, seen from outside, with random textures that are all different.
    ///
    /// Its frame: the middle of its lower side, z up.
    ///
    /// # Arguments
    /// * `size_m`: along x, y and z, metres; each positive.
    pub fn cuboid(size_m: [f64; 3], seed: u64) -> Self {
        Self::sides(size_m, seed, -1.0)
    }

    /// The six sides.
    ///
    /// # Arguments
    /// * `facing`: 1 where a side is seen against its outward normal, as from inside, -1 where along it.
    fn sides(size_m: [f64; 3], seed: u64, facing: f64) -> Self {
        let middle = Vector3::z() * (size_m[2] / 2.0);
        let side = |index: usize| {
            let (axis, sign) = (index / 2, if index.is_multiple_of(2) { 1.0 } else { -1.0 });
            let outward = Vector3::ith(axis, sign);
            // Away from the viewer; walls have the texture's rows level.
            let z = outward * facing;
            let y = if axis == 2 { Vector3::y() } else { -Vector3::z() };
            let x = y.cross(&z);
            let length = |direction: &Vector3<f64>| direction.abs().dot(&Vector3::from(size_m));
            let lengths = [length(&x), length(&y)];
            let corner =
                middle + outward * (length(&outward) / 2.0) - (x * lengths[0] + y * lengths[1]) / 2.0;
            let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, y, z]));
            let texels = lengths.map(|length| ((length as f32 * TEXELS_PER_METRE) as usize).max(2));
            let own_seed = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15).wrapping_add(index as u64);
            Rectangle {
                body_from_rectangle: Pose::new(UnitQuaternion::from_rotation_matrix(&rotation), corner),
                size_m: lengths,
                texture: Arc::new(random_texture(texels, TEXELS_PER_METRE, own_seed)),
                brightness: BRIGHTNESS[axis],
            }
        };
        // Each side takes a moment: on all processors.
        let rectangles = std::thread::scope(|scope| {
            let threads: Vec<_> = (0..6).map(|index| scope.spawn(move || side(index))).collect();
            threads.into_iter().filter_map(|thread| thread.join().ok()).collect()
        });
        Self { rectangles }
    }
}
