//! The recorded runs that take minutes.

use super::map_without_poses::{built_from_odometry, errors_of};
use super::starts::starts_in_motion;
use super::{assert_consistent, built, imported, localize, pose_within};
use mapping::{
    BuildOptions, Extraction, PosePriors, StoredPoses, build_map_from_odometry, is_sparse, odometry_config,
    register_stereo_images,
};
use onboard::RobotArguments;
use sensors::Sequence;
use tests::data::recording;
use tests::robot::arguments;
use vision::FeatureExtractor;
use vision::features::open;

#[test]
#[ignore = "needs the recordings in target/data"]
fn the_papers_simulation_in_all_modes() {
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
fn odometry_alone() {
    let live = recording("yq/live");
    let sequence = Sequence::open(&live).unwrap();
    let out = tempfile::tempdir().unwrap();
    let parsed: RobotArguments = arguments(out.path(), "--init truth --mode odometry");
    let outcome = onboard::run_robot(&sequence, &parsed, None, |_| {}).unwrap();
    // OpenVINS reaches 0.541 m on this very stream.
    assert!(outcome.summary.score.unwrap().odometry_yaw_aligned_m.rmse <= 0.541);
}

#[test]
#[ignore = "needs the recordings in target/data"]
fn all_starts_in_motion_without_truth() {
    starts_in_motion(&[5, 20, 35, 50, 70]);
}

fn extraction_by(extractor: &mut Box<dyn FeatureExtractor>) -> Extraction<'_> {
    Extraction {
        extractor: extractor.as_mut(),
        others: &mut [],
        max_features: 1000,
        masks: &[],
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
