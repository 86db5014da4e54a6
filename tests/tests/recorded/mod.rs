//! The recorded runs, with the bounds that the system must keep on them.
//!
//! The recordings are not part of the repository. Where they are unpacked to `target/data`, run these tests with
//!
//! ```sh
//! cargo test --release -p driftless-tests -- --ignored recorded:: images::
//! ```
//!
//! Without a recording its test fails and names it. `just recorded` leaves out those of [`long`], `just nightly` does not.

use evaluation::Score;
use map_io::text::{read_map, write_map};
use mapping::{BuildOptions, StoredPoses, build_map};
use nalgebra::Vector3;
use onboard::Outcome;
use recognition::LoadedMap;
use sensors::Sequence;
use std::path::Path;
use std::sync::Arc;
use tests::data::{data_folder, recording};
use tests::robot::run_in_map;

mod long;
mod map_without_poses;
mod starts;

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
    run_in_map(&Sequence::open(live).unwrap(), out, switches, map)
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
    let map = built(&recording("yq/map"), f64::INFINITY, StoredPoses::Refined);
    let outcome = localize(&recording("yq/live"), &map, "--init truth --mode multi");
    assert_consistent(&pose_within(&outcome, 0.05, 0.12));
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
