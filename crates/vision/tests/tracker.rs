//! Laws of the tracker: a textured wall before a moving camera pair.

use crate::common::{SIZE, Texture};
use geometry::rotation::exp;
use geometry::{Camera, Distortion, Pose, Rotation};
use nalgebra::{Vector2, Vector3};
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};
use std::collections::{BTreeMap, BTreeSet};
use vision::GrayImage;
use vision::tracking::{TrackedPixel, Tracker, TrackerError, TrackerFrame, TrackerOptions};

const PERIOD_NS: i64 = 50_000_000;
/// Distance of the wall, metres, and its texture's lattice points a metre: one a pixel.
const WALL: f64 = 3.0;
const SCALE: f64 = 460.0 / WALL;

fn camera() -> Camera {
    let distortion = Distortion::RadialTangential([-0.28, 0.07, 0.0002, 0.0]);
    let [width, height] = SIZE.map(|side| side as u32);
    Camera { width, height, focal: [460.0, 458.0], centre: [367.0, 248.0], distortion }
}

/// The second camera sits 0.11 m to the right and is turned a little.
fn first_from_second() -> Pose {
    Pose::new(exp(&Vector3::new(0.004, -0.006, 0.003)), Vector3::new(0.11, 0.001, -0.002))
}

/// Where on the wall z = WALL a pixel of a camera at `world_from_camera` looks, metres.
fn on_wall(world_from_camera: &Pose, pixel: &Vector2<f64>) -> Vector3<f64> {
    let ray = world_from_camera.rotation * camera().unproject(pixel).unwrap().push(1.0);
    let start = world_from_camera.translation;
    start + ray * ((WALL - start.z) / ray.z)
}

fn photograph(texture: &Texture, world_from_camera: &Pose) -> GrayImage {
    GrayImage::from_fn(SIZE[0], SIZE[1], |x, y| {
        let point = on_wall(world_from_camera, &Vector2::new(x as f64, y as f64));
        texture.at(point.x * SCALE, point.y * SCALE).clamp(0.0, 255.0) as u8
    })
}

fn pose(k: usize) -> Pose {
    let t = k as f64;
    let turn = Vector3::new(0.01 * (t * 0.9).sin(), 0.012 * t, 0.02 * (t * 0.7).sin());
    Pose::new(exp(&turn), Vector3::new(0.04 * t, -0.02 * t, 0.03 * (t * 0.5).sin()))
}

fn turned(k: usize) -> Rotation {
    pose(k).rotation.inverse() * pose(k - 1).rotation
}

fn frame(texture: &Texture, k: usize, stereo: bool, gyroscope: bool) -> TrackerFrame {
    let second_pose = pose(k).compose(&first_from_second());
    TrackerFrame {
        stamp_ns: k as i64 * PERIOD_NS,
        image: photograph(texture, &pose(k)),
        second_image: stereo.then(|| photograph(texture, &second_pose)),
        rotation: (gyroscope && k > 0).then(|| turned(k)),
        sigma_rotation_rad: 1e-3,
    }
}

fn tracker(stereo: bool, options: TrackerOptions) -> Tracker {
    let second = stereo.then(|| (camera(), first_from_second().inverse()));
    Tracker::new(camera(), second, options).unwrap()
}

fn ids(tracks: &[TrackedPixel]) -> BTreeSet<u64> {
    tracks.iter().filter(|track| track.camera == 0).map(|track| track.feature_id).collect()
}

#[test]
fn tracks_stay_on_their_points_and_ids_are_never_used_again() {
    let texture = Texture::new(1);
    for gyroscope in [true, false] {
        let mut tracker = tracker(false, TrackerOptions::default());
        let mut first_seen = BTreeMap::new();
        let mut before = BTreeSet::new();
        let mut ended = BTreeSet::new();
        let (mut drifts, mut continued) = (Vec::new(), 0);
        for k in 0..8 {
            let tracks = tracker.track(frame(&texture, k, false, gyroscope)).unwrap();
            let now = ids(&tracks);
            assert_eq!(now.len(), tracks.len(), "an id is in an image once");
            assert_eq!(tracks.len(), 200);
            ended.extend(before.difference(&now));
            assert!(now.is_disjoint(&ended), "an ended track comes back");
            continued += now.intersection(&before).count();
            before = now;
            for track in tracks {
                let point = on_wall(&pose(k), &track.pixel);
                let first = *first_seen.entry(track.feature_id).or_insert(point);
                drifts.push((point - first).norm() * SCALE);
            }
        }
        assert!(continued > 7 * 160, "{continued} continued");
        drifts.sort_by(f64::total_cmp);
        let most = drifts[drifts.len() * 95 / 100];
        assert!(most < 0.5, "95 % within {most} px of where they began (gyroscope: {gyroscope})");
    }
}

#[test]
fn the_error_of_a_track_does_not_grow_with_its_age() {
    let texture = Texture::new(9);
    let mut tracker = tracker(false, TrackerOptions::default());
    let mut first_seen = BTreeMap::new();
    let (mut young, mut old) = (Vec::new(), Vec::new());
    for k in 0..32 {
        for track in tracker.track(frame(&texture, k, false, true)).unwrap() {
            let point = on_wall(&pose(k), &track.pixel);
            let (begin, first) = *first_seen.entry(track.feature_id).or_insert((k, point));
            let error = (point - first).norm() * SCALE;
            match k - begin {
                2..=4 => young.push(error),
                20.. => old.push(error),
                _ => (),
            }
        }
    }
    let median = |errors: &mut Vec<f64>| {
        errors.sort_by(f64::total_cmp);
        errors[errors.len() / 2]
    };
    assert!(old.len() > 100, "{} old tracks", old.len());
    let [young, old] = [&mut young, &mut old].map(median);
    // Errors that add up from image to image are three times as large after ten times as many.
    assert!(old < 1.5 * young, "median {old} px after 20 images and more, {young} px after 2 to 4");
}

/// The grey levels of an image in another light.
fn in_light(image: &GrayImage, light: impl Fn(usize, usize, f64) -> f64) -> GrayImage {
    GrayImage::from_fn(image.width(), image.height(), |x, y| {
        light(x, y, f64::from(image.get(x, y))).round().clamp(0.0, 255.0) as u8
    })
}

/// The grey level of a pixel in another light, by the number of the image, the pixel's column and row, and its level.
type Light<'a> = &'a dyn Fn(usize, usize, usize, f64) -> f64;

#[test]
fn exposure_flicker_glare_and_the_noise_of_dusk_end_few_tracks() {
    const IMAGES: usize = 6;
    let texture = Texture::new(12);
    let photographs: Vec<GrayImage> = (0..IMAGES).map(|k| photograph(&texture, &pose(k))).collect();
    // The sum of twelve uniform numbers has a variance of one.
    let mut random = StdRng::seed_from_u64(12);
    let mut normal = || (0..12).map(|_| random.random::<f64>() - 0.5).sum::<f64>();
    let noise: Vec<f64> = (0..IMAGES * SIZE[0] * SIZE[1]).map(|_| normal()).collect();
    let noise = |k: usize, x: usize, y: usize| noise[(k * SIZE[1] + y) * SIZE[0] + x];
    // In which light, how many times as many tracks end as in an even light, and how many times their errors, at most.
    let lights: [(&str, Light<'_>, f64, f64); 5] = [
        ("even", &|_, _, _, level| level, 1.0, 1.0),
        ("flicker of a lamp", &|k, _, _, level| level * [0.5, 1.0, 0.7][k % 3], 1.5, 2.0),
        ("exposure that is set anew", &|k, _, _, level| level * if k < 3 { 0.35 } else { 1.0 }, 2.5, 2.0),
        ("a lamp in the image", &|_, x, y, level| level + glare(x, y), 2.0, 2.5),
        ("dusk", &|k, x, y, level| 0.5 * level + 1.5 * noise(k, x, y), 2.0, 10.0),
    ];
    let mut even = None;
    for (name, light, most_ended, most_error) in lights {
        let mut tracker = tracker(false, TrackerOptions::default());
        let mut first_seen: BTreeMap<u64, Vector3<f64>> = BTreeMap::new();
        let (mut errors, mut points) = (Vec::new(), 0);
        for (k, image) in photographs.iter().enumerate() {
            let image = in_light(image, |x, y, level| light(k, x, y, level));
            let rotation = (k > 0).then(|| turned(k));
            let stamp_ns = k as i64 * PERIOD_NS;
            let frame =
                TrackerFrame { stamp_ns, image, second_image: None, rotation, sigma_rotation_rad: 1e-3 };
            let tracks = tracker.track(frame).unwrap();
            points += if k + 1 < IMAGES { tracks.len() } else { 0 };
            for track in tracks {
                let point = on_wall(&pose(k), &track.pixel);
                match first_seen.get(&track.feature_id) {
                    Some(first) => errors.push((point - first).norm() * SCALE),
                    None => drop(first_seen.insert(track.feature_id, point)),
                }
            }
        }
        errors.sort_by(f64::total_cmp);
        let (ended, error) = (1.0 - errors.len() as f64 / points as f64, errors[errors.len() / 2]);
        println!("{name}: {points} points, {ended:.3} ended, {error:.3} px");
        let (even_ended, even_error) = *even.get_or_insert((ended, error));
        assert!(points > 500, "{name}: {points} points in {IMAGES} images");
        assert!(ended <= most_ended * even_ended, "{name}: {ended} of the tracks ended, {even_ended} by day");
        assert!(error <= most_error * even_error, "{name}: {error} px, {even_error} px in an even light");
    }
}

/// What a lamp with a halo adds to the grey levels.
fn glare(x: usize, y: usize) -> f64 {
    let [x, y] = [(x, 0), (y, 1)].map(|(at, side)| (at as f64 - 0.4 * SIZE[side] as f64) / 90.0);
    400.0 * (-x * x - y * y).exp()
}

#[test]
fn a_track_ends_where_its_surroundings_become_others_however_slowly() {
    let texture = Texture::new(10);
    let other = Texture::new(11);
    let mut tracker = tracker(false, TrackerOptions::default());
    let changes = |x: usize| x > SIZE[0] / 2;
    let mut left = BTreeMap::new();
    for k in 0..=16 {
        // One picture fades into another one; nothing moves.
        let share = k as f64 / 16.0;
        let image = GrayImage::from_fn(SIZE[0], SIZE[1], |x, y| {
            let [before, after] = [&texture, &other].map(|texture| texture.at(x as f64, y as f64));
            let value = if changes(x) { before + share * (after - before) } else { before };
            value.clamp(0.0, 255.0) as u8
        });
        let input = TrackerFrame { image, ..frame(&texture, k, false, false) };
        let mut counts = [0, 0];
        // Patches that show both halves are left out.
        let is_in_one = |track: &&TrackedPixel| (track.pixel.x - SIZE[0] as f64 / 2.0).abs() > 16.0;
        let tracks = tracker.track(input).unwrap();
        for track in tracks.iter().filter(|track| track.feature_id < 200).filter(is_in_one) {
            counts[usize::from(changes(track.pixel.x as usize))] += 1;
        }
        left.insert(k, counts);
    }
    let ([still, faded], [still_left, faded_left]) = (left[&0], left[&16]);
    assert!(still > 50 && still_left * 10 > still * 8, "{still_left} of {still} of what stays");
    assert!(faded > 50 && faded_left * 10 < faded, "{faded_left} of {faded} of what became another picture");
}

#[test]
fn the_second_camera_sees_the_same_points() {
    let texture = Texture::new(2);
    let mut tracker = tracker(true, TrackerOptions::default());
    for k in 0..3 {
        let tracks = tracker.track(frame(&texture, k, true, true)).unwrap();
        let first: BTreeMap<u64, Vector2<f64>> =
            tracks.iter().filter(|track| track.camera == 0).map(|t| (t.feature_id, t.pixel)).collect();
        let second: Vec<_> = tracks.iter().filter(|track| track.camera == 1).collect();
        assert!(second.len() > 140, "{} of {} are seen by both", second.len(), first.len());
        let mut errors: Vec<f64> = second
            .iter()
            .map(|track| {
                let point = on_wall(&pose(k), &first[&track.feature_id]);
                let second_pose = pose(k).compose(&first_from_second());
                (camera().project(&second_pose.inverse_transform(&point)).unwrap() - track.pixel).norm()
            })
            .collect();
        errors.sort_by(f64::total_cmp);
        assert!(errors[errors.len() * 95 / 100] < 0.3, "{:?}", errors.last());
    }
}

#[test]
fn after_a_long_gap_all_tracks_are_new_and_after_a_short_one_they_go_on() {
    let texture = Texture::new(3);
    let mut tracker = tracker(false, TrackerOptions::default().max_gap_ns(2 * PERIOD_NS));
    let mut look = |k: usize| {
        let frame = TrackerFrame { rotation: None, ..frame(&texture, k, false, false) };
        ids(&tracker.track(frame).unwrap())
    };
    let (first, second, third) = (look(0), look(2), look(5));
    assert!(first.intersection(&second).count() > 100);
    assert!(second.is_disjoint(&third) && first.is_disjoint(&third));
}

#[test]
fn nothing_is_tracked_under_a_mask() {
    let texture = Texture::new(4);
    let mask = GrayImage::from_fn(SIZE[0], SIZE[1], |x, y| if x > 300 && y > 200 { 0 } else { 255 });
    let mut tracker = tracker(true, TrackerOptions::default().mask(0, mask.clone()).mask(1, mask.clone()));
    for k in 0..4 {
        let tracks = tracker.track(frame(&texture, k, true, true)).unwrap();
        assert!(tracks.len() > 200);
        for track in tracks {
            assert_ne!(mask.get(track.pixel.x.round() as usize, track.pixel.y.round() as usize), 0);
        }
    }
}

#[test]
fn what_moves_on_its_own_is_thrown_out() {
    let texture = Texture::new(5);
    let other = Texture::new(6);
    let mut tracker = tracker(false, TrackerOptions::default());
    // A poster slides over the image, across the direction of motion.
    let poster = |x: usize, y: usize| (420..580).contains(&x) && (150..320).contains(&y);
    let mut stays = Vec::new();
    for k in 0..4 {
        let mut input = frame(&texture, k, false, true);
        let slide = 6.0 * k as f64;
        input.image = GrayImage::from_fn(SIZE[0], SIZE[1], |x, y| {
            if poster(x, y) { other.at(x as f64, y as f64 + slide) as u8 } else { input.image.get(x, y) }
        });
        let tracks = tracker.track(input).unwrap();
        stays.push(
            tracks
                .iter()
                .filter(|t| t.feature_id < 200)
                .filter(|t| (430.0..570.0).contains(&t.pixel.x) && (160.0..310.0).contains(&t.pixel.y))
                .count(),
        );
    }
    assert!(stays[0] >= 10 && stays[3] * 5 <= stays[0], "{stays:?}");
}

#[test]
fn images_that_do_not_fit_are_refused_and_the_next_one_goes_on() {
    let texture = Texture::new(7);
    let mut tracker = tracker(false, TrackerOptions::default());
    let before = ids(&tracker.track(frame(&texture, 0, false, false)).unwrap());
    let old = frame(&texture, 0, false, false);
    assert!(matches!(tracker.track(old), Err(TrackerError::OldImage { .. })));
    let mut small = frame(&texture, 1, false, false);
    small.image = GrayImage::from_fn(100, 100, |_, _| 0);
    assert!(matches!(tracker.track(small), Err(TrackerError::ImageSize { camera: 0, .. })));
    let after = ids(&tracker.track(frame(&texture, 1, false, false)).unwrap());
    assert!(before.intersection(&after).count() > 150);
    let mask = GrayImage::from_fn(10, 10, |_, _| 255);
    let wrong = Tracker::new(camera(), None, TrackerOptions::default().mask(0, mask));
    assert!(matches!(wrong, Err(TrackerError::MaskSize { camera: 0, .. })));
}

#[test]
fn a_black_image_ends_all_tracks_and_is_no_error() {
    let texture = Texture::new(8);
    let mut tracker = tracker(false, TrackerOptions::default());
    tracker.track(frame(&texture, 0, false, true)).unwrap();
    let mut dark = frame(&texture, 1, false, true);
    dark.image = GrayImage::from_fn(SIZE[0], SIZE[1], |_, _| 0);
    assert!(tracker.track(dark).unwrap().is_empty());
    assert_eq!(tracker.track(frame(&texture, 2, false, true)).unwrap().len(), 200);
}
