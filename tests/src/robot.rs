//! Robots, configured with the switches of the programs.

use clap::Parser;
use onboard::{MapLink, Outcome, RobotArguments, run_robot};
use recognition::LoadedMap;
use sensors::Sequence;
use std::path::Path;
use std::sync::Arc;
use tools::in_process::LocalServer;

pub use crate::requests::{images, request};

#[derive(Parser)]
struct CommandLine {
    #[command(flatten)]
    robot: RobotArguments,
}

/// The switches of a command line, for example `"--mode single"`, with `--out`.
pub fn arguments(out: &Path, switches: &str) -> RobotArguments {
    let line = ["robot", "--out", out.to_str().unwrap()].into_iter().chain(switches.split_whitespace());
    CommandLine::try_parse_from(line).unwrap().robot
}

/// Runs a robot to the end of its recording.
pub fn run(sequence: &Sequence, out: &Path, switches: &str, link: Option<MapLink>) -> Outcome {
    let outcome = run_robot(sequence, &arguments(out, switches), link, |_| {}).unwrap();
    assert_eq!(outcome.summary.ended_early, None);
    outcome
}

/// [`run`] with a server of its own for a map.
pub fn run_in_map(sequence: &Sequence, out: &Path, switches: &str, map: &Arc<LoadedMap>) -> Outcome {
    let server = LocalServer::start(vec![("map".to_owned(), Arc::clone(map))]).unwrap();
    let link = server.link("map").unwrap();
    let outcome = run(sequence, out, switches, Some(link.clone()));
    server.unlink(&link);
    server.stop().unwrap();
    outcome
}

/// Asserts a state of every frame from the first one on, which comes within the rest at the beginning.
pub fn assert_every_frame_has_a_state(outcome: &Outcome, sequence: &Sequence) {
    let states: Vec<i64> = outcome.states().unwrap().iter().map(|state| state.stamp_ns).collect();
    let frames: Vec<i64> = sequence.frames.iter().map(|frame| frame.stamp_ns).collect();
    let skipped = frames.len() - states.len();
    assert!(frames[skipped] - frames[0] < 1_000_000_000, "{skipped} frames were skipped");
    assert_eq!(states, frames[skipped..]);
}
