//! Laws of the simulation.

use super::*;
use geometry::pose::Pose;
use nalgebra::Vector2;
use sensors::{Frame, TruthTrack, writer};
use std::collections::BTreeMap;

/// The whole trajectory at three times the usual speed.
fn quick(seed: u64) -> SimulationOptions {
    SimulationOptions { seed, speed: 10.0, ..SimulationOptions::default() }
}

fn truth_at(sequence: &Sequence, frame: &Frame) -> Pose {
    TruthTrack::new(sequence.groundtruth.as_ref().unwrap()).pose(frame.stamp_ns, 0).unwrap()
}

#[test]
fn the_same_seed_gives_the_same_bytes_and_another_seed_others() {
    let folder = tempfile::tempdir().unwrap();
    let files =
        ["mav0/imu0/data.csv", "mav0/cam0/tracks.csv", "mav0/cam0/features.csv", "mav0/cam1/tracks.csv"];
    let mut contents = Vec::new();
    for (name, seed) in [("a", 5), ("b", 5), ("c", 6)] {
        let scenario = simulate(&quick(seed)).unwrap();
        writer::write(&scenario.live, &folder.path().join(name)).unwrap();
        contents.push(files.map(|file| std::fs::read(folder.path().join(name).join(file)).unwrap()));
    }
    assert_eq!(contents[0], contents[1]);
    for (ours, theirs) in contents[0].iter().zip(&contents[2]) {
        assert_ne!(ours, theirs);
    }
}

#[test]
fn what_is_written_is_what_was_simulated() {
    let folder = tempfile::tempdir().unwrap();
    let scenario = simulate(&quick(3)).unwrap();
    for (name, sequence) in [("map", &scenario.map), ("live", &scenario.live)] {
        let root = folder.path().join(name);
        writer::write(sequence, &root).unwrap();
        let read = Sequence::open(&root).unwrap();
        assert_eq!(read.frames, sequence.frames);
        assert_eq!(read.imu_samples, sequence.imu_samples);
        assert_eq!(read.truth_gravity(), Some(-nalgebra::Vector3::z()));
    }
}

#[test]
fn tracks_triangulate_and_reproject_to_the_noise_level() {
    let scenario = simulate(&quick(2)).unwrap();
    let live = &scenario.live;
    let mut views: BTreeMap<u64, Vec<(Pose, u8, Vector2<f64>)>> = BTreeMap::new();
    for frame in &live.frames {
        let world_from_imu = truth_at(live, frame);
        for track in &frame.tracks {
            let sensor = &live.cameras[usize::from(track.camera)];
            let view = (world_from_imu.compose(&sensor.imu_from_camera), track.camera, track.pixel);
            views.entry(track.feature_id).or_default().push(view);
        }
    }
    let (mut squares, mut count) = (0.0, 0.0);
    for views in views.values().filter(|views| views.len() >= 12) {
        let cameras: Vec<_> =
            views.iter().map(|(_, camera, _)| &live.cameras[usize::from(*camera)].camera).collect();
        let geometry_views: Vec<_> = views
            .iter()
            .map(|(pose, _, pixel)| geometry::View {
                parent_from_camera: *pose,
                pixel: *pixel,
                sigma_px: 1.0,
            })
            .collect();
        let Ok(found) =
            geometry::triangulate(&cameras, &geometry_views, &geometry::TriangulationOptions::default())
        else {
            continue;
        };
        for ((pose, _, pixel), camera) in views.iter().zip(&cameras) {
            squares +=
                (camera.project(&pose.inverse_transform(&found.position)).unwrap() - pixel).norm_squared();
        }
        count += 2.0 * views.len() as f64 - 3.0;
    }
    let sigma = f64::sqrt(squares / count);
    assert!(count > 10_000.0 && (0.95..1.05).contains(&sigma), "{sigma} px over {count}");
}

#[test]
fn ids_never_return_and_are_shared_by_the_cameras() {
    let scenario = simulate(&quick(4)).unwrap();
    let mut last_seen: BTreeMap<u64, usize> = BTreeMap::new();
    let mut stereo = 0;
    for (index, frame) in scenario.live.frames.iter().enumerate() {
        let of = |camera: u8| frame.tracks.iter().filter(move |track| track.camera == camera);
        assert!(of(0).count() <= 100 && of(0).count() > 60, "{} tracks at {index}", of(0).count());
        stereo += of(1).filter(|right| of(0).any(|left| left.feature_id == right.feature_id)).count();
        for track in of(0) {
            // A pixel whose noise carried it out of the image is missing for one frame.
            let before = last_seen.insert(track.feature_id, index);
            assert!(before.is_none_or(|before| before + 3 >= index));
        }
    }
    assert!(stereo > 50 * scenario.live.frames.len());
}

#[test]
fn outliers_are_as_many_as_asked_for() {
    let far = |fraction: f64| {
        let exact = SimulationOptions { sigma_track_px: 0.0, speed: 3.0, ..quick(1) };
        let scenario = simulate(&SimulationOptions { outlier_fraction: fraction, ..exact }).unwrap();
        // Without noise and at a walk, a second difference of more than 8 px is due to an outlier.
        let mut tracks: BTreeMap<u64, Vec<Vector2<f64>>> = BTreeMap::new();
        for frame in &scenario.live.frames {
            for track in frame.tracks.iter().filter(|track| track.camera == 0) {
                tracks.entry(track.feature_id).or_default().push(track.pixel);
            }
        }
        let windows = || tracks.values().flat_map(|pixels| pixels.windows(3));
        let jumps = windows().filter(|window| (window[0] - 2.0 * window[1] + window[2]).norm() > 8.0).count();
        jumps as f64 / windows().count() as f64
    };
    let (none, some) = (far(0.0), far(0.02));
    assert!(some > 4.0 * none, "{none} {some}");
    // An outlier is in three second differences: 1 - 0.98^3 = 5.9 %, less those that fall outside of the image.
    assert!((0.045..0.07).contains(&(some - none)), "{none} {some}");
}

#[test]
fn reference_poses_are_off_by_what_they_state() {
    let scenario = simulate(&SimulationOptions::default()).unwrap();
    let map = &scenario.map;
    let track = TruthTrack::new(map.groundtruth.as_ref().unwrap());
    let poses = map.reference_poses.as_ref().unwrap();
    let errors: Vec<_> = poses
        .iter()
        .map(|reference| track.pose(reference.stamp_ns, 0).unwrap().local(&reference.pose))
        .collect();
    let mean_square = |start: usize| {
        errors.iter().map(|error| error.fixed_rows::<3>(start).norm_squared() / 3.0).sum::<f64>()
            / errors.len() as f64
    };
    assert!(errors.len() > 100);
    assert!((mean_square(0).sqrt() / 0.0158 - 1.0).abs() < 0.15);
    assert!((mean_square(3).sqrt() / 0.1 - 1.0).abs() < 0.15);
    let with_features = map.frames.iter().filter(|frame| !frame.features.is_empty());
    assert!(with_features.map(|frame| frame.stamp_ns).eq(poses.iter().map(|pose| pose.stamp_ns)));
}

#[test]
fn the_map_drops_out_for_the_stated_part_of_the_run() {
    let count = |fraction: f64| {
        let options = SimulationOptions { dropout_fraction: fraction, ..SimulationOptions::default() };
        let live = simulate(&options).unwrap().live;
        live.frames.iter().filter(|frame| !frame.features.is_empty()).count() as f64
    };
    let ratio = count(0.3) / count(0.0);
    assert!((0.65..0.75).contains(&ratio), "{ratio}");
}

#[test]
fn runs_are_long_and_take_different_lines() {
    let scenario = simulate(&SimulationOptions::default()).unwrap();
    for sequence in [&scenario.map, &scenario.live] {
        let truth = sequence.groundtruth.as_ref().unwrap();
        let path: f64 =
            truth.windows(2).map(|pair| (pair[1].pose.translation - pair[0].pose.translation).norm()).sum();
        assert!(path >= 300.0, "{path}");
    }
    let map = scenario.map.groundtruth.unwrap();
    let nearest = |row: &sensors::TruthRow| {
        map.iter()
            .map(|other| (other.pose.translation - row.pose.translation).norm())
            .fold(f64::MAX, f64::min)
    };
    let live = scenario.live.groundtruth.unwrap();
    let mean = live.iter().map(nearest).sum::<f64>() / live.len() as f64;
    assert!((0.7..3.0).contains(&mean), "{mean}");
}

#[test]
fn nonsense_is_refused() {
    let base = SimulationOptions::default();
    for bad in [
        SimulationOptions { speed: 0.0, ..base.clone() },
        SimulationOptions { bit_flips: 1.5, ..base.clone() },
        SimulationOptions { second_delay_s: 0.006, ..base.clone() },
        SimulationOptions { imu_rate_hz: f64::NAN, ..base.clone() },
        SimulationOptions { map_trajectory: Some(Vec::new()), ..base.clone() },
    ] {
        assert!(simulate(&bad).is_err());
    }
}
