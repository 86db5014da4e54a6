//! Robots, told by the same switches as the programs.

use clap::Parser;
use onboard::robot::{MapLink, Outcome, RobotArguments, run_robot};
use onboard::sequence::Sequence;
use std::path::Path;

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

/// How many frames a run over all of `sequence` has states of: those that the IMU covers.
pub fn frames_with_imu(sequence: &Sequence) -> usize {
    let begin_ns = sequence.imu_samples[0].stamp_ns;
    sequence.frames.iter().filter(|frame| frame.stamp_ns >= begin_ns).count()
}
