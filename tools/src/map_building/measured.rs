//! How near the landmarks of recorded places come to those that the true poses give. Run by hand:
//! `cargo test -p tools measured -- --ignored --nocapture`.

use std::collections::HashMap;
use std::path::Path;

use geometry::uncertain_pose::PoseWithCovariance;
use onboard::sequence::Sequence;

use super::locate::{Scene, locate};
use super::point::{CameraPose, Point};
use super::views::{View, select_views};
use super::*;

/// The views with their true poses, known to 1e-4.
fn true_views<'a>(sequence: &'a Sequence, options: &BuildOptions, views: &[View<'a>]) -> Vec<View<'a>> {
    let imu_from_camera = sequence.cameras[0].imu_from_camera;
    let truth: HashMap<i64, _> =
        sequence.groundtruth.as_ref().unwrap().iter().map(|row| (row.stamp_ns, row.pose)).collect();
    assert!(options.sigma_p.is_none());
    views
        .iter()
        .map(|view| View {
            stamp_ns: view.stamp_ns,
            features: view.features,
            rays: view.rays.clone(),
            prior: PoseWithCovariance::new(
                truth[&view.stamp_ns] * imu_from_camera,
                nalgebra::Matrix6::identity() * 1e-8,
            ),
        })
        .collect()
}

fn report_accuracy(name: &str, points: &[Point], scene: &Scene<'_>, views: &[View<'_>]) {
    let (mut depth, mut pixels, mut wrong, mut parallax_free) = (Vec::new(), Vec::new(), 0, 0);
    let mut short = Vec::new();
    for point in points {
        let track: Vec<_> = point.sightings.iter().map(|sighting| sighting.feature).collect();
        let (exact, dropped) = locate(scene, &track, 2);
        wrong += dropped.len();
        let Some(exact) = exact.filter(|_| dropped.is_empty()) else { continue };
        let Some(exact) = exact.anchored_at(point.anchor, scene.poses) else { continue };
        let ratio = (exact.inverse_depth / point.inverse_depth).ln().abs();
        let spread = point
            .sightings
            .iter()
            .map(|s| (scene.poses[s.view()].position - scene.poses[point.anchor_view()].position).norm())
            .fold(0.0, f64::max);
        if spread * exact.inverse_depth < 0.02 {
            parallax_free += 1;
            continue;
        }
        depth.push(ratio);
        if track.len() == 2 {
            short.push(ratio);
        }
        let anchor = &scene.poses[point.anchor_view()];
        for (index, sighting) in point.sightings.iter().enumerate() {
            let pose = &scene.poses[sighting.view()];
            let pair = (point.project(scene.camera, anchor, pose), exact.project(scene.camera, anchor, pose));
            if let (Some(a), Some(b), true) = (pair.0, pair.1, index != point.anchor) {
                pixels.push((a - b).norm());
            }
        }
    }
    let counts: usize = points.iter().map(|point| point.sightings.len()).sum();
    println!(
        "{name}: {} landmarks, {counts} observations, {wrong} wrong, {parallax_free} without parallax\n  depth (relative) {:.4?}\n  of tracks of 2 {:.4?}\n  px {:.2?}",
        points.len(),
        Spread::of(depth),
        Spread::of(short),
        Spread::of(pixels)
    );
    let _ = views;
}

#[test]
#[ignore = "takes a minute, and needs the recorded data"]
fn measured() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../target/data");
    for place in ["odometry/MH_01_easy", "yq/map"] {
        let sequence = Sequence::open(&data.join(place)).unwrap();
        let references = sequence.reference_poses.clone().unwrap();
        let options = BuildOptions::default();
        let views = select_views(&sequence, &references, &options).unwrap();
        let camera = &sequence.cameras[0].camera;
        let exact = true_views(&sequence, &options, &views);
        let poses: Vec<CameraPose> = exact.iter().map(|view| CameraPose::from(&view.prior.pose)).collect();
        let scene = Scene { camera, views: &exact, poses: &poses, pixel_sigma: 1.0 };
        let mut report = BuildReport::default();
        let start = Instant::now();
        let matches = match_all(camera, &views, &options, &mut report, &mut |_, _, _| ()).unwrap();
        println!(
            "{place}: {} views, {} pairs, {} matches, {:?}",
            views.len(),
            report.pairs,
            report.matches,
            start.elapsed()
        );
        let points = locate_all(camera, &views, matches, &options, &mut report, &mut |_, _, _| ());
        println!("located {:?}", start.elapsed());
        report_accuracy("located alone", &points, &scene, &views);
        let bundle = refine_all(camera, &views, points, &options, &mut report, &mut |_, _, _| ());
        println!("refined {:?}, dropped {}", start.elapsed(), report.dropped_observations);
        report_accuracy("refined together", &bundle.points, &scene, &views);
        let errors = |poses: &mut dyn Iterator<Item = (geometry::pose::Pose, &View<'_>)>| {
            let errors: Vec<_> = poses.map(|(pose, truth)| truth.prior.pose.local(&pose)).collect();
            let rms = |from: usize| {
                (errors.iter().map(|e| e.rows(from, 3).norm_squared()).sum::<f64>() / errors.len() as f64)
                    .sqrt()
            };
            (rms(0).to_degrees(), rms(3))
        };
        println!("given poses {:?}", errors(&mut views.iter().map(|v| v.prior.pose).zip(&exact)));
        println!("refined poses {:?}", errors(&mut bundle.poses.iter().copied().zip(&exact)));
    }
}
