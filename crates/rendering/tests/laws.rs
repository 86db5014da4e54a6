//! Laws of the renderer: marks lie where the camera model projects them, near things hide far ones, edges are smooth.
#![allow(clippy::unwrap_used)]

use geometry::rotation::exp;
use geometry::{Camera, Distortion, Pose};
use nalgebra::{Vector2, Vector3};
use rendering::{Body, CameraRays, PlacedBody, Radiance, Rectangle, Sensor, Texture, exposed, render};
use std::sync::Arc;

/// The wall with the marks: 4 m x 3 m, 3 m before the first camera.
const WALL_M: [f64; 2] = [4.0, 3.0];
const TEXELS_PER_METRE: f64 = 400.0;
/// Distance between the marks, and the standard deviation of their brightness.
const GRID_M: f64 = 0.5;
const MARK_M: f64 = 0.012;

fn cameras() -> [Camera; 3] {
    let of = |distortion| Camera {
        width: 752,
        height: 480,
        focal: [458.654, 457.296],
        centre: [367.215, 248.375],
        distortion,
    };
    [
        of(Distortion::None),
        of(Distortion::RadialTangential([-0.283_408_11, 0.073_959_07, 0.000_193_59, 1.761_871_14e-5])),
        of(Distortion::Equidistant([-0.01, 0.02, -0.005, 0.001])),
    ]
}

/// The marks on the wall, in the wall's frame.
fn marks() -> impl Iterator<Item = Vector3<f64>> {
    let count = |side: f64| 1..(side / GRID_M) as usize;
    count(WALL_M[1]).flat_map(move |row| {
        count(WALL_M[0]).map(move |column| Vector3::new(column as f64, row as f64, 0.0) * GRID_M)
    })
}

/// Bright spots on black.
fn wall() -> Body {
    let size = WALL_M.map(|side| (side * TEXELS_PER_METRE) as usize);
    let off = |texel: usize| {
        let metres = (texel as f64 + 0.5) / TEXELS_PER_METRE;
        metres - (metres / GRID_M).round() * GRID_M
    };
    let texture = Texture::from_fn(size, |u, v| {
        let squared = off(u).powi(2) + off(v).powi(2);
        (220.0 * (-0.5 * squared / MARK_M.powi(2)).exp()) as f32
    });
    let corner = Vector3::new(-WALL_M[0] / 2.0, -WALL_M[1] / 2.0, 3.0);
    let body_from_rectangle = Pose::new(exp(&Vector3::new(0.05, 0.1, -0.03)), corner);
    let texture = Arc::new(texture);
    Body { rectangles: vec![Rectangle { body_from_rectangle, size_m: WALL_M, texture, brightness: 1.0 }] }
}

fn poses() -> Vec<Pose> {
    let pose = |k: u32| {
        let t = f64::from(k);
        let turn = Vector3::new(0.15 * (1.1 * t).sin(), 0.2 * (0.7 * t).cos(), 0.5 * t);
        Pose::new(exp(&turn), Vector3::new(0.5 * t.sin(), 0.3 * (2.0 * t).cos(), 0.8 * (0.5 * t).sin()))
    };
    (0..5).map(pose).collect()
}

fn placed(body: &Body) -> PlacedBody<'_> {
    PlacedBody { world_from_body: Pose::identity(), body }
}

/// Centre of the brightness around a pixel.
fn centroid(image: &Radiance, around: &Vector2<f64>) -> Vector2<f64> {
    const REACH: i64 = 9;
    let [x, y] = [around.x.round() as i64, around.y.round() as i64];
    let (mut sum, mut weight) = (Vector2::zeros(), 0.0);
    for row in y - REACH..=y + REACH {
        for column in x - REACH..=x + REACH {
            let value = f64::from(image.at(column as usize, row as usize));
            sum += Vector2::new(column as f64, row as f64) * value;
            weight += value;
        }
    }
    sum / weight
}

/// Distances (pixels) of the rendered marks from where the camera model projects them.
fn distances(image: &Radiance, camera: &Camera, world_from_camera: &Pose, wall: &Body) -> Vec<f64> {
    let world_from_wall = wall.rectangles[0].body_from_rectangle;
    let inner = |pixel: &Vector2<f64>| {
        (12.0..f64::from(camera.width) - 12.0).contains(&pixel.x)
            && (12.0..f64::from(camera.height) - 12.0).contains(&pixel.y)
    };
    let pixels = marks().filter_map(|mark| {
        let in_camera = world_from_camera.inverse_transform(&world_from_wall.transform(&mark));
        camera.project(&in_camera).ok().filter(inner)
    });
    pixels.map(|pixel| (centroid(image, &pixel) - pixel).norm()).collect()
}

#[test]
fn marks_are_where_the_camera_model_projects_them() {
    let wall = wall();
    for camera in cameras() {
        let rays = CameraRays::new(&camera);
        let mut all = Vec::new();
        for pose in poses() {
            all.extend(distances(&render(&[placed(&wall)], &rays, &pose), &camera, &pose, &wall));
        }
        let worst = all.iter().copied().fold(0.0, f64::max);
        let mean = all.iter().sum::<f64>() / all.len() as f64;
        println!("{:?}: {} marks, mean {mean:.4} px, worst {worst:.4} px", camera.distortion, all.len());
        assert!(all.len() > 60 && worst < 0.05, "{worst} px of {} marks", all.len());
    }
}

#[test]
fn a_blurred_mark_is_where_it_was_at_the_middle_of_the_exposure() {
    let wall = wall();
    let [_, camera, _] = cameras();
    let rays = CameraRays::new(&camera);
    let at =
        |part: f64| Pose::new(exp(&Vector3::new(0.0, 0.008 * part, 0.002)), Vector3::x() * (0.02 * part));
    let blurred = exposed(4, |part| render(&[placed(&wall)], &rays, &at(part)));
    let sharp = render(&[placed(&wall)], &rays, &at(0.0));
    let worst = distances(&blurred, &camera, &at(0.0), &wall).into_iter().fold(0.0, f64::max);
    assert!(worst < 0.05, "{worst} px");
    let peak = |image: &Radiance| (0..752).map(|x| image.at(x, 240)).fold(0.0, f32::max);
    let difference: f32 = (0..752)
        .flat_map(|x| (0..480).map(move |y| (x, y)))
        .map(|(x, y)| (sharp.at(x, y) - blurred.at(x, y)).abs())
        .sum();
    assert!(
        difference > 1000.0 && peak(&blurred) <= peak(&sharp) + 1.0,
        "blur changes the image: {difference}"
    );
}

#[test]
fn a_room_has_no_gaps_and_the_same_seed_gives_the_same_bytes() {
    let image = |seed: u64| {
        let (room, cupboard) = (Body::room([6.0, 5.0, 3.0], seed), Body::cuboid([0.8, 0.5, 1.2], seed + 1));
        let stands = Pose::new(exp(&Vector3::new(0.0, 0.0, 0.4)), Vector3::new(2.0, 0.3, 0.0));
        let bodies = [placed(&room), PlacedBody { world_from_body: stands, body: &cupboard }];
        let [_, camera, _] = cameras();
        let rays = CameraRays::new(&camera);
        // Looks along x.
        let forward = exp(&Vector3::new(-1.2, 1.2, -1.2).normalize().scale(std::f64::consts::TAU / 3.0));
        let pose = Pose::new(forward, Vector3::new(-1.0, 0.0, 1.4));
        let seen = render(&bodies, &rays, &pose);
        let darkest = (0..480).flat_map(|y| (0..752).map(move |x| (x, y))).map(|(x, y)| seen.at(x, y));
        assert!(darkest.fold(f32::INFINITY, f32::min) > 5.0, "a gap");
        (Sensor::default().image(&seen, 9), Sensor::default().image(&seen, 10))
    };
    let (first, again, other) = (image(1), image(1), image(2));
    assert_eq!(first, again);
    assert_ne!(first.0, first.1);
    assert_ne!(first.0, other.0);
}

#[test]
fn the_nearest_body_is_seen_and_its_edges_are_mixed() {
    let plain = |grey: f32, depth: f64, side: f64| {
        let texture = Arc::new(Texture::from_fn([8, 8], |_, _| grey));
        let corner = Vector3::new(-side / 2.0, -side / 2.0, depth);
        let body_from_rectangle = Pose::new(exp(&Vector3::zeros()), corner);
        Body {
            rectangles: vec![Rectangle { body_from_rectangle, size_m: [side; 2], texture, brightness: 1.0 }],
        }
    };
    let (far, near) = (plain(50.0, 3.0, 8.0), plain(200.0, 2.0, 0.503));
    let [camera, ..] = cameras();
    let rays = CameraRays::new(&camera);
    for bodies in [[placed(&far), placed(&near)], [placed(&near), placed(&far)]] {
        let seen = render(&bodies, &rays, &Pose::identity());
        let near_rows = (0..480).map(|y| seen.at(367, y)).filter(|grey| *grey > 199.0).count();
        let expected = 0.503 / 2.0 * camera.focal[1];
        assert!((near_rows as f64 - expected).abs() < 2.0, "{near_rows} rows, {expected} expected");
        assert!((seen.at(5, 5) - 50.0).abs() < 0.5);
        let mixed = (0..480).map(|y| seen.at(367, y)).filter(|grey| (60.0..190.0).contains(grey)).count();
        assert!((1..=2).contains(&mixed), "{mixed} mixed pixels");
    }
    // From behind it is not seen.
    let behind = Pose::new(exp(&Vector3::new(0.0, std::f64::consts::PI, 0.0)), Vector3::new(0.0, 0.0, 5.0));
    let seen = render(&[placed(&near)], &rays, &behind);
    assert!((0..480).all(|y| seen.at(367, y) == 0.0));
}
