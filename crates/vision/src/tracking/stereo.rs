//! The second camera of a pair: finds there what the first one tracks.
//!
//! The search starts where the point would be at its distance of the image before, or at the usual distance in this
//! image. What was found must lie near the epipolar line of the pixel in the first image, and in front of both.

use super::lucas_kanade::{AlignmentOptions, Found, align_mutually};
use super::prediction::{Sight, predict};
use crate::pyramid::Pyramid;
use geometry::{Camera, Pose};
use nalgebra::Vector2;

/// Two calibrated cameras with a fixed pose to each other.
#[derive(Clone, Debug, PartialEq)]
pub struct StereoPair {
    /// The first camera.
    pub first: Camera,
    /// The second camera.
    pub second: Camera,
    /// Pose of the first camera in the frame of the second, metres.
    pub second_from_first: Pose,
}

/// Settings of [`StereoPair::find`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StereoOptions {
    /// Settings of the alignment.
    pub alignment: AlignmentOptions,
    /// Furthest from the epipolar line, pixels. Twice the noise of a track and what calibration leaves.
    pub max_epipolar_error: f64,
    /// Largest inverse depth to believe, 1/m.
    pub max_inverse_depth: f64,
}

impl Default for StereoOptions {
    fn default() -> Self {
        Self { alignment: AlignmentOptions::default(), max_epipolar_error: 1.5, max_inverse_depth: 5.0 }
    }
}

/// A point in the second camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StereoMatch {
    /// Where the second camera sees it, pixels.
    pub pixel: Vector2<f64>,
    /// Its inverse depth in the first camera, 1/m; 0 where it is too far to tell.
    pub inverse_depth: f64,
}

impl StereoPair {
    /// Looks for a pixel of the first camera in the second.
    ///
    /// # Arguments
    /// * `first`, `second`: what the cameras see at the same instant.
    /// * `guesses`: inverse depths (1/m) to start from, in this order until one leads to a match.
    ///
    /// # Returns
    /// None where nothing is there that fits.
    pub fn find(
        &self,
        first: &Pyramid,
        second: &Pyramid,
        pixel: Vector2<f64>,
        guesses: &[f64],
        options: &StereoOptions,
    ) -> Option<StereoMatch> {
        let sight = Sight::new(&self.first, pixel)?;
        guesses.iter().find_map(|inverse_depth| {
            let guess = predict(&self.first, &self.second, &self.second_from_first, &sight, *inverse_depth)?;
            let found = align_mutually(first, second, pixel.cast(), &guess, &options.alignment).ok()?;
            self.check(&sight, &found, options)
        })
    }

    /// What was found, if it lies on the epipolar line and in front of both cameras.
    fn check(&self, sight: &Sight, found: &Found, options: &StereoOptions) -> Option<StereoMatch> {
        let pixel: Vector2<f64> = found.warp.centre.cast();
        let normalized = self.second.unproject(&pixel).ok()?;
        let far = self.second_from_first.rotation * sight.normalized.push(1.0);
        let towards = self.second_from_first.translation;
        // The depth along the line far + inverse_depth * towards that is nearest in the second image.
        let (a, b) = (far.xy() - normalized * far.z, towards.xy() - normalized * towards.z);
        let inverse_depth = (-a.dot(&b) / b.norm_squared()).max(0.0);
        if inverse_depth.is_nan() || inverse_depth > options.max_inverse_depth {
            return None;
        }
        let nearest = self.second.project(&(far + towards * inverse_depth)).ok()?;
        ((nearest - pixel).norm() <= options.max_epipolar_error)
            .then_some(StereoMatch { pixel, inverse_depth })
    }
}
