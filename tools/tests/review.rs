//! A candidate is refused for what is wrong with it, in words, and an honest one passes.

use std::path::Path;
use std::sync::Arc;

use clap::Parser as _;
use geometry::{Pose, Rotation};
use map::edit::{keyframes_where, remove_keyframes};
use map::store::{load_map, save_map};
use map::{CommonError, MapContents};
use nalgebra::{Matrix6xX, Vector3};
use onboard::RobotArguments;
use onboard::arguments::CalibrationArguments;
use recognition::LoadedMap;
use testing::copy_folder;
use tools::review::{Drive, DriveRun, Gates, Review, ReviewedDrive, Side, Structure};

use crate::scratch::Scratch;

#[derive(clap::Parser)]
struct Line {
    #[command(flatten)]
    robot: RobotArguments,
}

/// A town, its live map, and a drive through it that is localized in that map.
struct Town {
    scratch: Scratch,
    map: MapContents,
    live: Side,
    /// With truth, and without.
    drives: [(Drive, DriveRun); 2],
}

fn side(title: &str, map: &MapContents) -> Side {
    Side { title: title.to_owned(), map: Arc::new(LoadedMap::from_contents(map.clone()).unwrap()) }
}

fn drive(scratch: &Scratch, recording: &Path, live: &Side) -> (Drive, DriveRun) {
    let out = scratch.path(recording.file_name().unwrap().to_str().unwrap());
    let robot = Line::try_parse_from(["robot", "--out", "out"]).unwrap().robot;
    let drive = Drive::read(recording, &CalibrationArguments::default(), &robot, &live.map, 0.5).unwrap();
    let run = drive.run_in(&live.map, &out.join("in_live")).unwrap();
    (drive, run)
}

impl Town {
    fn new() -> Town {
        let scratch = Scratch::new();
        scratch.run("simulate --out town --duration 18 --dropout 0");
        scratch.run("build-map town/map --map town.db --sigma-pixel 1 --gravity 0,0,-1");
        let map = load_map(scratch.path("town.db")).unwrap().contents;
        let live = side("release 1", &map);
        copy_folder(&scratch.path("town/live"), &scratch.path("unknown"));
        std::fs::remove_dir_all(scratch.path("unknown/mav0/state_groundtruth_estimate0")).unwrap();
        let drives = ["town/live", "unknown"].map(|name| drive(&scratch, &scratch.path(name), &live));
        Town { scratch, map, live, drives }
    }
}

/// Reviews a candidate with both drives.
fn review(town: &Town, name: &str, candidate: &MapContents) -> Review {
    let candidate = side(name, candidate);
    let reviewed = town.drives.iter().zip(["truth", "unknown"]).map(|((drive, in_live), folder)| {
        let run = drive.run_in(&candidate.map, &town.scratch.path(&format!("{name}-{folder}"))).unwrap();
        ReviewedDrive::of(drive, in_live, &run)
    });
    let review = Review::judged(&town.live, &candidate, reviewed.collect(), &Gates::default());
    println!("{name}");
    for drive in &review.drives {
        println!("{:?}\n{:?}", drive.live, drive.candidate);
    }
    for refusal in &review.refusals {
        println!("{:?} {}: {}", refusal.drive, refusal.gate, refusal.reason);
    }
    review
}

/// The gates that refuse: for the maps themselves, for the drive with truth, and for the one without.
fn gates(town: &Town, review: &Review) -> [Vec<&'static str>; 3] {
    let of = |drive: Option<&str>| {
        let refusals = review.refusals.iter().filter(|refusal| refusal.drive.as_deref() == drive);
        refusals.map(|refusal| refusal.gate).collect()
    };
    let [(truth, _), (unknown, _)] = &town.drives;
    [of(None), of(Some(truth.name())), of(Some(unknown.name()))]
}

/// The keyframes of a part of the drive, by order of time.
fn part(map: &MapContents, from: f64, to: f64) -> Vec<usize> {
    let mut order: Vec<usize> = (0..map.keyframes.len()).collect();
    order.sort_by_key(|at| map.keyframes[*at].stamp_ns);
    let at = |part: f64| (part * order.len() as f64) as usize;
    order[at(from)..at(to)].to_vec()
}

fn a_corner_that_is_0_3_m_off_is_refused(town: &Town) {
    let mut moved = town.map.clone();
    for at in part(&town.map, 0.35, 0.6) {
        let pose = &mut moved.keyframes[at].global_from_keyframe.pose;
        *pose = Pose::new(pose.rotation, pose.translation + Vector3::new(0.2, 0.2, 0.1));
    }
    let review = review(town, "moved", &moved);
    let [maps, truth, unknown] = gates(town, &review);
    assert!(maps.contains(&"--max-unexplained") && maps.contains(&"--max-moved-places"), "{maps:?}");
    assert!(!truth.is_empty() && unknown.contains(&"--max-disagreement-m"), "{truth:?} {unknown:?}");
    assert!(review.refusals[0].reason.contains("0.30 m"), "{:?}", review.refusals);
}

/// A corner that is off in a map that states an error of all its keyframes together of 0.4 m, as one that GNSS tied to the earth.
fn a_corner_that_is_off_in_a_map_that_is_uncertain_as_a_whole_is_found(town: &Town) {
    let mut uncertain = town.map.clone();
    let mut factor = Matrix6xX::zeros(3);
    factor.fixed_view_mut::<3, 3>(3, 0).fill_diagonal(0.4);
    let shared = &factor * factor.transpose();
    let ids: Vec<u64> = uncertain.keyframes.iter().map(|keyframe| keyframe.id).collect();
    for keyframe in &mut uncertain.keyframes {
        keyframe.global_from_keyframe.covariance += shared;
    }
    if uncertain.common_errors.is_empty() {
        uncertain.common_errors =
            ids.iter().map(|&keyframe| CommonError { keyframe, factor: factor.clone() }).collect();
    } else {
        for common in &mut uncertain.common_errors {
            let columns = common.factor.ncols();
            let mut wider = common.factor.clone().insert_columns(columns, 3, 0.0);
            wider.columns_mut(columns, 3).copy_from(&factor);
            common.factor = wider;
        }
    }
    uncertain.validate().unwrap();
    let mut moved = uncertain.clone();
    let corner = part(&uncertain, 0.35, 0.6);
    for &at in &corner {
        moved.keyframes[at].global_from_keyframe.pose.translation += Vector3::new(0.2, 0.2, 0.1);
    }
    let [live, candidate] = [&uncertain, &moved].map(|map| LoadedMap::from_contents(map.clone()).unwrap());
    let structure = Structure::between(&live, &candidate);
    assert!(structure.unexplained.len() > corner.len() / 2, "{:?}", structure.unexplained);
    assert!(!structure.moved_m.is_empty());
    // The whole map may be off.
    let mut shifted = uncertain.clone();
    for keyframe in &mut shifted.keyframes {
        keyframe.global_from_keyframe.pose.translation += Vector3::new(0.2, 0.2, 0.1);
    }
    let shifted = Structure::between(&live, &LoadedMap::from_contents(shifted).unwrap());
    assert!(shifted.unexplained.is_empty() && shifted.moved_m.is_empty(), "{:?}", shifted.unexplained);
}

/// All views in one direction, of a map that has each place in both.
fn views_in_one_direction_that_are_missing_are_found(town: &Town) {
    let mut both = town.map.clone();
    let next = both.keyframes.iter().map(|keyframe| keyframe.id).max().unwrap() + 1;
    for keyframe in &town.map.keyframes {
        let mut back = keyframe.clone();
        back.id += next;
        let about = Rotation::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI);
        back.global_from_keyframe.pose.rotation = about * back.global_from_keyframe.pose.rotation;
        both.keyframes.push(back);
    }
    both.info.sessions.clear();
    both.sort();
    let loaded = |map: &MapContents| LoadedMap::from_contents(map.clone()).unwrap();
    let mut ahead = both.clone();
    let backward = keyframes_where(&ahead, |keyframe| keyframe.id >= next);
    remove_keyframes(&mut ahead, &backward);
    let structure = Structure::between(&loaded(&both), &loaded(&ahead));
    assert!(
        2 * structure.emptied_m.len() >= structure.places,
        "{} of {}",
        structure.emptied_m.len(),
        structure.places
    );
    let unchanged = Structure::between(&loaded(&both), &loaded(&both));
    assert!(unchanged.emptied_m.is_empty() && unchanged.unexplained.is_empty());
}

fn half_of_a_place_that_is_missing_is_refused(town: &Town) {
    let mut half = town.map.clone();
    let gone: Vec<u64> = part(&town.map, 0.4, 1.0).iter().map(|at| town.map.keyframes[*at].id).collect();
    let chosen = keyframes_where(&half, |keyframe| gone.contains(&keyframe.id));
    remove_keyframes(&mut half, &chosen);
    let review = review(town, "half", &half);
    let [maps, truth, unknown] = gates(town, &review);
    assert!(maps.contains(&"--max-emptied"), "{maps:?}");
    for drive in [truth, unknown] {
        assert!(
            drive.contains(&"--min-accepted") && drive.contains(&"--max-map-initialization-s"),
            "{drive:?}"
        );
    }
}

fn two_places_that_are_swapped_are_refused(town: &Town) {
    let mut swapped = town.map.clone();
    for (one, other) in part(&town.map, 0.2, 0.35).into_iter().zip(part(&town.map, 0.55, 0.7)) {
        let poses = [one, other].map(|at| town.map.keyframes[at].global_from_keyframe.pose);
        swapped.keyframes[one].global_from_keyframe.pose = poses[1];
        swapped.keyframes[other].global_from_keyframe.pose = poses[0];
    }
    let review = review(town, "swapped", &swapped);
    let [maps, truth, unknown] = gates(town, &review);
    assert!(maps.contains(&"--max-unexplained"), "{maps:?}");
    for drive in [truth, unknown] {
        assert!(drive.contains(&"--max-wrong"), "{drive:?}");
    }
}

fn an_honest_candidate_passes(town: &Town) {
    // Every sixth keyframe is gone, and an adjustment moved the others within their covariance.
    let mut honest = town.map.clone();
    let chosen = keyframes_where(&honest, |keyframe| keyframe.id % 6 == 3);
    remove_keyframes(&mut honest, &chosen);
    for keyframe in &mut honest.keyframes {
        let phase = keyframe.id as f64;
        let pose = &mut keyframe.global_from_keyframe.pose;
        pose.translation += Vector3::new(phase.sin(), phase.cos(), 0.0) * 0.003;
    }
    let review = review(town, "honest", &honest);
    assert!(review.refusals.is_empty(), "{:?}", review.refusals);
    assert!(review.structure.difference.keyframes.moved > 0);
    assert!(
        review
            .drives
            .iter()
            .all(|drive| drive.candidate.accepted > 10 && drive.candidate.innovation.is_some())
    );
}

/// A drive without truth in a part that the live map lacks.
fn a_drive_that_nothing_can_be_compared_with_is_refused(town: &Town) {
    let [_, (drive, in_candidate)] = &town.drives;
    let mut half = town.map.clone();
    let gone: Vec<u64> = part(&town.map, 0.0, 0.85).iter().map(|at| town.map.keyframes[*at].id).collect();
    let chosen = keyframes_where(&half, |keyframe| gone.contains(&keyframe.id));
    remove_keyframes(&mut half, &chosen);
    let live = side("release 1", &half);
    let in_live = drive.run_in(&live.map, &town.scratch.path("little-known")).unwrap();
    let reviewed = ReviewedDrive::of(drive, &in_live, in_candidate);
    assert!(reviewed.candidate.cold.unjudged > 0, "{:?}", reviewed.candidate);
    let review = Review::judged(&live, &town.live, vec![reviewed], &Gates::default());
    let gates: Vec<&str> = review.refusals.iter().map(|refusal| refusal.gate).collect();
    assert!(gates.contains(&"--min-judged"), "{:?}", review.refusals);
}

fn the_command_reviews_a_candidate_and_writes_a_report(town: &Town) {
    let scratch = &town.scratch;
    scratch.run("publish-map --map town.db --to releases");
    let mut half = town.map.clone();
    let gone: Vec<u64> = part(&town.map, 0.4, 1.0).iter().map(|at| town.map.keyframes[*at].id).collect();
    let chosen = keyframes_where(&half, |keyframe| gone.contains(&keyframe.id));
    remove_keyframes(&mut half, &chosen);
    let next = scratch.path("next.db");
    copy_folder(&scratch.path("town.db"), &next);
    save_map(&next, &half, true).unwrap();
    scratch.run("publish-map --map next.db --to releases --stage candidate");
    let line = "review-release releases --drive town/live --duration 12 --out report --json";
    let output = scratch.command(line).stdout(std::process::Stdio::piped()).output().unwrap();
    assert_eq!(output.status.code(), Some(3), "{}", String::from_utf8_lossy(&output.stderr));
    let printed: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let written = std::fs::read(scratch.path("report/review.json")).unwrap();
    assert_eq!(printed, serde_json::from_slice::<serde_json::Value>(&written).unwrap());
    assert_eq!((&printed["live"], &printed["candidate"]), (&"release 1".into(), &"candidate 1".into()));
    let page = std::fs::read_to_string(scratch.path("report/review.html")).unwrap();
    for refusal in printed["refusals"].as_array().unwrap() {
        assert!(page.contains(refusal["gate"].as_str().unwrap()), "{refusal}");
    }
    assert!(page.contains("should not be promoted") && page.contains("class=\"removed\""));
}

/// One test, since most of its time goes to the town and the drives.
#[test]
fn candidates_are_judged() {
    let town = Town::new();
    a_corner_that_is_0_3_m_off_is_refused(&town);
    a_corner_that_is_off_in_a_map_that_is_uncertain_as_a_whole_is_found(&town);
    views_in_one_direction_that_are_missing_are_found(&town);
    half_of_a_place_that_is_missing_is_refused(&town);
    two_places_that_are_swapped_are_refused(&town);
    an_honest_candidate_passes(&town);
    a_drive_that_nothing_can_be_compared_with_is_refused(&town);
    the_command_reviews_a_candidate_and_writes_a_report(&town);
}
