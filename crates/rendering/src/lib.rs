//! Images of simulated cameras: textured rectangles, rendered by one ray a pixel.
//!
//! | module | what |
//! |---|---|
//! | `texture` | [`Texture`], a mip-mapped grey bitmap: seen from afar it is smoothed, and shows no false corners |
//! | `leaves` | [`random_texture`]: random shapes of all sizes that cover each other |
//! | `body` | [`Rectangle`]s, and the rooms and boxes that are made of them |
//! | `rays` | [`CameraRays`], the undistorted ray of every pixel |
//! | `projected` | a rectangle as linear functions of the ray |
//! | `render` | [`render`], what a camera sees at one instant |
//! | `sensor` | [`Radiance`], and the [`Sensor`] that makes an image of it: gain, noise, grey levels; [`exposed`], motion blur |
//!
//! Frames: a pose `world_from_camera` maps from the camera (x right, y down, z forward). Pixel `(0, 0)` is the centre of the
//! top-left pixel. Lengths are metres. The same input gives the same bytes.
//!
//! ```
//! use geometry::{Camera, Distortion, Pose};
//! use rendering::{Body, CameraRays, PlacedBody, Sensor};
//!
//! let room = Body::room([9.0, 7.0, 3.2], 1);
//! let camera =
//!     Camera { width: 64, height: 48, focal: [40.0; 2], centre: [31.5, 23.5], distortion: Distortion::None };
//! let scene = [PlacedBody { world_from_body: Pose::identity(), body: &room }];
//! let seen = rendering::render(&scene, &CameraRays::new(&camera), &Pose::identity());
//! let image = Sensor::default().image(&seen, 7);
//! assert_eq!((image.width(), image.height()), (64, 48));
//! ```
#![cfg_attr(test, allow(clippy::unwrap_used))]

mod body;
mod leaves;
mod projected;
mod rays;
mod render;
mod sensor;
mod texture;

pub use body::{Body, PlacedBody, Rectangle};
pub use leaves::random_texture;
pub use rays::CameraRays;
pub use render::render;
pub use sensor::{Radiance, Sensor, exposed};
pub use texture::Texture;
