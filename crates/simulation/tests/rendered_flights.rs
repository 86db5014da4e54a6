//! Laws of recordings with images.

use sensors::{Sequence, TruthTrack, writer};
use simulation::images::{ImageOptions, render_all, simulate_images, write_images};
use simulation::{SimulatedScenario, SimulationError, SimulationOptions};
use vision::GrayImage;

fn flights(seed: u64, images: &ImageOptions) -> SimulatedScenario {
    let options = SimulationOptions { seed, duration_s: Some(4.0), ..ImageOptions::simulation() };
    simulate_images(&options, images).unwrap()
}

fn image(sequence: &Sequence, frame: usize, camera: usize) -> GrayImage {
    sequence.frames[frame].images[&camera].read().unwrap().into_owned()
}

/// Mean absolute difference, grey levels.
fn difference(a: &GrayImage, b: &GrayImage) -> f64 {
    let sum: u64 = a.pixels().iter().zip(b.pixels()).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
    sum as f64 / a.pixels().len() as f64
}

#[test]
fn the_same_seed_gives_the_same_images_and_another_seed_others() {
    let usual = ImageOptions::default();
    let [a, b, c] = [3, 3, 4].map(|seed| flights(seed, &usual));
    assert_eq!(image(&a.live, 70, 1), image(&b.live, 70, 1));
    assert!(difference(&image(&a.live, 70, 1), &image(&c.live, 70, 1)) > 10.0);
    // At rest only the noise differs from image to image: two levels a pixel, so 2.3 between two images.
    let noise = difference(&image(&a.map, 0, 0), &image(&a.map, 1, 0));
    assert!((2.0..2.6).contains(&noise), "{noise}");
    assert!(difference(&image(&a.map, 0, 0), &image(&a.map, 0, 1)) > 5.0, "two cameras");
}

#[test]
fn somebody_walks_through_some_images_and_the_rest_is_as_without() {
    let usual = ImageOptions::default();
    let [with, without] = [true, false].map(|occluder| flights(3, &ImageOptions { occluder, ..usual }));
    let differences: Vec<f64> = (0..160)
        .step_by(20)
        .map(|frame| difference(&image(&with.map, frame, 0), &image(&without.map, frame, 0)))
        .collect();
    let changed = differences.iter().filter(|change| **change > 1.0).count();
    assert!((1..differences.len()).contains(&changed), "{differences:?}");
    assert!(differences.contains(&0.0), "{differences:?}");
}

#[test]
fn every_frame_has_two_images_and_every_frame_of_the_map_a_reference_pose() {
    let scenario = flights(1, &ImageOptions::default());
    for (sequence, seconds) in [(&scenario.map, 9.0), (&scenario.live, 4.0)] {
        assert!((sequence.frames.len() as f64 - 20.0 * seconds).abs() < 6.0, "{}", sequence.frames.len());
        assert!(sequence.frames.iter().all(|frame| frame.images.len() == 2));
        assert!(sequence.has_images() && !sequence.has_features());
    }
    let references = scenario.map.reference_poses.as_ref().unwrap();
    assert!(references.iter().map(|pose| pose.stamp_ns).eq(scenario.map.frames.iter().map(|f| f.stamp_ns)));
    let track = TruthTrack::new(scenario.map.groundtruth.as_ref().unwrap());
    assert!(references.iter().all(|pose| track.pose(pose.stamp_ns, 0).is_some()));
    assert!(scenario.live.reference_poses.is_none());
}

#[test]
fn what_is_written_is_what_was_rendered() {
    let folder = tempfile::tempdir().unwrap();
    let mut live = flights(2, &ImageOptions::default()).live;
    live.frames.truncate(3);
    writer::write(&live, folder.path()).unwrap();
    let mut last = (0, 0);
    write_images(&live, folder.path(), |done, all| last = (done, all)).unwrap();
    assert_eq!(last, (6, 6));
    let read = Sequence::open(folder.path()).unwrap();
    let mut kept = live.clone();
    render_all(&mut kept, |_, _| {}).unwrap();
    for frame in 0..3 {
        assert_eq!(read.frames[frame].stamp_ns, live.frames[frame].stamp_ns);
        for camera in 0..2 {
            assert_eq!(image(&read, frame, camera), image(&live, frame, camera));
            assert_eq!(image(&kept, frame, camera), image(&live, frame, camera));
        }
    }
    assert_eq!(read.cameras, live.cameras);
    // A file where a folder is needed.
    let blocked = folder.path().join("file");
    std::fs::write(&blocked, "").unwrap();
    let error = write_images(&live, &blocked, |_, _| {}).unwrap_err().to_string();
    assert!(error.contains("file/mav0/cam0/data"), "{error}");
}

#[test]
fn other_trajectories_and_nonsense_are_refused() {
    let images = ImageOptions::default();
    let street = SimulationOptions::default();
    assert_eq!(simulate_images(&street, &images).unwrap_err(), SimulationError::NoRoom);
    for bad in [
        ImageOptions { exposure_s: -1.0, ..images },
        ImageOptions { sigma_noise: f64::NAN, ..images },
        ImageOptions { gain_change: 1.0, ..images },
    ] {
        assert!(simulate_images(&ImageOptions::simulation(), &bad).is_err());
    }
}
