//! Images of a continuous texture under known motion: the truth about every pixel is exact.
#![allow(dead_code, reason = "each test program uses its part")]

use nalgebra::{Matrix2, Vector2};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use vision::GrayImage;

/// EuRoC's image size.
pub const SIZE: [usize; 2] = [752, 480];

/// A smooth random function of the plane: values of lattices of several widths, blended.
pub struct Texture {
    lattices: Vec<(f64, f64, Vec<f64>)>,
}

const LATTICE: usize = 256;

impl Texture {
    pub fn new(seed: u64) -> Self {
        let mut random = StdRng::seed_from_u64(seed);
        let octaves = [(64.0, 35.0), (27.0, 30.0), (12.0, 25.0), (6.0, 15.0)];
        let lattices = octaves
            .iter()
            .map(|(width, amplitude)| {
                let values = (0..LATTICE * LATTICE).map(|_| random.random_range(-1.0..1.0)).collect();
                (*width, *amplitude, values)
            })
            .collect();
        Self { lattices }
    }

    /// Grey level at a point of the plane, 23 to 233.
    pub fn at(&self, x: f64, y: f64) -> f64 {
        let mut sum = 128.0;
        for (width, amplitude, values) in &self.lattices {
            let (u, v) = (x / width + 100.3, y / width + 100.7);
            let (i, j) = (u.floor(), v.floor());
            let smooth = |t: f64| t * t * t * (t * (6.0 * t - 15.0) + 10.0);
            let (s, t) = (smooth(u - i), smooth(v - j));
            let value = |di: i64, dj: i64| {
                let column = (i as i64 + di).rem_euclid(LATTICE as i64) as usize;
                let row = (j as i64 + dj).rem_euclid(LATTICE as i64) as usize;
                values[row * LATTICE + column]
            };
            let upper = value(0, 0) + s * (value(1, 0) - value(0, 0));
            let lower = value(0, 1) + s * (value(1, 1) - value(0, 1));
            sum += amplitude * (upper + t * (lower - upper));
        }
        sum
    }
}

/// A similarity of the image plane about its centre, then a shift; and a change of brightness.
#[derive(Clone, Copy, Debug)]
pub struct Motion {
    pub shift: [f64; 2],
    pub degrees: f64,
    pub zoom: f64,
    pub gain: f64,
    pub bias: f64,
}

impl Motion {
    pub const NONE: Self = Self { shift: [0.0; 2], degrees: 0.0, zoom: 1.0, gain: 1.0, bias: 0.0 };

    pub fn shifted(x: f64, y: f64) -> Self {
        Self { shift: [x, y], ..Self::NONE }
    }

    pub fn linear(&self) -> Matrix2<f64> {
        let (sin, cos) = self.degrees.to_radians().sin_cos();
        Matrix2::new(cos, -sin, sin, cos) * self.zoom
    }

    fn centre() -> Vector2<f64> {
        Vector2::new(SIZE[0] as f64, SIZE[1] as f64) / 2.0
    }

    /// Where a pixel of the first image is in the second.
    pub fn map(&self, pixel: Vector2<f64>) -> Vector2<f64> {
        self.linear() * (pixel - Self::centre()) + Self::centre() + Vector2::from(self.shift)
    }

    fn unmap(&self, pixel: Vector2<f64>) -> Vector2<f64> {
        let inverse = self.linear().try_inverse().unwrap();
        inverse * (pixel - Self::centre() - Vector2::from(self.shift)) + Self::centre()
    }

    /// The second image of a source that is a function of the first image's pixels, with noise of one grey level.
    pub fn render(&self, source: impl Fn(f64, f64) -> f64, seed: u64) -> GrayImage {
        let mut random = StdRng::seed_from_u64(seed);
        GrayImage::from_fn(SIZE[0], SIZE[1], |x, y| {
            let from = self.unmap(Vector2::new(x as f64, y as f64));
            // The sum of three uniform numbers in +-1 has a variance of one.
            let noise: f64 = (0..3).map(|_| random.random_range(-1.0..1.0)).sum();
            (self.gain * source(from.x, from.y) + self.bias + noise).round().clamp(0.0, 255.0) as u8
        })
    }
}
