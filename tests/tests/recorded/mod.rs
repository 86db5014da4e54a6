//! The recorded runs, with the bounds that the system must keep on them.
//!
//! The recordings are not part of the repository. Where they are unpacked to `target/data`, run these tests with
//!
//! ```sh
//! cargo test --release -p driftless-tests -- --ignored recorded:: images::
//! ```
//!
//! Without a recording its test fails and names it.

use evaluation::trajectory::StampedPose;
use evaluation::{Alignment, Pair, Score, absolute_errors, align, interpolate_reference};
use geometry::Pose;
use map::MapContents;
use map_io::text::{read_map, write_map};
use mapping::{
    BuildOptions, BuildReport, Extraction, PosePriors, StoredPoses, build_map, build_map_from_odometry,
    register_stereo_images,
};
use mapping::{is_sparse, odometry_config, run_odometry};
use nalgebra::{Matrix3, Vector3};
use onboard::{Outcome, RobotArguments};
use recognition::LoadedMap;
use sensors::Sequence;
use std::path::Path;
use std::sync::Arc;
use tests::data::{data_folder, recording};
use tests::robot::{arguments, run};
use tools::in_process::LocalServer;
use vision::FeatureExtractor;
use vision::features::open;

fn imported(folder: &Path) -> Arc<LoadedMap> {
    Arc::new(LoadedMap::from_contents(read_map(folder).unwrap()).unwrap())
}

fn built(sequence: &Path, until_s: f64, stored_poses: StoredPoses) -> Arc<LoadedMap> {
    let sequence = Sequence::open(sequence).unwrap();
    let references = sequence.reference_poses.clone().unwrap();
    let mut options = BuildOptions::default();
    options.until_s = until_s;
    options.stored_poses = stored_poses;
    let (contents, _) = build_map(&sequence, &references, None, &options, &mut |_, _, _| {}).unwrap();
    Arc::new(LoadedMap::from_contents(contents).unwrap())
}

fn localize(live: &Path, map: &Arc<LoadedMap>, switches: &str) -> Outcome {
    localize_into(tempfile::tempdir().unwrap().path(), live, map, switches)
}

/// [`localize`] whose files stay.
fn localize_into(out: &Path, live: &Path, map: &Arc<LoadedMap>, switches: &str) -> Outcome {
    let sequence = Sequence::open(live).unwrap();
    let server = LocalServer::start(vec![("map".to_owned(), Arc::clone(map))]).unwrap();
    let link = server.link("map").unwrap();
    let outcome = run(&sequence, out, switches, Some(link.clone()));
    server.unlink(&link);
    server.stop().unwrap();
    outcome
}

/// The score of the pose in G, after checking it against bounds in metres and degrees.
fn pose_within(outcome: &Outcome, metres: f64, degrees: f64) -> Score {
    let score = outcome.summary.score.as_ref().unwrap().pose.unwrap();
    assert!(score.rmse_m <= metres, "{} m, {metres} m allowed", score.rmse_m);
    assert!(score.rmse_deg <= degrees, "{} deg, {degrees} deg allowed", score.rmse_deg);
    score
}

fn assert_consistent(score: &Score) {
    let nees = score.nees_pose.unwrap();
    assert!((0.5..=1.5).contains(&nees), "NEES {nees}");
}

#[test]
#[ignore = "needs the recordings in target/data"]
fn the_papers_simulation() {
    let (map, live) = (recording("yq/map"), recording("yq/live"));
    let (refined, map) =
        (built(&map, f64::INFINITY, StoredPoses::Refined), built(&map, f64::INFINITY, StoredPoses::Given));
    let runs = [(&refined, "multi"), (&map, "single"), (&map, "multi"), (&map, "mapconst")];
    // Minutes of one processor each.
    let [of_refined, single, multi, exact] = std::thread::scope(|scope| {
        let run = |(map, mode)| {
            let live = &live;
            scope.spawn(move || localize(live, map, &format!("--init truth --mode {mode}")))
        };
        runs.map(run).map(|running| running.join().unwrap())
    });
    assert_consistent(&pose_within(&of_refined, 0.05, 0.12));
    assert_consistent(&pose_within(&single, 0.13, 0.30));
    let score = pose_within(&multi, 0.10, 0.25);
    assert_consistent(&score);
    assert!(multi.summary.score.as_ref().unwrap().local.rmse_m <= 0.20);
    // Taking the map for exact costs three times the error and all consistency.
    let exact = exact.summary.score.unwrap().pose.unwrap();
    assert!(exact.rmse_m > 3.0 * score.rmse_m && exact.nees_pose.unwrap() > 50.0);
}

#[test]
#[ignore = "needs the recordings in target/data"]
fn the_papers_place_with_its_real_matches() {
    let (map, live) = (recording("yq_real/map"), recording("yq_real/live"));
    let outcome = localize(&live, &imported(&map), "--init truth --mode single");
    let score = pose_within(&outcome, 0.30, 0.35);
    assert_consistent(&score);
    assert!(score.max_m < 0.8, "a wrong match moved the pose: {} m", score.max_m);
}

#[test]
#[ignore = "needs the recordings in target/data"]
fn real_imu_and_real_matches() {
    // The ground truth of v202 rotates by half a degree against its own images: no filter can be consistent with it.
    for (place, metres, degrees, is_sound) in
        [("mh05_on_mh01", 0.063, 0.5, true), ("v202_on_v201", 0.0265, 0.5, false)]
    {
        let folder = format!("euroc_real/{place}");
        let folder = recording(&folder);
        let map = imported(&folder.join("map"));
        let outcome = localize(&folder.join("live"), &map, "--init truth --mode single");
        let score = pose_within(&outcome, metres, degrees);
        if is_sound {
            let nees = score.nees_pose.unwrap();
            assert!((0.5..=2.0).contains(&nees), "NEES {nees}");
        }
    }
}

#[test]
#[ignore = "needs the recordings in target/data"]
fn a_hall_mapped_by_another_flight() {
    let (map, live) = (recording("odometry/MH_01_easy"), recording("odometry/MH_03_medium"));
    let map = built(&map, f64::INFINITY, StoredPoses::Refined);
    pose_within(&localize(&live, &map, "--init truth --mode single"), 0.03, 0.3);
    pose_within(&localize(&live, &map, "--init truth --mode multi"), 0.025, 0.3);
}

/// A map without reference poses, from a folder.
fn built_from_odometry(folder: &Path) -> (Sequence, MapContents, BuildReport) {
    let mut sequence = Sequence::open(folder).unwrap();
    let cameras = sequence.cameras.len();
    let odometry = run_odometry(&mut sequence, cameras, |_, _| {}).unwrap();
    let options = BuildOptions::default();
    let (contents, report) = build_map_from_odometry(
        &sequence,
        &odometry,
        &PosePriors::default(),
        None,
        &options,
        &mut |_, _, _| {},
    )
    .unwrap();
    (sequence, contents, report)
}

/// Aligns the truth with a map by yaw and position.
///
/// # Returns
/// `global_from_truth`, and the errors of the keyframes (m, deg).
fn errors_of(sequence: &Sequence, contents: &MapContents) -> (Pose, f64, f64) {
    let truth: Vec<StampedPose> = sequence
        .groundtruth
        .iter()
        .flatten()
        .map(|row| StampedPose { stamp_ns: row.stamp_ns, pose: row.pose })
        .collect();
    let camera_from_imu = sequence.cameras[0].imu_from_camera.inverse();
    let of_imu = |keyframe: &map::Keyframe| StampedPose {
        stamp_ns: keyframe.stamp_ns,
        pose: keyframe.global_from_keyframe.pose.compose(&camera_from_imu),
    };
    let estimate: Vec<StampedPose> = contents.keyframes.iter().map(of_imu).collect();
    let (truth, pairs) = interpolate_reference(&truth, &estimate, 60_000_000);
    assert!(pairs.len() + 5 > estimate.len(), "{} of {} keyframes", pairs.len(), estimate.len());
    let positions: Vec<_> = pairs
        .iter()
        .map(|pair| (estimate[pair.estimate].pose.translation, truth[pair.reference].pose.translation))
        .collect();
    let gravity = -Vector3::z();
    let yaw = Alignment::Yaw { gravity_in_reference: gravity, gravity_in_estimate: gravity };
    // The truth is moved into the map.
    let global_from_truth = align(&positions, &yaw).unwrap();
    let errors = absolute_errors(&estimate, &truth, &swapped(&pairs), &global_from_truth);
    (global_from_truth, errors.translation().unwrap().rmse, errors.rotation().unwrap().rmse)
}

#[test]
#[ignore = "needs the recordings in target/data"]
fn a_hall_mapped_without_reference_poses() {
    let (sequence, contents, report) = built_from_odometry(&recording("odometry/MH_01_easy"));
    assert!(report.loops > 100 && report.refused_loops * 20 < report.loops, "{report:?}");
    let (global_from_truth, metres, degrees) = errors_of(&sequence, &contents);
    assert!(metres < 0.006 && degrees < 0.06, "{metres} m, {degrees} deg");

    let map = Arc::new(LoadedMap::from_contents(contents).unwrap());
    let mut live = Sequence::open(&recording("odometry/MH_03_medium")).unwrap();
    for row in live.groundtruth.iter_mut().flatten() {
        row.pose = global_from_truth.compose(&row.pose);
        row.velocity = row.velocity.map(|velocity| global_from_truth.rotation * velocity);
    }
    let server = LocalServer::start(vec![("map".to_owned(), map)]).unwrap();
    let link = server.link("map").unwrap();
    let out = tempfile::tempdir().unwrap();
    let outcome = run(&live, out.path(), "--init truth --mode multi", Some(link.clone()));
    server.unlink(&link);
    server.stop().unwrap();
    assert_consistent(&pose_within(&outcome, 0.02, 0.15));
}

fn swapped(pairs: &[Pair]) -> Vec<Pair> {
    pairs.iter().map(|pair| Pair { reference: pair.estimate, estimate: pair.reference }).collect()
}

fn extraction_by(extractor: &mut Box<dyn FeatureExtractor>) -> Extraction<'_> {
    Extraction {
        extractor: extractor.as_mut(),
        others: &mut [],
        max_features: 1000,
        mask: None,
        cameras: usize::MAX,
    }
}

#[test]
#[ignore = "needs the recordings in target/data"]
fn a_room_of_sparse_stereo_images_mapped_without_reference_poses() {
    let sequence = Sequence::open(&recording("images/v1_01_keyframes")).unwrap();
    assert!(is_sparse(&sequence));
    let mut extractor = open("sift-1", None).unwrap();
    let config = odometry_config(&sequence).unwrap();
    let odometry =
        register_stereo_images(&sequence, extraction_by(&mut extractor), &config, &mut |_, _, _| {}).unwrap();
    let mut options = BuildOptions::default();
    options.min_distance = 0.01;
    let (contents, _) = build_map_from_odometry(
        &sequence,
        &odometry,
        &PosePriors::default(),
        Some(extraction_by(&mut extractor)),
        &options,
        &mut |_, _, _| {},
    )
    .unwrap();
    assert_eq!(contents.keyframes.len(), 100);
    let (_, metres, degrees) = errors_of(&sequence, &contents);
    // 0.9 % of scale and 0.4 deg are the calibration's.
    assert!(metres < 0.025 && degrees < 0.5, "{metres} m, {degrees} deg");
}

#[test]
#[ignore = "needs the recordings in target/data"]
fn a_walk_without_reference_poses_ends_where_it_began() {
    let (_, contents, report) = built_from_odometry(&recording("walk"));
    // Doors that look alike are metres apart: the better odometry is, the more of them are refused.
    assert!(report.loops > 40 && report.refused_loops > 5, "{report:?}");
    let first_ns = contents.keyframes[0].stamp_ns;
    let seconds = |stamp_ns: i64| (stamp_ns - first_ns) as f64 * 1e-9;
    // Landmarks of the first ten seconds are seen again in the end.
    let at = |id: u64| contents.keyframes.iter().find(|keyframe| keyframe.id == id).unwrap();
    let spans = |landmark: &&map::Landmark| {
        let stamps: Vec<f64> =
            landmark.observations.iter().map(|o| seconds(at(o.keyframe).stamp_ns)).collect();
        stamps.iter().any(|&t| t < 10.0) && stamps.iter().any(|&t| t > 105.0)
    };
    let fused = contents.landmarks.iter().filter(spans).count();
    assert!(fused > 50, "{fused} landmarks");
}

#[test]
#[ignore = "needs the recordings in target/data"]
fn ten_loops_in_a_map_whose_gravity_is_not_along_z() {
    let folder = recording("loops/scenario_1");
    let outcome =
        localize(&folder.join("live"), &imported(&folder.join("map")), "--init truth --mode single");
    assert_consistent(&pose_within(&outcome, 0.15, 0.30));
}

#[test]
#[ignore = "needs the recordings in target/data"]
fn a_walk_that_comes_back_to_its_start_is_localized_again() {
    let folder = recording("walk");
    let (out, map) = (tempfile::tempdir().unwrap(), built(&folder, 10.0, StoredPoses::Refined));
    let outcome = localize_into(out.path(), &folder, &map, "");
    let first_ns = outcome.states().unwrap()[0].stamp_ns;
    let again = |event: &&onboard::Event| event.accepted && event.stamp_ns > first_ns + 105_000_000_000;
    assert!(outcome.events().unwrap().iter().filter(again).count() > 10);
    let status = outcome.summary.final_status.unwrap();
    assert_eq!(status.localization, estimator::Localization::Localized, "{}", status.reason);
}

#[test]
#[ignore = "needs the recordings in target/data"]
fn odometry_alone() {
    let live = recording("yq/live");
    let sequence = Sequence::open(&live).unwrap();
    let out = tempfile::tempdir().unwrap();
    let parsed: RobotArguments = arguments(out.path(), "--init truth --mode odometry");
    let outcome = onboard::run_robot(&sequence, &parsed, None, |_| {}).unwrap();
    // OpenVINS reaches 0.541 m on this very stream.
    assert!(outcome.summary.score.unwrap().odometry_yaw_aligned_m.rmse <= 0.541);
}

/// Least squares scale of odometry against the truth over the first ten seconds after the start (Umeyama).
fn scale_of_odometry(outcome: &Outcome, sequence: &Sequence) -> f64 {
    let truth = sequence.groundtruth.as_deref().unwrap();
    let states = &outcome.states().unwrap();
    let until_ns = states[0].stamp_ns + 10_000_000_000;
    let pairs: Vec<_> = states
        .iter()
        .take_while(|state| state.stamp_ns <= until_ns)
        .filter_map(|state| {
            let row = truth.iter().find(|row| (row.stamp_ns - state.stamp_ns).abs() < 1_000_000)?;
            Some((state.local_from_imu.pose.translation, row.pose.translation))
        })
        .collect();
    assert!(pairs.len() > 80);
    let count = pairs.len() as f64;
    let (mean, true_mean) =
        pairs.iter().fold((Vector3::zeros(), Vector3::zeros()), |sum, pair| (sum.0 + pair.0, sum.1 + pair.1));
    let (mean, true_mean) = (mean / count, true_mean / count);
    let mut cross = Matrix3::zeros();
    let mut spread = 0.0;
    for (estimated, true_place) in &pairs {
        cross += (estimated - mean) * (true_place - true_mean).transpose();
        spread += (true_place - true_mean).norm_squared();
    }
    // Both are one rigid shape, so the rotation that aligns them turns the cross covariance into its singular values.
    cross.svd(false, false).singular_values.sum() / spread
}

#[test]
#[ignore = "needs the recordings in target/data"]
fn starts_in_motion_without_truth() {
    for name in ["odometry/udel_gore", "odometry/MH_03_medium"] {
        let folder = recording(name);
        let sequence = Sequence::open(&folder).unwrap();
        for cameras in ["mono", "stereo"] {
            for start in [5, 20, 35, 50, 70] {
                let out = tempfile::tempdir().unwrap();
                // Ten seconds for the scale and the minute after in which nothing may diverge.
                let switches =
                    format!("--mode odometry --cameras {cameras} --start-at {start} --duration 62");
                let outcome = run(&sequence, out.path(), &switches, None);
                let case = format!("{name} {cameras} from {start} s");
                let summary = &outcome.summary;
                assert!(summary.starts[0].seconds < 2.0, "{case}: after {} s", summary.starts[0].seconds);
                assert!(summary.divergences.is_empty(), "{case}: {:?}", summary.divergences);
                let scale = scale_of_odometry(&outcome, &sequence);
                assert!((scale - 1.0).abs() < 0.05, "{case}: scale {scale}");
                let error = summary.score.as_ref().unwrap().odometry_yaw_aligned_m.rmse;
                assert!(error < 0.10, "{case}: {error} m");
            }
        }
    }
}

#[test]
#[ignore = "needs the recordings in target/data"]
fn every_recording_is_read_and_its_gravity_found() {
    let mut folders = vec![data_folder()];
    let mut recordings = 0;
    while let Some(folder) = folders.pop() {
        if folder.join("mav0").is_dir() {
            let sequence = Sequence::open(&folder).unwrap_or_else(|error| panic!("{error}"));
            assert!(!sequence.frames.is_empty());
            let down = if folder.to_string_lossy().contains("loops") { -Vector3::x() } else { -Vector3::z() };
            let known = sequence.imu.is_some() && sequence.groundtruth.is_some();
            assert_eq!(sequence.truth_gravity(), known.then_some(down), "{}", folder.display());
            recordings += 1;
            continue;
        }
        let entries = std::fs::read_dir(&folder).into_iter().flatten().flatten();
        folders.extend(entries.map(|entry| entry.path()).filter(|path| path.is_dir()));
    }
    assert!(recordings > 0, "no recording is unpacked in {}", data_folder().display());
}

#[test]
#[ignore = "needs the recordings in target/data"]
fn recorded_maps_survive_a_round_trip() {
    for name in ["loops/scenario_1", "yq_real", "euroc_real/mh05_on_mh01", "euroc_real/v202_on_v201"] {
        let contents = read_map(&recording(name).join("map")).unwrap();
        let copy = tempfile::tempdir().unwrap();
        write_map(copy.path(), &contents).unwrap();
        assert_eq!(read_map(copy.path()).unwrap(), contents);
        assert_eq!(std::fs::read_dir(copy.path()).unwrap().count(), 4, "{name}");
    }
}
