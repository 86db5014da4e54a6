//! The rays of a camera's pixels.

use geometry::Camera;
use nalgebra::Vector2;

/// The undistorted ray of every pixel, computed once for a camera.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraRays {
    width: usize,
    height: usize,
    /// Normalized coordinates `(x / z, y / z)`, row after row; NaN where the camera model has no ray.
    rays: Vec<[f32; 2]>,
}

impl CameraRays {
    /// The rays of a camera. A pixel outside of the range of its distortion model sees nothing.
    pub fn new(camera: &Camera) -> Self {
        let (width, height) = (camera.width as usize, camera.height as usize);
        let ray = |index: usize| {
            let pixel = Vector2::new((index % width) as f64, (index / width) as f64);
            camera.unproject(&pixel).map_or([f32::NAN; 2], |ray| [ray.x as f32, ray.y as f32])
        };
        Self { width, height, rays: (0..width * height).map(ray).collect() }
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
}
