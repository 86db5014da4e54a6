//! The command line of `onboard`, and the settings file that it names.

use crate::RobotArguments;
use crate::arguments::{
    CalibrationArguments, INPUT, LiveArguments, MAP, OUTPUT, RosArguments, Source, settings_text,
    with_settings,
};
use anyhow::{Context as _, Result, bail};
use clap::{CommandFactory as _, Parser};
use client::{SessionArguments, explain_renamed};
use monitoring::LogFormat;
use std::ffi::OsString;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

/// In place of a file's name.
const TERMINAL: &str = "-";

/// Plays live sensors or a recording, and localizes the robot in the map of a map server.
///
/// The estimator never waits for the network: without a server the robot continues with odometry, and its status says so.
#[derive(Parser, Debug)]
#[command(
    version,
    arg_required_else_help = true,
    after_help = "Examples:\n  \
        onboard --sequence MH_03 --map hall --connect tcp/192.168.1.2:7447 --out run\n  \
        onboard --sequence MH_03 --mode odometry --out run\n  \
        onboard --sequence MH_03 --map hall --realtime --robot cart7 --namespace site1 --out run\n  \
        onboard --source native --calibration camchain-imucam.yaml --map hall --robot cart7 --out run\n  \
        onboard --source ros2 --robot cart7 --write-config robot.yaml; onboard robot.yaml\n\n\
        Log: RUST_LOG=info; with --realtime, changes of the state and a line a minute are logged anyway. Ctrl-C ends the run in good order; the output folder is complete up to there.\n\
        Exit code: 0, or 3 for a run that ended lost, 1 for an error, 2 for wrong switches.\n\
        Then: driftless plot run"
)]
pub struct Arguments {
    /// File with settings: names and values of the switches, in YAML; switches override it
    #[arg(value_name = "FILE")]
    pub settings: Option<PathBuf>,
    /// Write a settings file with all switches, explained, and those that are given; without FILE to the terminal
    #[arg(long, value_name = "FILE", num_args = 0..=1, default_missing_value = TERMINAL, help_heading = OUTPUT)]
    pub write_config: Option<PathBuf>,
    /// Where measurements come from
    #[arg(long, value_enum, default_value = "recording", help_heading = INPUT)]
    pub source: Source,
    /// The recording: a folder in the EuRoC layout, or a bag (MCAP, rosbag2, rosbag1)
    #[arg(long, value_name = "REC", required_if_eq("source", "recording"), help_heading = INPUT)]
    pub sequence: Option<PathBuf>,
    /// Live sensors
    #[command(flatten)]
    pub live: LiveArguments,
    /// Calibration
    #[command(flatten)]
    pub calibration: CalibrationArguments,
    /// Name of the map on the server (not needed with --mode odometry)
    #[arg(long, value_name = "NAME", help_heading = MAP)]
    pub map: Option<String>,
    /// How the robot is connected [default: --connect tcp/127.0.0.1:7447]
    #[command(flatten)]
    pub session: SessionArguments,
    /// Address of an HTTP server of metrics (/metrics, for Prometheus) and health (/health), for example 127.0.0.1:9465
    ///
    /// It knows no users: use an address that only operators reach.
    #[arg(long, value_name = "ADDRESS:PORT", help_heading = OUTPUT)]
    pub monitoring: Option<SocketAddr>,
    /// Format of the log: text for people, json for programs, one object a line
    #[arg(long, value_name = "FORMAT", default_value_t, help_heading = OUTPUT)]
    pub log_format: LogFormat,
    /// Print the summary as JSON
    #[arg(long, help_heading = OUTPUT)]
    pub json: bool,
    /// Topics of ROS 2
    #[command(flatten)]
    pub ros: RosArguments,
    /// Switches of the robot
    #[command(flatten)]
    pub robot: RobotArguments,
}

impl Arguments {
    /// The switches of the command line and of its settings file; `None` where that was to be written only.
    ///
    /// Ends the program where switches are wrong or help is wanted.
    ///
    /// # Errors
    /// A settings file that cannot be read or written.
    pub fn read() -> Result<Option<Self>> {
        let line: Vec<OsString> = std::env::args_os().collect();
        if line.len() == 1 {
            return Ok(Some(Self::parse()));
        }
        let command = Self::command();
        let line = with_settings(&command, line)?;
        if let Some(path) = Self::file_to_write(&line) {
            write(&path, &settings_text(&command, &line))?;
            return Ok(None);
        }
        let read = Self::try_parse_from(&line);
        Ok(Some(read.unwrap_or_else(|error| explain_renamed(&command, &line, error).exit())))
    }

    /// Looked for without the other switches, of which some may be missing still.
    fn file_to_write(line: &[OsString]) -> Option<PathBuf> {
        let matches = Self::command()
            .ignore_errors(true)
            .disable_help_flag(true)
            .disable_version_flag(true)
            .get_matches_from(line);
        matches.get_one::<PathBuf>("write_config").cloned()
    }
}

fn write(path: &Path, text: &str) -> Result<()> {
    if path.as_os_str() == TERMINAL {
        print!("{text}");
        return Ok(());
    }
    if path.exists() {
        bail!("--write-config: {} exists already; name another file", path.display());
    }
    files::write_whole(path, text.as_bytes()).with_context(|| format!("cannot write {}", path.display()))?;
    println!("written to {}; start with: onboard {}", path.display(), path.display());
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    fn line(switches: &str) -> Vec<OsString> {
        std::iter::once("onboard").chain(switches.split_whitespace()).map(Into::into).collect()
    }

    /// As the program reads a settings file.
    fn read(text: &str, switches: &str) -> Result<Arguments> {
        let folder = tempfile::tempdir()?;
        let path = folder.path().join("robot.yaml");
        std::fs::write(&path, text)?;
        let mut line = line(switches);
        line.push(path.into());
        let mut read = Arguments::try_parse_from(with_settings(&Arguments::command(), line)?)?;
        read.settings = None;
        Ok(read)
    }

    const ALL_KINDS: &str = "--source ros2 --calibration /cal/chain.yaml --imu-topic /imu --camera-topic /a --camera-topic /b \
        --map hall --robot 007 --out /tmp/run --ros2 --imu-in-base-link=-0.1,0,0.2,0,0,1.5 --initial-pose-topic /initialpose --calibrate extrinsics,time-offset \
        --max-keyframes 7 --sigma-track 1.5 --connect tcp/10.0.0.1:7447 --mode single --monitoring 127.0.0.1:9465";

    #[test]
    fn what_is_written_is_read_back_equal() {
        let given = Arguments::try_parse_from(line(ALL_KINDS)).unwrap();
        let text = settings_text(&Arguments::command(), &line(ALL_KINDS));
        let read = read(&text, "").unwrap();
        assert_eq!(format!("{read:?}"), format!("{given:?}"), "{text}");
    }

    #[test]
    fn every_switch_is_in_the_file_and_its_default_is_what_it_is_without() {
        let text = settings_text(&Arguments::command(), &line("--out /tmp/run --sequence /data"));
        let keys: BTreeSet<&str> = text
            .lines()
            .filter(|line| !line.starts_with("# "))
            .filter_map(|line| Some(line.trim_start_matches('#').split_once(':')?.0))
            .collect();
        let command = Arguments::command();
        let longs: BTreeSet<&str> = command.get_arguments().filter_map(clap::Arg::get_long).collect();
        let missing: Vec<_> = longs.difference(&keys).collect();
        assert_eq!(missing, [&"write-config"]);
        let uncommented: String = text.lines().fold(String::new(), |text, line| {
            let is_setting = line.starts_with('#') && !line.starts_with("# ");
            text + if is_setting { &line[1..] } else { line } + "\n"
        });
        let given = Arguments::try_parse_from(line("--out /tmp/run --sequence /data")).unwrap();
        let read = read(&uncommented, "").unwrap();
        assert_eq!(format!("{read:?}"), format!("{given:?}"), "{uncommented}");
    }

    #[test]
    fn switches_override_and_paths_are_relative_to_the_file() {
        let text = "source: native\ncalibration: kalibr/chain.yaml\nrobot: cart7\nout: run\nframes: [m, o, b]\nros2: true\n\
                    camera-topic: [/a, /b]";
        let read = read(text, "--robot cart8 --camera-topic /c").unwrap();
        assert_eq!(read.robot.robot, "cart8");
        assert_eq!(read.calibration.camera_topic, ["/c"]);
        assert_eq!((read.ros.frames.map.as_str(), read.ros.frames.odom.as_str()), ("m", "o"));
        let calibration = read.calibration.calibration.unwrap();
        assert!(calibration.is_absolute() && calibration.ends_with("kalibr/chain.yaml"), "{calibration:?}");
        assert_eq!(calibration.parent().unwrap().parent(), read.robot.out.parent());
    }

    #[test]
    fn each_path_of_a_list_is_relative_to_the_file() {
        let masks = |text: &str| {
            read(&format!("source: native\ncalibration: c.yaml\nout: run\n{text}"), "").unwrap().robot
        };
        let beside = |robot: &RobotArguments, name: &str| robot.out.with_file_name(name);
        for text in ["mask: left.png,right.png", "mask: [left.png, right.png]"] {
            let robot = masks(text);
            assert_eq!(
                robot.features.mask,
                ["left.png", "right.png"].map(|name| beside(&robot, name)),
                "{text}"
            );
        }
        let robot = masks("mask: ['', right.png]");
        assert_eq!(robot.features.mask, [PathBuf::new(), beside(&robot, "right.png")]);
    }

    #[test]
    fn what_is_wrong_is_named_with_what_was_meant() {
        let message = |text: &str| read(text, "").unwrap_err().to_string();
        for (text, expected) in [
            ("calibraton: x", "did you mean \"calibration\""),
            ("imu_topic: /imu", "did you mean \"imu-topic\""),
            ("qqqq: 1", "--write-config lists all"),
            ("ros2: maybe", "true or false"),
            ("map: {name: hall}", "a text, a number, or a list"),
            ("source native", "not valid YAML"),
            ("source: nativ\nout: run", "native"),
        ] {
            let message = message(text);
            assert!(message.contains(expected), "{text}: {message}");
        }
    }

    #[test]
    fn a_recording_in_place_of_the_settings_is_told_its_switch() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir_all(folder.path().join("mav0/cam0")).unwrap();
        let line = vec!["onboard".into(), folder.path().into()];
        let said = with_settings(&Arguments::command(), line).unwrap_err().to_string();
        assert!(said.contains(&format!("--sequence {}", folder.path().display())), "{said}");
    }
}
