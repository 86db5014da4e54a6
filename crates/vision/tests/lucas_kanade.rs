//! Laws of the alignment of patches, on images whose motion is known exactly.

use crate::common::{Motion, SIZE, Texture};
use nalgebra::Vector2;
use vision::tracking::{AlignmentError, AlignmentOptions, Warp, align, align_with_backward_check};
use vision::{CornerOptions, GrayImage, Pyramid, detect_corners};

const LEVELS: usize = 4;
/// A patch of 16 pixels must lie in both images.
const MARGIN: f64 = 8.0;

/// What became of the corners of a pair.
struct Outcome {
    /// Corners that are in both images.
    visible: usize,
    /// Errors of those that survived the way there and back, pixels.
    errors: Vec<f64>,
}

impl Outcome {
    fn survivors(&self) -> f64 {
        self.errors.len() as f64 / self.visible as f64
    }

    fn within(&self, limit: f64) -> f64 {
        self.errors.iter().filter(|error| **error < limit).count() as f64 / self.errors.len() as f64
    }
}

/// Tracks 200 corners of a source through a motion. Where a part of the motion is predicted (as a gyroscope does for
/// turning), the search begins with what is left of it: `unknown`, pixels.
fn track(source: &dyn Fn(f64, f64) -> f64, motion: &Motion, unknown: Option<[f64; 2]>) -> Outcome {
    let first = Pyramid::new(Motion::NONE.render(source, 1), LEVELS);
    let second = Pyramid::new(motion.render(source, 2), LEVELS);
    let corners = detect_corners(first.base(), &[], None, 200, &CornerOptions::default());
    let mut outcome = Outcome { visible: 0, errors: Vec::new() };
    for corner in corners {
        let truth = motion.map(corner.pixel.cast());
        let visible = |value: f64, side: usize| value > MARGIN && value < side as f64 - 1.0 - MARGIN;
        if !(visible(truth.x, SIZE[0]) && visible(truth.y, SIZE[1])) {
            continue;
        }
        outcome.visible += 1;
        let guess = match unknown {
            Some(unknown) => Warp::moved_to((truth + Vector2::from(unknown)).cast()),
            None => Warp::moved_to(corner.pixel),
        };
        let found =
            align_with_backward_check(&first, &second, corner.pixel, &guess, &AlignmentOptions::default());
        if let Ok(found) = found {
            outcome.errors.push((found.warp.centre.cast() - truth).norm());
        }
    }
    assert!(outcome.visible > 100);
    outcome
}

fn assert_reached(source: &dyn Fn(f64, f64) -> f64, motion: &Motion, unknown: Option<[f64; 2]>) {
    let outcome = track(source, motion, unknown);
    let (survivors, good) = (outcome.survivors(), outcome.within(0.2));
    assert!(survivors >= 0.9, "{survivors:.3} survive {motion:?}");
    assert!(good >= 0.95, "{good:.3} are within 0.2 px after {motion:?}");
}

#[test]
fn shifts_up_to_twenty_pixels_are_found() {
    let texture = Texture::new(1);
    for (x, y) in [(0.0, 0.0), (0.3, -0.7), (5.5, 3.25), (-12.0, 16.0), (20.0, 0.5), (14.1, 14.1)] {
        assert_reached(&|x, y| texture.at(x, y), &Motion::shifted(x, y), None);
    }
}

#[test]
fn a_change_of_brightness_changes_nothing() {
    let texture = Texture::new(2);
    for (gain, bias) in [(0.6, 30.0), (1.0, -20.0), (1.0, 20.0), (1.2, -25.0)] {
        let motion = Motion { gain, bias, ..Motion::shifted(7.3, -4.6) };
        assert_reached(&|x, y| texture.at(x, y), &motion, None);
    }
}

#[test]
fn turned_and_zoomed_patches_are_found_where_they_are() {
    let texture = Texture::new(3);
    // The centre is up to 20 px away from the guess, the surroundings are turned and stretched without any.
    for (degrees, zoom, unknown) in [
        (10.0, 1.0, [12.0, -16.0]),
        (-10.0, 1.0, [-20.0, 0.0]),
        (0.0, 1.1, [14.1, 14.1]),
        (0.0, 0.9, [0.0, 20.0]),
        (7.0, 1.07, [10.0, -10.0]),
    ] {
        let motion = Motion { degrees, zoom, gain: 0.8, bias: 15.0, ..Motion::NONE };
        assert_reached(&|x, y| texture.at(x, y), &motion, Some(unknown));
    }
}

#[test]
fn sub_pixel_motion_is_recovered_to_a_twentieth_of_a_pixel() {
    let texture = Texture::new(4);
    for shift in [[0.25, 0.5], [0.5, -0.5], [-0.1, 0.9]] {
        let outcome = track(&|x, y| texture.at(x, y), &Motion::shifted(shift[0], shift[1]), None);
        let mut errors = outcome.errors;
        errors.sort_by(f64::total_cmp);
        let median = errors[errors.len() / 2];
        assert!(median < 0.05, "median error {median:.4} px");
    }
}

#[test]
fn the_linear_part_is_how_the_surroundings_are_turned_and_stretched() {
    let texture = Texture::new(5);
    let motion = Motion { degrees: 8.0, zoom: 1.08, ..Motion::shifted(1.5, -2.5) };
    let source = |x, y| texture.at(x, y);
    let first = Pyramid::new(Motion::NONE.render(source, 1), LEVELS);
    let second = Pyramid::new(motion.render(source, 2), LEVELS);
    let near_centre = |point: &Vector2<f64>| (point - Vector2::new(376.0, 240.0)).norm() < 80.0;
    let mut seen = 0;
    for corner in detect_corners(first.base(), &[], None, 200, &CornerOptions::default()) {
        if !near_centre(&corner.pixel.cast()) {
            continue;
        }
        let guess = Warp::moved_to(corner.pixel);
        let Ok(found) = align(&first, &second, corner.pixel, &guess, &AlignmentOptions::default()) else {
            continue;
        };
        let off = (found.warp.linear.cast::<f64>() - motion.linear()).amax();
        assert!(off < 0.06, "the linear part is off by {off}");
        seen += 1;
    }
    assert!(seen > 5);
}

#[test]
fn an_occluded_patch_is_not_found() {
    let texture = Texture::new(6);
    let other = Texture::new(7);
    let motion = Motion::shifted(3.2, 1.7);
    let first = Pyramid::new(Motion::NONE.render(|x, y| texture.at(x, y), 1), LEVELS);
    // Something else covers the right half of the second image.
    let covered = |x: f64, y: f64| if x > 376.0 { other.at(x, y) } else { texture.at(x, y) };
    let second = Pyramid::new(motion.render(covered, 2), LEVELS);
    let (mut hidden, mut believed, mut visible, mut found) = (0, 0, 0, 0);
    for corner in detect_corners(first.base(), &[], None, 200, &CornerOptions::default()) {
        let guess = Warp::moved_to(corner.pixel);
        let result =
            align_with_backward_check(&first, &second, corner.pixel, &guess, &AlignmentOptions::default());
        if corner.pixel.x > 400.0 {
            hidden += 1;
            believed += usize::from(result.is_ok());
        } else if corner.pixel.x < 350.0 {
            visible += 1;
            found += usize::from(result.is_ok());
        }
    }
    assert!(hidden > 50 && visible > 50);
    assert!(believed * 50 <= hidden, "{believed} of {hidden} hidden patches are believed to be found");
    assert!(found * 10 >= visible * 9);
}

#[test]
fn plain_patches_and_straight_edges_are_refused() {
    let plain = Pyramid::new(GrayImage::from_fn(128, 128, |_, _| 90), LEVELS);
    let edge = Pyramid::new(GrayImage::from_fn(128, 128, |x, _| if x < 64 { 20 } else { 220 }), LEVELS);
    let at = Vector2::new(64.0, 64.0);
    for image in [&plain, &edge] {
        let result = align(image, image, at, &Warp::moved_to(at), &AlignmentOptions::default());
        assert_eq!(result, Err(AlignmentError::NoStructure));
    }
}

#[test]
fn points_outside_of_the_image_are_refused_without_panic() {
    let texture = Texture::new(8);
    let image = Pyramid::new(Motion::NONE.render(|x, y| texture.at(x, y), 1), LEVELS);
    let options = AlignmentOptions::default();
    let inside = Vector2::new(300.0, 200.0);
    for outside in [[-50.0, 10.0], [f32::NAN, 10.0], [1e9, 1e9], [751.0, 479.0], [300.0, f32::INFINITY]] {
        let outside = Vector2::from(outside);
        assert!(align(&image, &image, inside, &Warp::moved_to(outside), &options).is_err());
        assert!(align(&image, &image, outside, &Warp::moved_to(outside), &options).is_err());
    }
}
