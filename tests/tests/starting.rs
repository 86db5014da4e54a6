//! Initializing in motion, and starting again after the filter diverged.

use estimator::Localization;
use evaluation::trajectory::StateRow;
use onboard::{Outcome, run_robot};
use sensors::Sequence;
use std::ops::Range;
use tests::robot::{arguments, run};
use tests::scenario::MappedScenario;
use tests::server::{Client, Server};

/// A recording whose tracks are permuted for some seconds: every pixel belongs to another track.
fn scrambled(sequence: &Sequence, seconds: Range<f64>) -> Sequence {
    let mut scrambled = sequence.clone();
    let first_ns = scrambled.frames[0].stamp_ns;
    for frame in &mut scrambled.frames {
        if seconds.contains(&((frame.stamp_ns - first_ns) as f64 * 1e-9)) {
            let pixels: Vec<_> = frame.tracks.iter().map(|track| track.pixel).collect();
            let count = pixels.len();
            let shift = 1 + frame.stamp_ns as usize % 17;
            for (k, track) in frame.tracks.iter_mut().enumerate() {
                track.pixel = pixels[(k * 7 + shift) % count];
            }
        }
    }
    scrambled
}

/// Length of the estimated path over that of the true one.
fn length_ratio(states: &[StateRow], sequence: &Sequence) -> f64 {
    let truth = sequence.groundtruth.as_deref().unwrap();
    let (mut estimated, mut true_length) = (0.0, 0.0);
    // Over half a second, so that noise does not add to the length.
    for pair in states.iter().step_by(10).collect::<Vec<_>>().windows(2) {
        let true_position = |stamp_ns: i64| {
            let after = truth.partition_point(|row| row.stamp_ns < stamp_ns).min(truth.len() - 1);
            let (a, b) = (&truth[after.saturating_sub(1)], &truth[after]);
            let part = (stamp_ns - a.stamp_ns) as f64 / ((b.stamp_ns - a.stamp_ns) as f64).max(1.0);
            a.pose.translation.lerp(&b.pose.translation, part)
        };
        let position = |state: &StateRow| state.local_from_imu.pose.translation;
        estimated += (position(pair[1]) - position(pair[0])).norm();
        true_length += (true_position(pair[1].stamp_ns) - true_position(pair[0].stamp_ns)).norm();
    }
    estimated / true_length
}

fn assert_scale(outcome: &Outcome, sequence: &Sequence, from_ns: i64) {
    let states = &outcome.states().unwrap();
    let first = states.partition_point(|state| state.stamp_ns < from_ns);
    let ratio = length_ratio(&states[first..], sequence);
    assert!((ratio - 1.0).abs() < 0.05, "{ratio} times the true way");
}

#[test]
fn one_camera_or_two_start_in_motion() {
    let live = &MappedScenario::shared().recordings.live;
    for cameras in ["mono", "stereo"] {
        let folder = tempfile::tempdir().unwrap();
        let switches = format!("--mode odometry --cameras {cameras} --start-at 9 --duration 12");
        let outcome = run(live, folder.path(), &switches, None);
        let start = &outcome.summary.starts[0];
        assert_eq!((start.method, outcome.summary.starts.len()), ("motion", 1));
        assert!(start.seconds < 2.0, "{cameras}: started after {} s", start.seconds);
        assert_scale(&outcome, live, 0);
    }
}

#[test]
fn after_a_divergence_the_filter_starts_again_in_the_same_local_frame_and_localizes_again() {
    let scenario = MappedScenario::shared();
    let live = scrambled(&scenario.recordings.live, 9.0..14.0);
    let server = Server::start("ring", scenario.loaded());
    let client = Client::connect(server.endpoint());
    let folder = tempfile::tempdir().unwrap();
    let outcome = run(&live, folder.path(), "", Some(client.link("ring")));
    client.close();
    server.stop();
    let summary = &outcome.summary;
    assert_eq!(summary.reinitializations, 1, "{:?} {:?}", summary.starts, summary.divergences);
    assert_eq!(summary.starts[1].method, "motion");
    let (gone, back) = (summary.divergences[0].seconds, summary.starts[1].seconds);
    assert!(gone < 13.5 && back > 14.0 && back < 18.0, "no filter from {gone} s to {back} s");

    // No state in between, and the odometry frame goes on: at the last trusted pose, not back at the origin.
    let states = &outcome.states().unwrap();
    let first_ns = live.frames[0].stamp_ns;
    let at = |seconds: f64| first_ns + (seconds * 1e9) as i64;
    assert!(!states.iter().any(|state| (at(gone)..at(back) - 1_000_000).contains(&state.stamp_ns)));
    let nearest = |seconds: f64| {
        let index = states.partition_point(|state| state.stamp_ns < at(seconds) - 1_000_000);
        states[index].local_from_imu.pose
    };
    let (last_trusted, again) = (nearest(9.0), nearest(back));
    assert!(last_trusted.translation.norm() > 5.0);
    let jump = (again.translation - last_trusted.translation).norm();
    assert!(jump < 6.0, "L jumped by {jump} m");
    assert_scale(&outcome, &live, at(back));

    // The old transform was dropped with the old filter; the map gives a new one.
    let status = summary.final_status.as_ref().unwrap();
    assert_eq!(status.localization, Localization::Localized, "{}", status.reason);
    let last = states.last().unwrap();
    let truth = live.groundtruth.as_deref().unwrap().last().unwrap();
    let off = (last.global_from_imu.as_ref().unwrap().pose.translation - truth.pose.translation).norm();
    assert!(off < 0.3, "{off} m");
}

#[test]
fn a_robot_with_permuted_tracks_ends_and_reports_why_it_never_started() {
    let live = scrambled(&MappedScenario::shared().recordings.live, 0.0..1e9);
    let folder = tempfile::tempdir().unwrap();
    let switches = arguments(folder.path(), "--mode odometry --start-at 9 --duration 6");
    let outcome = run_robot(&live, &switches, None, |_| {}).unwrap();
    let why = outcome.summary.ended_early.as_ref().unwrap();
    assert!(why.contains("was not initialized in 6"), "{why}");
    assert!(outcome.states().unwrap().is_empty());

    // From truth it starts, diverges, and does not loop.
    let switches = arguments(folder.path(), "--mode odometry --init truth --start-at 9 --duration 8");
    let outcome = run_robot(&live, &switches, None, |_| {}).unwrap();
    assert_eq!((outcome.summary.divergences.len(), outcome.summary.starts.len()), (1, 1));
    let status = outcome.summary.final_status.unwrap();
    assert_eq!(status.localization, Localization::Lost);
    assert!(status.reason.contains("dynamic initialization"), "{}", status.reason);
}

#[test]
fn an_excerpt_beyond_the_recording_is_refused() {
    let live = &MappedScenario::shared().recordings.live;
    let folder = tempfile::tempdir().unwrap();
    for (switches, why) in [
        ("--start-at 1e6", "no image after that"),
        ("--start-at=-1", "zero or a positive number"),
        ("--duration 0", "positive number of seconds"),
    ] {
        let refused = run_robot(live, &arguments(folder.path(), switches), None, |_| {});
        assert!(refused.unwrap_err().to_string().contains(why));
    }
}
