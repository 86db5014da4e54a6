//! Real images, with the bounds that the system must keep on them.
//!
//! The recordings are not part of the repository. Where they are unpacked to `target/data`, run these tests as those of
//! `recorded`, with `--ignored`; without a recording its test fails and names it. The test of XFeat also needs
//! the weights (`driftless weights xfeat`).

use evaluation::{Alignment, align};
use map_io::colmap::{ColmapImage, read_model};
use mapping::odometry_config;
use mapping::{ColmapFrame, Extraction, import_colmap};
use nalgebra::Vector3;
use recognition::LoadedMap;
use sensors::{Sequence, TruthTrack};
use tests::data::recording;
use tests::images::{Found, Split, within, wrong_by};
use tests::robot::{run, run_in_map};
use vision::features::open;
use vision::{FeatureExtractor, GrayImage};

const MAP_FEATURES: usize = 1000;
/// Time after the map initialization from which on poses are scored, nanoseconds.
const SETTLED_NS: i64 = 5_000_000_000;
/// The truth's own standard deviation, m.
const TRUTH_SIGMA: f64 = 0.01;
const QUERY_FEATURES: usize = 1000;

fn recorded_images(name: &str) -> Sequence {
    Sequence::open(&recording("images").join(name)).unwrap()
}

fn vicon_room() -> Sequence {
    recorded_images("v1_01_keyframes")
}

fn odd_images() -> Split {
    Split::new(vicon_room(), |index, _| index % 2 == 1)
}

fn classical() -> Box<dyn FeatureExtractor> {
    open("sift-1", None).unwrap()
}

fn tell(what: &str, found: &[Found]) {
    let near = found.iter().filter(|found| found.near).count();
    println!(
        "{what}: of {} queries {near} have a map image near; {} within 5 cm and 1 deg, {} within 10 cm and 2 deg, {} \
         wrong by 0.5 m",
        found.len(),
        within(found, 0.05, 1.0),
        within(found, 0.10, 2.0),
        wrong_by(found, 0.5)
    );
    let mut nees: Vec<f64> = found.iter().filter_map(|found| found.nees).collect();
    nees.sort_by(f64::total_cmp);
    if !nees.is_empty() {
        println!("  NEES/6 median {:.2}, 90 % below {:.2}", nees[nees.len() / 2], nees[nees.len() * 9 / 10]);
    }
    for found in found.iter().filter(|found| found.near && within(&[**found], 0.05, 1.0) == 0) {
        println!("  frame {}: {:?}", found.frame, found.error);
    }
}

#[test]
#[ignore = "needs the recordings in target/data"]
fn images_between_those_of_the_map_are_localized() {
    let split = odd_images();
    let mut extractor = classical();
    let (map, report) = split.build(extractor.as_mut(), MAP_FEATURES);
    println!(
        "{} keyframes, {} landmarks, {} observations, pixel sigma {:.2}, {:.2?} px, poses to {:.4?} m {:.3?} deg, corrected \
         {:.4?} m {:.3?} deg",
        report.keyframes,
        report.landmarks,
        report.observations,
        report.sigma_px,
        report.reprojection_px,
        report.sigma_pose_m,
        report.sigma_pose_deg,
        report.pose_correction_m,
        report.pose_correction_deg
    );
    let found = split.localize(&map, extractor.as_mut(), QUERY_FEATURES, |image| image);
    tell("even in odd", &found);
    assert!(within(&found, 0.05, 1.0) >= 45);
    assert_eq!(wrong_by(&found, 0.5), 0);
}

/// COLMAP's own model of these images, without poses: every other image of camera 0 as a map, the rest localized in it.
#[test]
#[ignore = "needs the recordings in target/data"]
fn images_are_localized_in_a_model_of_colmap() {
    let mut split = odd_images();
    let mut model = read_model(&recording("colmap_v1_01")).unwrap();
    let config = odometry_config(&split.sequence).unwrap();
    let frame = ColmapFrame::of_recording(&model, &split.sequence, None, &config).unwrap();
    let stamp =
        |image: &ColmapImage| image.name.strip_prefix("cam0/")?.strip_suffix(".jpg")?.parse::<i64>().ok();
    let in_map: Vec<i64> = split.map.iter().map(|&index| split.sequence.frames[index].stamp_ns).collect();
    model.images.retain(|_, image| stamp(image).is_some_and(|stamp_ns| in_map.contains(&stamp_ns)));
    let mut extractor = classical();
    let mut extraction = Extraction {
        extractor: extractor.as_mut(),
        others: &mut [],
        max_features: MAP_FEATURES,
        masks: &[],
        cameras: 1,
    };
    let folder = recording("images").join("v1_01_keyframes/mav0/cam0/data");
    let read = |name: &str| GrayImage::read(&folder.join(name.trim_start_matches("cam0/")));
    let (contents, report) =
        import_colmap(&model, &frame, read, &mut extraction, ["room", "test"], &mut |_, _, _| {}).unwrap();
    println!("{report:?}");
    assert_eq!(report.keyframes, in_map.len());

    // The truth in the frame and the scale of the map: its baseline is off by almost 2 %.
    let truth = TruthTrack::new(split.sequence.groundtruth.as_deref().unwrap());
    let imu_from_camera = split.sequence.cameras[0].imu_from_camera;
    let pair = |keyframe: &map::model::Keyframe| {
        let true_pose = truth.pose(keyframe.stamp_ns, 110_000_000)? * imu_from_camera;
        Some((keyframe.global_from_keyframe.pose.translation, true_pose.translation))
    };
    let mut pairs: Vec<_> = contents.keyframes.iter().filter_map(pair).collect();
    let spread = |points: Vec<Vector3<f64>>| {
        let mean = points.iter().sum::<Vector3<f64>>() / points.len() as f64;
        points.iter().map(|point| (point - mean).norm_squared()).sum::<f64>().sqrt()
    };
    let (in_map, in_truth): (Vec<_>, Vec<_>) = pairs.iter().copied().unzip();
    let scale = spread(in_map) / spread(in_truth);
    assert!((scale - 1.0).abs() < 3.0 * report.sigma_scale, "scale {scale}");
    // Rotated about the camera, so that the lever arm keeps its length.
    let scaled = |pose: geometry::Pose| {
        let camera = pose.compose(&imu_from_camera);
        let camera = geometry::Pose::new(camera.rotation, camera.translation * scale);
        camera.compose(&imu_from_camera.inverse())
    };
    for pair in &mut pairs {
        pair.1 *= scale;
    }
    let map_from_truth = align(&pairs, &Alignment::Se3).unwrap();
    let rms =
        pairs.iter().map(|pair| (map_from_truth.transform(&pair.1) - pair.0).norm_squared()).sum::<f64>();
    let rms = (rms / pairs.len() as f64).sqrt();
    println!("keyframes {rms:.4} m, scale {scale:.4}");
    assert!(rms < 0.0085, "{rms} m");
    for row in split.sequence.groundtruth.iter_mut().flatten() {
        row.pose = map_from_truth.compose(&scaled(row.pose));
    }
    let map = LoadedMap::from_contents(contents).unwrap();
    let found = split.localize(&map, extractor.as_mut(), QUERY_FEATURES, |image| image);
    tell("even in odd of COLMAP", &found);
    assert!(within(&found, 0.05, 1.0) >= 45, "{}", within(&found, 0.05, 1.0));
    assert_eq!(wrong_by(&found, 0.5), 0);
}

#[test]
#[ignore = "needs the recordings in target/data"]
fn later_images_are_localized_in_a_map_of_the_first_50_s() {
    let sequence = vicon_room();
    let first_ns = sequence.frames[0].stamp_ns;
    let split = Split::new(sequence, |_, frame| frame.stamp_ns - first_ns < 50_000_000_000);
    let mut extractor = classical();
    let (map, _) = split.build(extractor.as_mut(), MAP_FEATURES);
    let found = split.localize(&map, extractor.as_mut(), QUERY_FEATURES, |image| image);
    tell("later in the first 50 s", &found);
    assert!(within(&found, 0.10, 2.0) >= 22);
    assert_eq!(wrong_by(&found, 0.5), 0);
}

/// The whole flight with one image every one to five seconds: nothing to track, only the map and the IMU.
#[test]
#[ignore = "needs the recordings in target/data"]
fn few_images_keep_a_robot_in_the_map() {
    let split = odd_images();
    let (map, _) = split.build(classical().as_mut(), MAP_FEATURES);
    let mut live = split.sequence.clone();
    live.frames = split.queries.iter().map(|&index| split.sequence.frames[index].clone()).collect();
    let out = tempfile::tempdir().unwrap();
    let outcome = run_in_map(&live, out.path(), "--cameras mono", &map);
    let truth = TruthTrack::new(live.groundtruth.as_deref().unwrap());
    let initialized_ns =
        outcome.states().unwrap().iter().find(|state| state.global_from_imu.is_some()).unwrap().stamp_ns;
    let (mut last_ns, mut scored) = (i64::MIN, 0);
    for state in outcome.states().unwrap().iter().filter(|state| state.stamp_ns > initialized_ns + SETTLED_NS)
    {
        let gap_ns = state.stamp_ns.saturating_sub(last_ns);
        last_ns = state.stamp_ns;
        let estimate = state.global_from_imu.as_ref().unwrap();
        let Some(truth) = truth.pose(state.stamp_ns, 110_000_000) else { continue };
        let error = estimate.pose.local(&truth);
        let (theta, p) = (error.fixed_rows::<3>(0).norm().to_degrees(), error.fixed_rows::<3>(3).norm());
        let sigmas = estimate.covariance.diagonal().map(f64::sqrt);
        println!("after {:.2} s: {p:.3} m, {theta:.2} deg, sigma {sigmas:.4?}", gap_ns as f64 * 1e-9);
        if gap_ns < 2_000_000_000 {
            scored += 1;
            assert!(p <= 0.10, "{p} m after a gap of {} s", gap_ns as f64 * 1e-9);
        }
        for axis in 3..6 {
            assert!(error[axis].abs() <= 3.0 * sigmas[axis].hypot(TRUTH_SIGMA), "{error:?} of {sigmas:?}");
        }
    }
    assert!(scored > 15, "only {scored} states were scored");
}

#[test]
#[ignore = "needs the recordings in target/data"]
fn odometry_from_the_images_of_one_shaken_camera() {
    let sequence = recorded_images("mh_01_handheld_16s");
    let out = tempfile::tempdir().unwrap();
    let switches = "--mode odometry --cameras mono --init truth";
    let score = run(&sequence, out.path(), switches, None).summary.score.unwrap();
    println!("{:?}, aligned {:?}", score.local, score.odometry_yaw_aligned_m);
    assert!(score.odometry_yaw_aligned_m.rmse <= 0.02 && score.local.rmse_deg <= 1.0);
}

/// Learned extractors: EdgePoint2, and XFeat where its weights are there.
mod learned {
    use super::*;

    const MAP_FEATURES: usize = 1500;

    /// 8 grey levels of noise, the same in every run.
    fn noise(index: usize) -> f32 {
        let mixed = (index as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ (index as u64) << 17;
        let sum: u32 = (0..4).map(|part| (mixed >> (16 * part) & 0xffff) as u32).sum();
        (sum as f32 / 65536.0 - 2.0) * 3.0_f32.sqrt() * 8.0
    }

    fn mapped(image: &GrayImage, value: impl Fn(usize, f32) -> f32) -> GrayImage {
        let (width, height) = (image.width(), image.height());
        GrayImage::from_fn(width, height, |x, y| {
            value(y * width + x, f32::from(image.get(x, y))).round().clamp(0.0, 255.0) as u8
        })
    }

    /// A blur with a standard deviation of 2 px.
    fn blurred(image: &GrayImage) -> GrayImage {
        let weights: Vec<f32> = (-6..=6).map(|k: i32| (-(k * k) as f32 / 8.0).exp()).collect();
        let sum: f32 = weights.iter().sum();
        let along = |image: &GrayImage, dx: isize, dy: isize| {
            let clamped = |at: usize, step: isize, most: usize| at.saturating_add_signed(step).min(most);
            GrayImage::from_fn(image.width(), image.height(), |x, y| {
                let value = |(k, weight): (isize, &f32)| {
                    let (u, v) =
                        (clamped(x, k * dx, image.width() - 1), clamped(y, k * dy, image.height() - 1));
                    weight * f32::from(image.get(u, v))
                };
                ((-6..).zip(&weights).map(value).sum::<f32>() / sum).round() as u8
            })
        };
        along(&along(image, 1, 0), 0, 1)
    }

    #[test]
    #[ignore = "needs the recordings in target/data"]
    fn images_are_localized_by_edgepoint_in_good_light_and_bad() {
        assert_images_are_localized("edgepoint2-1");
    }

    #[test]
    #[ignore = "needs the recordings in target/data, and the weights of XFeat"]
    fn images_are_localized_by_xfeat_in_good_light_and_bad() {
        assert_images_are_localized("xfeat-1");
    }

    fn assert_images_are_localized(name: &str) {
        let mut extractor = open(name, None).unwrap_or_else(|error| panic!("{error}"));
        let split = odd_images();
        let (map, _) = split.build(extractor.as_mut(), MAP_FEATURES);
        let found = split.localize(&map, extractor.as_mut(), QUERY_FEATURES, |image| image);
        tell(&format!("even in odd, {name}"), &found);
        assert_eq!(wrong_by(&found, 0.5), 0);
        assert!(within(&found, 0.05, 1.0) >= 48);
        let dark = |image: GrayImage| mapped(&image, |_, value| 255.0 * (value / 255.0).powf(2.5));
        let noisy = |image: GrayImage| mapped(&image, |index, value| 0.4 * value + noise(index));
        let blurred = |image: GrayImage| blurred(&image);
        let changes: [(&str, &dyn Fn(GrayImage) -> GrayImage); 3] =
            [("darkened", &dark), ("noisy", &noisy), ("blurred", &blurred)];
        for (what, change) in changes {
            let found = split.localize(&map, extractor.as_mut(), QUERY_FEATURES, change);
            tell(what, &found);
            let fewest = if what == "noisy" { 30 } else { 40 };
            assert!(within(&found, 0.10, 2.0) >= fewest, "{what}");
            assert_eq!(wrong_by(&found, 0.5), 0, "{what}");
        }
    }
}
