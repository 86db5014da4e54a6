//! `driftless bench`: maps one recording of a dataset and localizes the others in it.

use super::build_map;
use crate::benchmark::{
    BenchmarkReport, LocalizedRecording, MapFigures, in_frame_of_truth, localize, recordings,
};
use crate::own_map::is_replaceable;
use crate::stage_bar::StageBar;
use anyhow::{Context as _, Result, bail};
use map::store::MapTarget;
use onboard::arguments::CalibrationArguments;
use onboard::{RobotArguments, StopSignal, progress};
use recognition::LoadedMap;
use sensors::Recording;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

/// What made the map, as it states it: another one in its place is not replaced.
const CREATED_BY: &str = "driftless bench";

/// Arguments.
#[derive(clap::Args, Debug)]
#[command(after_help = "Examples:\n  driftless bench ~/euroc/machine_hall --out mh\n  \
    driftless bench ~/euroc/vicon_room1 --map-from V1_01_easy --only V1_02_medium,V1_03_difficult --out v1\n  \
    driftless bench ~/tum_vi/rooms --cameras mono --out rooms\n\n\
    Recordings are folders in the EuRoC layout (EuRoC, TUM-VI as exported for it), bags and folders of rosbag2, in DIR or one\n\
    folder deeper. The map is built without poses; where its recording has ground truth, it is moved into that frame once, so that\n\
    the poses of the other recordings are compared as they are.\n\n\
    Writes OUT/bench.json, OUT/bench.md, OUT/map.db and each run in OUT/NAME. Then: driftless plot OUT/NAME\n\n\
    Exit code: 0, or 1 where a recording could not be mapped or run (the others are), 2 for wrong switches")]
pub struct Args {
    /// Folder of the dataset
    #[arg(value_name = "DIR")]
    dataset: PathBuf,
    /// Recording that is mapped [default: the first by name]
    #[arg(long, value_name = "NAME")]
    map_from: Option<String>,
    /// Localize only these [default: all others]
    #[arg(long, value_name = "NAME[,NAME]", value_delimiter = ',')]
    only: Vec<String>,
    /// Print the table as JSON
    #[arg(long)]
    json: bool,
    /// Calibration
    #[command(flatten)]
    calibration: CalibrationArguments,
    #[command(flatten)]
    robot: RobotArguments,
}

/// Runs the command.
///
/// # Errors
/// A folder without two recordings, a name that is none of theirs, another map in the folder of the results, a
/// recording that cannot be mapped; after all others one that cannot
/// be run.
pub fn run(args: &Args) -> Result<()> {
    let stop = StopSignal::on_interrupt()?;
    let all = recordings(&args.dataset)?;
    let (mapped, localized) = choose(&all, args)?;
    let files = args.robot.recording_files(&args.calibration)?;
    let (out, database) = (&args.robot.out, args.robot.out.join("map.db"));
    is_replaceable(&database, CREATED_BY)?;
    std::fs::create_dir_all(out).with_context(|| format!("{} cannot be made", out.display()))?;
    let (map, figures) = build(args, mapped, &all[mapped], &database)?;
    let mut report = BenchmarkReport {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        dataset: args.dataset.clone(),
        map: figures,
        recordings: Vec::new(),
    };
    for name in localized {
        if stop.is_stopped() {
            bail!("stopped before {name}");
        }
        let mut robot = args.robot.clone();
        robot.out = out.join(name);
        let bar = progress::frame_bar(None);
        bar.set_prefix(name.to_owned());
        let result =
            localize(&all[name], &files, &robot, &map, &stop, |frame| bar.set_position(frame as u64));
        bar.finish_and_clear();
        let (measured, error) = match result {
            Ok(measured) => (Some(measured), None),
            Err(error) => (None, Some(format!("{error:#}"))),
        };
        report.recordings.push(LocalizedRecording { recording: name.to_owned(), measured, error });
        // After each: what was measured stays if the next one is interrupted.
        write(&report, out)?;
    }
    if args.json {
        println!("{}", serde_json::to_string_pretty(&report)?);
    } else {
        print!("{}", report.table());
        println!("\nwritten to {}", out.display());
    }
    let failed: Vec<&str> = report
        .recordings
        .iter()
        .filter(|run| run.error.is_some())
        .map(|run| run.recording.as_str())
        .collect();
    if !failed.is_empty() {
        bail!("could not be run: {}", failed.join(", "));
    }
    Ok(())
}

/// The names of the recording that is mapped, and of those that are localized.
fn choose<'a>(all: &'a BTreeMap<String, PathBuf>, args: &'a Args) -> Result<(&'a str, Vec<&'a str>)> {
    let known = |name: &str| {
        all.get_key_value(name).map(|(name, _)| name.as_str()).with_context(|| {
            let names: Vec<&str> = all.keys().map(String::as_str).collect();
            format!("{name} is no recording of {}, which has {}", args.dataset.display(), names.join(", "))
        })
    };
    let mapped = match &args.map_from {
        Some(name) => known(name)?,
        None => all.keys().next().map(String::as_str).context("there is no recording")?,
    };
    let localized = if args.only.is_empty() {
        all.keys().map(String::as_str).filter(|name| *name != mapped).collect()
    } else {
        args.only.iter().map(|name| known(name)).collect::<Result<Vec<_>>>()?
    };
    if localized.contains(&mapped) {
        bail!("{mapped} is mapped, and a recording in a map of itself shows nothing: leave it out of --only");
    }
    if localized.is_empty() {
        bail!(
            "{} has one recording, {mapped}: one is mapped, and others are localized in it",
            args.dataset.display()
        );
    }
    Ok((mapped, localized))
}

/// Builds the map and stores it.
fn build(args: &Args, name: &str, recording: &Path, database: &Path) -> Result<(Arc<LoadedMap>, MapFigures)> {
    let (begin, target) = (Instant::now(), MapTarget::new(database, true)?);
    let settings =
        build_map::Args::without_poses(recording, database, &args.calibration, &args.robot.features)?;
    let mut bar = StageBar::new(args.json);
    let built = build_map::build(&settings, None, &mut |stage, done, all| bar.show(stage, done, all));
    let (mut contents, _) = built.with_context(|| format!("{name} cannot be mapped"))?;
    CREATED_BY.clone_into(&mut contents.info.created_by);
    bar.finish();
    let seconds = begin.elapsed().as_secs_f64();
    let recording = Recording::open_with(recording, &args.calibration.files())?;
    let in_truth = in_frame_of_truth(&contents, &recording)?;
    let figures = MapFigures {
        recording: name.to_owned(),
        keyframes: contents.keyframes.len(),
        landmarks: contents.landmarks.len(),
        seconds,
        is_in_frame_of_truth: in_truth.is_some(),
    };
    target.save(in_truth.as_ref().unwrap_or(&contents))?;
    Ok((crate::in_process::load_map(database)?, figures))
}

fn write(report: &BenchmarkReport, out: &Path) -> Result<()> {
    for (name, text) in [("bench.json", serde_json::to_string_pretty(report)?), ("bench.md", report.table())]
    {
        let path = out.join(name);
        files::write_whole(&path, text.as_bytes())
            .with_context(|| format!("{} cannot be written", path.display()))?;
    }
    Ok(())
}
