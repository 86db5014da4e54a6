//! Swapped images of a stereo pair, recognized from matches: with the cameras exchanged, points lie behind them.

use super::{CameraSensor, Frame, SequenceError, camera_groups};
use geometry::camera::Camera;
use geometry::pose::Pose;
use nalgebra::{Matrix2, Vector2, Vector3};
use vision::features::classical::SiftExtractor;
use vision::{DescriptorView, FeatureExtractor, GrayImage, ImageFeatures, MatchOptions, match_descriptors};

/// Every so many stereo frames one is looked at, until the answer is clear.
const STRIDE: usize = 20;
/// Frames that are looked at.
const FRAMES: usize = 5;
/// Features of an image.
const FEATURES: usize = 400;
/// A match agrees with a pair of cameras when its rays pass each other within this angle, in pixels.
const MAX_ERROR_PX: f64 = 3.0;
/// Matches with less parallax say nothing about the order of the cameras, pixels.
const MIN_PARALLAX_PX: f64 = 2.0;
/// Fewest matches for an answer.
const MIN_MATCHES: usize = 30;
/// An order is taken for right when so many times more matches agree with it.
const MAJORITY: usize = 4;

/// Checks that the images of no stereo pair are swapped.
///
/// Features of a few early images are matched; a match agrees with an order of the cameras when its rays meet in front of
/// both. Recordings without stereo pairs, without images or with too few matches pass.
///
/// # Arguments
/// * `frames`: opens the frames; called once for each stereo pair.
///
/// # Errors
/// [`SequenceError::SwappedCameras`]; those of `frames`.
pub fn check_stereo<F: IntoIterator<Item = Result<Frame, SequenceError>>>(
    cameras: &[CameraSensor],
    frames: impl Fn() -> Result<F, SequenceError>,
) -> Result<(), SequenceError> {
    for group in camera_groups(cameras) {
        if let Some(second) = group.second {
            check_pair(cameras, [group.first, second], frames()?)?;
        }
    }
    Ok(())
}

fn check_pair(
    cameras: &[CameraSensor],
    pair_of: [usize; 2],
    frames: impl IntoIterator<Item = Result<Frame, SequenceError>>,
) -> Result<(), SequenceError> {
    let [first, second] = pair_of.map(|camera| &cameras[camera]);
    let second_from_first = second.imu_from_camera.inverse() * first.imu_from_camera;
    let pair = StereoPair { first: &first.camera, second: &second.camera, second_from_first };
    let mut extractor = SiftExtractor::default();
    let (mut as_given, mut as_swapped, mut stereo_frames) = (0, 0, 0);
    for frame in frames {
        let frame = frame?;
        let [Some(left), Some(right)] = pair_of.map(|camera| frame.images.get(&camera)) else { continue };
        stereo_frames += 1;
        if (stereo_frames - 1) % STRIDE != 0 {
            continue;
        }
        if stereo_frames > STRIDE * FRAMES {
            break;
        }
        // Images that cannot be read are left to their reader.
        let (Ok(left), Ok(right)) = (left.read(), right.read()) else { continue };
        for (a, b) in matches(&mut extractor, &left, &right) {
            as_given += usize::from(pair.agrees(&a, &b));
            as_swapped += usize::from(pair.agrees(&b, &a));
        }
        if as_given >= MIN_MATCHES && as_given >= MAJORITY * as_swapped {
            return Ok(());
        }
    }
    if as_swapped >= MIN_MATCHES && as_swapped >= MAJORITY * as_given {
        return Err(SequenceError::SwappedCameras { cameras: pair_of, as_given, as_swapped });
    }
    Ok(())
}

/// Pixels of features that look alike in both images.
fn matches(
    extractor: &mut SiftExtractor,
    left: &GrayImage,
    right: &GrayImage,
) -> Vec<(Vector2<f64>, Vector2<f64>)> {
    let mut extract = |image| extractor.extract(image, None, FEATURES).ok();
    let (Some(left), Some(right)) = (extract(left), extract(right)) else { return Vec::new() };
    let found = DescriptorView::new(left.metric, left.width, &left.descriptors).and_then(|query| {
        let train = DescriptorView::new(right.metric, right.width, &right.descriptors)?;
        match_descriptors(query, train, &MatchOptions::for_metric(left.metric))
    });
    let pixel =
        |features: &ImageFeatures, at: usize| Vector2::from(features.keypoints[at].pixel.map(f64::from));
    let pixels = |found: &vision::Match| (pixel(&left, found.query), pixel(&right, found.train));
    found.map(|found| found.iter().map(pixels).collect()).unwrap_or_default()
}

struct StereoPair<'a> {
    first: &'a Camera,
    second: &'a Camera,
    second_from_first: Pose,
}

impl StereoPair<'_> {
    /// Whether the rays of two pixels meet in front of both cameras, with parallax.
    fn agrees(&self, in_first: &Vector2<f64>, in_second: &Vector2<f64>) -> bool {
        let (Ok(a), Ok(b)) = (self.first.unproject(in_first), self.second.unproject(in_second)) else {
            return false;
        };
        let focal = f64::midpoint(self.second.focal[0], self.second.focal[1]);
        let a: Vector3<f64> = (self.second_from_first.rotation * a.push(1.0)).normalize();
        let b: Vector3<f64> = b.push(1.0).normalize();
        let baseline = self.second_from_first.translation;
        // The depths x, y with x a + baseline = y b, by least squares.
        let cosine = a.dot(&b);
        let normal = Matrix2::new(1.0, -cosine, -cosine, 1.0);
        let Some(inverse) = normal.try_inverse() else { return false };
        let depths = inverse * Vector2::new(-a.dot(&baseline), b.dot(&baseline));
        let point = a * depths.x + baseline;
        let error_px = focal * point.angle(&b);
        let parallax_px = focal * a.angle(&b);
        depths.min() > 0.0 && error_px < MAX_ERROR_PX && parallax_px > MIN_PARALLAX_PX
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ImageData;
    use geometry::camera::Distortion;
    use nalgebra::UnitQuaternion;
    use std::collections::BTreeMap;

    const FOCAL: f64 = 300.0;
    const BASELINE_M: f64 = 0.1;

    fn cameras() -> Vec<CameraSensor> {
        let camera = Camera {
            width: 320,
            height: 240,
            focal: [FOCAL, FOCAL],
            centre: [160.0, 120.0],
            distortion: Distortion::None,
        };
        let at = |x: f64| {
            let mounted = Pose::new(UnitQuaternion::identity(), Vector3::x() * x);
            CameraSensor::new(camera.clone(), mounted, 20.0)
        };
        vec![at(0.0), at(BASELINE_M)]
    }

    /// A smooth random texture.
    fn texture(x: f64, y: f64) -> f64 {
        let noise = |i: i64, j: i64| {
            let mut hash = (i.wrapping_mul(0x9e37_79b9) ^ j.wrapping_mul(0x85eb_ca6b)) as u64;
            hash = (hash ^ (hash >> 15)).wrapping_mul(0x2c1b_3c6d);
            ((hash ^ (hash >> 12)) % 256) as f64
        };
        let (i, j) = (x.floor(), y.floor());
        let (u, v) = (x - i, y - j);
        let (i, j) = (i as i64, j as i64);
        let row = |j: i64| noise(i, j) * (1.0 - u) + noise(i + 1, j) * u;
        row(j) * (1.0 - v) + row(j + 1) * v
    }

    /// Two walls, the upper one at 2 m and the lower one at 4 m, seen from `x` metres to the right.
    fn image(x: f64) -> ImageData {
        let pixel = |column: usize, row: usize| {
            let depth = if row < 120 { 2.0 } else { 4.0 };
            let shifted = column as f64 + FOCAL * x / depth;
            texture(shifted / 6.0, row as f64 / 6.0) as u8
        };
        ImageData::from(GrayImage::from_fn(320, 240, pixel))
    }

    fn check(cameras: &[CameraSensor], images: &[&ImageData]) -> Result<(), SequenceError> {
        let images: BTreeMap<usize, ImageData> = images.iter().copied().cloned().enumerate().collect();
        let frame = |index| Frame { stamp_ns: index, images: images.clone(), ..Frame::default() };
        check_stereo(cameras, || Ok((0..30).map(|index| Ok(frame(index)))))
    }

    #[test]
    fn swapped_images_are_recognized_and_right_ones_pass() {
        let (left, right) = (image(0.0), image(BASELINE_M));
        check(&cameras(), &[&left, &right]).unwrap();
        let swapped = check(&cameras(), &[&right, &left]).unwrap_err();
        assert!(matches!(swapped, SequenceError::SwappedCameras { .. }), "{swapped}");
        // What says nothing passes: one camera, one image, the same image twice.
        check(&cameras()[..1], &[&left]).unwrap();
        check(&cameras(), &[&left]).unwrap();
        check(&cameras(), &[&left, &left]).unwrap();
    }
}
