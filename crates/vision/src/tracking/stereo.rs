//! Stereo matching: points of the first camera in the second.
//!
//! The search starts at the inverse depth of the previous image or at the median of this image. A match must lie near
//! the epipolar line of the pixel and in front of both cameras.

use super::lucas_kanade::{Aligner, Alignment, AlignmentOptions};
use super::prediction::{Ray, predict};
use crate::image::Pyramid;
use geometry::{Camera, Pose};
use nalgebra::Vector2;

/// A calibrated stereo pair.
///
/// # Coordinate systems
/// `second_from_first` maps coordinates of the first camera frame to the second (x right, y down, z forward, metres).
#[derive(Clone, Debug, PartialEq)]
pub struct StereoPair {
    /// The first camera.
    pub first: Camera,
    /// The second camera.
    pub second: Camera,
    /// Pose of the first camera in the frame of the second.
    pub second_from_first: Pose,
}

/// Settings of [`StereoPair::find`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StereoOptions {
    /// Settings of the alignment.
    pub alignment: AlignmentOptions,
    /// Maximum distance to the epipolar line, pixels: twice the noise of a track, plus calibration errors.
    pub max_epipolar_error: f64,
    /// Maximum inverse depth, 1/m.
    pub max_inverse_depth: f64,
}

impl Default for StereoOptions {
    fn default() -> Self {
        Self { alignment: AlignmentOptions::default(), max_epipolar_error: 1.5, max_inverse_depth: 5.0 }
    }
}

/// A match in the second camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StereoMatch {
    /// Distorted pixel in the second camera.
    pub pixel: Vector2<f64>,
    /// Inverse depth in the first camera, 1/m; 0 at infinity.
    pub inverse_depth: f64,
}

impl StereoPair {
    /// Finds a pixel of the first camera in the second.
    ///
    /// # Arguments
    /// * `first`, `second`: images of both cameras at the same time.
    /// * `pixel`: distorted pixel in the first image.
    /// * `guesses`: initial inverse depths (1/m), tried in this order until one leads to a match.
    ///
    /// # Returns
    /// `None` without a match that satisfies the epipolar constraint.
    pub fn find(
        &self,
        first: &Pyramid,
        second: &Pyramid,
        pixel: Vector2<f64>,
        guesses: &[f64],
        options: &StereoOptions,
    ) -> Option<StereoMatch> {
        self.find_by(&mut Aligner::new(), [first, second], pixel, guesses, options)
    }

    /// [`StereoPair::find`] with the memory of alignments before.
    pub(super) fn find_by(
        &self,
        aligner: &mut Aligner,
        images: [&Pyramid; 2],
        pixel: Vector2<f64>,
        guesses: &[f64],
        options: &StereoOptions,
    ) -> Option<StereoMatch> {
        let ray = Ray::new(&self.first, pixel)?;
        guesses.iter().find_map(|inverse_depth| {
            let guess = predict(&self.first, &self.second, &self.second_from_first, &ray, *inverse_depth)?;
            let alignment = &options.alignment;
            let found = aligner.align_with_backward_check(images, pixel.cast(), &guess, alignment).ok()?;
            self.check(&ray, &found, options)
        })
    }

    /// The match, if it satisfies the epipolar constraint and lies in front of both cameras.
    fn check(&self, ray: &Ray, found: &Alignment, options: &StereoOptions) -> Option<StereoMatch> {
        let pixel: Vector2<f64> = found.warp.centre.cast();
        let normalized = self.second.unproject(&pixel).ok()?;
        let far = self.second_from_first.rotation * ray.normalized.push(1.0);
        let towards = self.second_from_first.translation;
        // The inverse depth whose point on the line `far + inverse_depth * towards` is nearest in the second image.
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
