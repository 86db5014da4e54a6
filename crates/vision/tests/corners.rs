//! Laws of corner detection.

use crate::common::{Motion, SIZE, Texture};
use nalgebra::Vector2;
use vision::{Corner, CornerOptions, GrayImage, detect_corners};

fn image(seed: u64, motion: &Motion) -> GrayImage {
    let texture = Texture::new(seed);
    motion.render(|x, y| texture.at(x, y), seed)
}

fn detect(image: &GrayImage, existing: &[Vector2<f32>], wanted: usize) -> Vec<Corner> {
    detect_corners(image, existing, None, wanted, &CornerOptions::default())
}

#[test]
fn corners_are_spread_and_apart() {
    let corners = detect(&image(1, &Motion::NONE), &[], 200);
    assert_eq!(corners.len(), 200);
    let mut cells = [0; 40];
    for (k, corner) in corners.iter().enumerate() {
        let [x, y] = [corner.pixel.x as usize * 8 / SIZE[0], corner.pixel.y as usize * 5 / SIZE[1]];
        cells[y * 8 + x] += 1;
        for other in &corners[..k] {
            assert!((corner.pixel - other.pixel).norm() >= CornerOptions::default().min_distance);
        }
    }
    assert!(cells.iter().all(|count| (2..=10).contains(count)), "{cells:?}");
}

/// All corners there are: which of them a cell takes depends on where the cell begins.
fn detect_all(image: &GrayImage) -> Vec<Corner> {
    let options = CornerOptions { cells: [1, 1], min_distance: 1.0, ..CornerOptions::default() };
    detect_corners(image, &[], None, 100_000, &options)
}

/// For every corner whose place is inside of the second image, too: how far the nearest corner there is from it.
fn distances(before: &[Corner], after: &[Corner], shift: Vector2<f32>) -> Vec<f32> {
    let inside = |p: &Vector2<f32>| p.x > 20.0 && p.x < 730.0 && p.y > 20.0 && p.y < 460.0;
    let moved = before.iter().map(|corner| corner.pixel + shift).filter(inside);
    let nearest = |point: Vector2<f32>| {
        after.iter().map(|other| (other.pixel - point).norm()).fold(f32::INFINITY, f32::min)
    };
    let mut distances: Vec<f32> = moved.map(nearest).collect();
    distances.sort_by(f32::total_cmp);
    assert!(distances.len() > 300);
    distances
}

#[test]
fn an_image_translated_by_whole_pixels_has_the_same_corners_there() {
    let before = image(2, &Motion::NONE);
    let clamped = |value: i64, side: usize| value.clamp(0, side as i64 - 1) as usize;
    let after = GrayImage::from_fn(SIZE[0], SIZE[1], |x, y| {
        before.get(clamped(x as i64 - 17, SIZE[0]), clamped(y as i64 + 9, SIZE[1]))
    });
    let distances = distances(&detect_all(&before), &detect_all(&after), Vector2::new(17.0, -9.0));
    assert!(distances.iter().all(|distance| *distance < 1e-3));
}

#[test]
fn an_image_translated_by_parts_of_a_pixel_has_corners_near_there() {
    let [before, after] = [Motion::NONE, Motion::shifted(17.4, -9.3)].map(|motion| image(2, &motion));
    let distances = distances(&detect_all(&before), &detect_all(&after), Vector2::new(17.4, -9.3));
    let (median, most) = (distances[distances.len() / 2], distances[distances.len() * 3 / 4]);
    assert!(median < 0.75 && most < 1.5, "median {median}, three quarters below {most}");
}

#[test]
fn the_corner_of_a_square_is_found_near_it() {
    let inside = 40..80;
    let level = |x, y| if inside.contains(&x) && inside.contains(&y) { 200 } else { 50 };
    let corners = detect(&GrayImage::from_fn(120, 120, level), &[], 4);
    assert_eq!(corners.len(), 4);
    for (x, y) in [(39.5, 39.5), (79.5, 39.5), (39.5, 79.5), (79.5, 79.5)] {
        // Where the window holds most of both edges: up to half a window inside.
        assert!(corners.iter().any(|corner| (corner.pixel - Vector2::new(x, y)).norm() < 4.5));
    }
}

#[test]
fn existing_points_count_and_keep_their_distance() {
    let image = image(3, &Motion::NONE);
    let existing: Vec<Vector2<f32>> = detect(&image, &[], 150).iter().map(|corner| corner.pixel).collect();
    let new = detect(&image, &existing, 200);
    assert_eq!(new.len(), 50);
    for corner in &new {
        assert!(existing.iter().all(|point| (point - corner.pixel).norm() >= 16.0));
    }
    assert!(detect(&image, &existing, 150).is_empty());
}

#[test]
fn there_are_no_corners_under_a_mask_at_the_border_or_on_plain_ground() {
    let image = image(4, &Motion::NONE);
    let mask = GrayImage::from_fn(SIZE[0], SIZE[1], |x, _| if x < 376 { 0 } else { 255 });
    let corners = detect_corners(&image, &[], Some(&mask), 200, &CornerOptions::default());
    assert!(corners.len() > 100);
    assert!(corners.iter().all(|corner| corner.pixel.x >= 375.0 && corner.pixel.x < 743.0));
    let plain = GrayImage::from_fn(200, 200, |x, _| x as u8);
    assert!(detect(&plain, &[], 100).is_empty());
    assert!(detect(&GrayImage::from_fn(8, 8, |x, y| (37 * x * y) as u8), &[], 10).is_empty());
}
