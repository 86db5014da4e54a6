//! `driftless track`: feature tracks of the images of a recording, written as `tracks.csv`.

use anyhow::{Context, Result, bail};
use clap::ValueEnum;
use estimator::ReadingCheck;
use odometry::FrontEnd;
use onboard::arguments::{CalibrationArguments, mask_path, read_masks};
use onboard::progress;
use onboard::start::first_rest;
use sensors::{
    CalibrationFiles, FolderCalibration, Frame, ImuSample, Recording, Rows, Sequence, camera_groups,
    check_stereo, writer,
};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;
use vision::tracking::TrackerOptions;
use vision::{Equalization, LocalEqualization};

/// A rest is searched in so much of the beginning, nanoseconds; [`first_rest`] looks no further than 10 s.
const REST_SEARCH_NS: i64 = 11_000_000_000;

/// Files of a recording, beside those of cameras and IMU, that its tracks do not replace.
const OTHER_FILES: [&str; 8] = [
    "mav0/cam0/features.csv",
    "mav0/wheels0/data.csv",
    "mav0/wheels0/sensor.yaml",
    "mav0/gnss0/data.csv",
    "mav0/gnss0/sensor.yaml",
    "mav0/state_groundtruth_estimate0/data.csv",
    "mav0/mocap0/data.csv",
    "reference_poses.csv",
];

/// Arguments of `driftless track`.
#[derive(clap::Args, Debug)]
#[command(after_help = "Examples:\n  driftless track MH_01 --out MH_01_tracks\n  \
    driftless track MH_01 --cameras 1 --points 150 --equalize local\n  \
    driftless track flight.mcap --calibration MH_01 --out MH_01_tracks\n\n\
    Writes mav0/camN/tracks.csv. With --out the new folder also gets calibration, IMU, wheels, GNSS and ground\n\
    truth, but no images:\n\
    `driftless run DIR --mode odometry --out run` runs on it.")]
pub struct Args {
    /// The recording, with images: a folder in the EuRoC layout, or a bag (MCAP, rosbag2, rosbag1), which needs --out
    #[arg(value_name = "REC")]
    recording: PathBuf,
    /// Calibration
    #[command(flatten)]
    calibration: CalibrationArguments,
    /// Write a new recording to this folder, which is not REC [default: the tracks are written into REC]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Number of cameras to use, the first ones [default: all that the recording has]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..))]
    cameras: Option<u8>,
    /// Points to track in each image, of a stereo pair in that of its first camera
    #[arg(long, value_name = "N", default_value_t = TrackerOptions::default().points)]
    points: usize,
    /// Equalize the histogram first, for poor light
    #[arg(long, value_enum, default_value = "off")]
    equalize: Equalize,
    /// Image that is black (zero) where camera 0 sees the robot itself; of several cameras one each, separated by commas, in their
    /// order, with nothing between the commas for a camera without a mask
    #[arg(long, value_name = "FILE[,FILE]", value_delimiter = ',', value_parser = mask_path())]
    mask: Vec<PathBuf>,
    /// Do not use the gyroscope
    #[arg(long)]
    no_gyroscope: bool,
    /// Replace tracks that are there already, or the recording in the folder of --out
    #[arg(long)]
    force: bool,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
}

/// Histogram equalization.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Equalize {
    /// None.
    Off,
    /// By the histogram of the whole image.
    Global,
    /// Adaptive (CLAHE).
    Local,
}

impl From<Equalize> for Equalization {
    fn from(choice: Equalize) -> Self {
        match choice {
            Equalize::Off => Self::Off,
            Equalize::Global => Self::Global,
            Equalize::Local => Self::Local(LocalEqualization::default()),
        }
    }
}

/// What was tracked.
#[derive(Debug, Default, Serialize)]
struct Summary {
    written: Vec<PathBuf>,
    frames: usize,
    left_out: usize,
    tracks: u64,
    observations: usize,
    /// Mean over the frames.
    points_in_sight: f64,
    /// Mean over the frames, of those in sight: how many are in both images of a stereo pair.
    stereo_share: f64,
    outliers: usize,
    /// Median length of a track, frames.
    track_length: usize,
    /// Of reading the images and tracking, milliseconds a frame.
    milliseconds: f64,
    gyroscope_bias: [f64; 3],
}

/// Runs the command.
///
/// # Errors
/// A recording without images, tracks that are there already, an `--out` that is a recording, a mask that does not fit,
/// a folder that cannot be written.
pub fn run(args: &Args) -> Result<()> {
    refuse_recording_as_out(args)?;
    let files = args.calibration.files();
    let mut sequence = Sequence::open_without_readings(&args.recording, &files)?;
    let recording = Recording::open_with(&args.recording, &files)?;
    let cameras = camera_count(args, &sequence)?;
    if args.out.is_none() && !is_folder(&args.recording) {
        bail!(
            "{} is a bag, which tracks cannot be added to: name a folder for them with --out DIR",
            args.recording.display()
        );
    }
    let root = args.out.as_deref().unwrap_or(&args.recording);
    let written: Vec<PathBuf> =
        (0..cameras).map(|camera| root.join(format!("mav0/cam{camera}/tracks.csv"))).collect();
    refuse_to_overwrite(args, root, sequence.cameras.len())?;
    check_stereo(&sequence.cameras[..cameras], || Ok(sequence.frames.iter().cloned().map(Ok)))?;
    let options = tracker_options(args)?;
    let mut front_end =
        FrontEnd::new(&sequence.cameras[..cameras], &options).context("the tracker cannot start")?;
    let mut summary = track(args, &mut sequence, &recording, &mut front_end)?;
    summary.written = written;
    if summary.observations == 0 {
        bail!("nothing was tracked in {}", args.recording.display());
    }
    if is_folder(&args.recording) {
        write(args, &mut sequence, cameras)?;
    } else {
        sequence.imu_samples = recording.imu_samples()?.collect::<Result<_, _>>()?;
        writer::write(&sequence, root).context("the tracks were not written")?;
    }
    if args.json {
        println!("{}", serde_json::to_string_pretty(&summary)?);
    } else {
        print_summary(&summary);
    }
    Ok(())
}

/// Whether a recording is a folder in the EuRoC layout, which tracks can be written into.
fn is_folder(recording: &Path) -> bool {
    recording.join("mav0").is_dir()
}

/// Plays all images through the front end, and puts the tracks into the frames.
fn track(
    args: &Args,
    sequence: &mut Sequence,
    recording: &Recording<'_>,
    front_end: &mut FrontEnd,
) -> Result<Summary> {
    if let Some(start) = resting_start(recording)? {
        front_end.set_gyroscope_bias(start);
    }
    let mut imu = ReadingWindow::new(recording)?;
    let bar = progress::frame_bar(sequence.frames.len());
    let begin = Instant::now();
    let mut summary = Summary::default();
    let firsts: Vec<usize> = camera_groups(&sequence.cameras).iter().map(|group| group.first).collect();
    let mut lengths = std::collections::BTreeMap::<u64, usize>::new();
    for frame in &mut sequence.frames {
        bar.inc(1);
        frame.tracks.clear();
        if frame.images.is_empty() {
            continue;
        }
        summary.frames += 1;
        let readings =
            if args.no_gyroscope { &[] } else { imu.up_to(front_end.last_stamp_ns(), frame.stamp_ns)? };
        match front_end.track_frame(frame, readings) {
            Ok(tracks) => frame.tracks = tracks,
            Err(error) => {
                summary.left_out += 1;
                bar.suspend(|| eprintln!("warning: {error}"));
                continue;
            }
        }
        summary.outliers += front_end.report().outliers;
        summary.observations += frame.tracks.len();
        for track in frame.tracks.iter().filter(|track| firsts.contains(&usize::from(track.camera))) {
            *lengths.entry(track.feature_id).or_default() += 1;
        }
    }
    bar.finish_and_clear();
    let in_first: usize = lengths.values().sum();
    let looked = (summary.frames - summary.left_out).max(1) as f64;
    summary.milliseconds = begin.elapsed().as_secs_f64() * 1e3 / summary.frames.max(1) as f64;
    summary.tracks = lengths.len() as u64;
    summary.points_in_sight = in_first as f64 / looked;
    summary.stereo_share = (summary.observations - in_first) as f64 / in_first.max(1) as f64;
    let mut lengths: Vec<usize> = lengths.into_values().collect();
    lengths.sort_unstable();
    summary.track_length = lengths.get(lengths.len() / 2).copied().unwrap_or(0);
    summary.gyroscope_bias = front_end.gyroscope_bias().into();
    Ok(summary)
}

/// The readings around one image interval, read as they are needed.
struct ReadingWindow<'a> {
    rows: Rows<'a, ImuSample>,
    check: ReadingCheck,
    readings: Vec<ImuSample>,
}

impl<'a> ReadingWindow<'a> {
    fn new(recording: &'a Recording<'_>) -> Result<Self> {
        Ok(Self { rows: recording.imu_samples()?, check: ReadingCheck::default(), readings: Vec::new() })
    }

    /// The readings from the last one before `from_ns` to the first one not before `to_ns`.
    fn up_to(&mut self, from_ns: Option<i64>, to_ns: i64) -> Result<&[ImuSample]> {
        let from_ns = from_ns.unwrap_or(to_ns);
        while self.readings.last().is_none_or(|last| last.stamp_ns < to_ns) {
            let Some(reading) = self.rows.next().transpose()? else { break };
            if let Err(bad) = self.check.check(&reading) {
                tracing::warn!(%bad, "bad IMU reading");
                continue;
            }
            // Before the first image, and where images are missing, old readings are of no use.
            if reading.stamp_ns <= from_ns {
                self.readings.clear();
            }
            self.readings.push(reading);
        }
        let needed = self.readings.partition_point(|reading| reading.stamp_ns <= from_ns).saturating_sub(1);
        self.readings.drain(..needed);
        Ok(&self.readings)
    }
}

/// The gyroscope's bias from a start at rest, if the recording has one.
fn resting_start(recording: &Recording<'_>) -> Result<Option<nalgebra::Vector3<f64>>> {
    let mut config = estimator::EstimatorConfig::default();
    let imu = recording.calibration().imu.as_ref();
    config.gravity = imu.and_then(|imu| imu.gravity_magnitude).unwrap_or(config.gravity);
    let mut readings: Vec<ImuSample> = Vec::new();
    for reading in recording.imu_samples()? {
        let reading = reading?;
        if readings.first().is_some_and(|first| reading.stamp_ns - first.stamp_ns > REST_SEARCH_NS) {
            break;
        }
        readings.push(reading);
    }
    Ok(first_rest(&readings, &config).map(|start| start.imu.gyroscope_bias))
}

fn camera_count(args: &Args, sequence: &Sequence) -> Result<usize> {
    let there = sequence.cameras.len();
    let wanted = args.cameras.map_or(there, usize::from);
    if wanted > there {
        bail!("{} has {there} cameras; use --cameras {there}", args.recording.display());
    }
    let has_image = |frame: &Frame, camera: usize| frame.images.contains_key(&camera);
    for camera in 0..wanted {
        if !sequence.frames.iter().any(|frame| has_image(frame, camera)) {
            bail!(
                "{} has no images of camera {camera}: they belong into mav0/cam{camera}/data",
                args.recording.display()
            );
        }
    }
    Ok(wanted)
}

/// Refuses an `--out` that is REC, whose files would be copied onto themselves, or without `--force` another recording.
fn refuse_recording_as_out(args: &Args) -> Result<()> {
    let Some(out) = &args.out else { return Ok(()) };
    // What is not there has no path of this form, and is no recording.
    let there = |path: &Path| path.canonicalize().ok();
    let is_same = |of_rec: &Path, of_out: &Path| there(of_out).is_some_and(|out| there(of_rec) == Some(out));
    if is_same(&args.recording, out) || is_same(&args.recording.join("mav0"), &out.join("mav0")) {
        bail!("--out {} is the recording itself: name another folder", out.display());
    }
    if out.join("mav0").exists() && !args.force {
        bail!(
            "--out {} has a recording, whose files would be replaced: name another folder, or use --force",
            out.display()
        );
    }
    Ok(())
}

fn refuse_to_overwrite(args: &Args, root: &Path, cameras: usize) -> Result<()> {
    if args.force {
        return Ok(());
    }
    for camera in 0..cameras {
        let path = root.join(format!("mav0/cam{camera}/tracks.csv"));
        if path.exists() {
            bail!("{} is there already: use --force to replace it, or --out DIR", path.display());
        }
    }
    Ok(())
}

fn tracker_options(args: &Args) -> Result<TrackerOptions> {
    let mut options = TrackerOptions::default().points(args.points).equalization(args.equalize.into());
    options.masks = read_masks(&args.mask)?;
    Ok(options)
}

/// Writes the tracks of a folder, and beside them what a recording needs when they go into a folder of their own.
fn write(args: &Args, sequence: &mut Sequence, cameras: usize) -> Result<()> {
    let root = args.out.as_deref().unwrap_or(&args.recording);
    let calibration = FolderCalibration::read(&args.recording, &args.calibration.files())?;
    if let Some(camera) =
        sequence.cameras.iter().take(cameras).position(|camera| camera.stamp_shift_ns() != 0)
    {
        bail!(
            "the time shift of cam{camera} is more than 5 ms against cam0's: tracks are written with the stamps of frames, which its images do \
             not have; convert the recording first, which writes images with these stamps"
        );
    }
    // tracks.csv has the stamps of data.csv.
    for frame in &mut sequence.frames {
        frame.stamp_ns -= calibration.time_offset_ns;
    }
    if args.out.is_some() {
        copy_without_images(args, root, cameras, &calibration.files)?;
    }
    for camera in cameras..sequence.cameras.len() {
        // Tracks of an earlier run, with other names for the points.
        let stale = root.join(format!("mav0/cam{camera}/tracks.csv"));
        if stale.exists() {
            std::fs::remove_file(&stale).with_context(|| format!("cannot remove {}", stale.display()))?;
        }
    }
    writer::write_tracks(&sequence.frames, cameras, root).context("the tracks were not written")
}

/// The folder whose `sensor.yaml` files are the calibration: that of `--calibration`, unless it has files of Kalibr, else the recording.
fn calibration_folder<'a>(args: &'a Args, kalibr: &CalibrationFiles) -> &'a Path {
    let given = args.calibration.calibration.as_deref();
    given.filter(|path| path.is_dir() && kalibr.cameras.is_none()).unwrap_or(&args.recording)
}

/// Copies calibration, lists of images, IMU, wheels, GNSS and truth.
fn copy_without_images(args: &Args, to: &Path, cameras: usize, kalibr: &CalibrationFiles) -> Result<()> {
    let from = |file: &str| {
        let is_calibration = file.ends_with("sensor.yaml");
        let folder = if is_calibration { calibration_folder(args, kalibr) } else { args.recording.as_path() };
        folder.join(file)
    };
    let sensors = (0..cameras).map(|camera| format!("mav0/cam{camera}")).chain(["mav0/imu0".to_owned()]);
    let mut files: Vec<String> = Vec::new();
    for sensor in sensors {
        files.push(format!("{sensor}/data.csv"));
        let of_kalibr = if sensor.ends_with("imu0") { &kalibr.imu } else { &kalibr.cameras };
        if of_kalibr.is_none() {
            files.push(format!("{sensor}/sensor.yaml"));
        }
    }
    files.extend(OTHER_FILES.map(str::to_owned));
    let mut copies: Vec<(PathBuf, PathBuf)> =
        files.iter().map(|file| (from(file), to.join(file))).filter(|(from, _)| from.exists()).collect();
    for (file, name) in [(&kalibr.cameras, "camchain-imucam.yaml"), (&kalibr.imu, "imu.yaml")] {
        copies.extend(file.iter().map(|file| (file.clone(), to.join(name))));
    }
    for (source, target) in copies {
        // A calibration may be given that lies there already: copied onto itself it would be empty.
        if target.canonicalize().is_ok_and(|there| source.canonicalize().is_ok_and(|source| source == there))
        {
            continue;
        }
        let copied = std::fs::create_dir_all(target.parent().unwrap_or(to))
            .and_then(|()| std::fs::copy(&source, &target));
        copied.with_context(|| format!("cannot copy {} to {}", source.display(), target.display()))?;
    }
    Ok(())
}

fn print_summary(summary: &Summary) {
    println!(
        "{} images, {} left out, {:.1} ms each with reading; {:.0} points in sight, {} tracks of {} frames (median), \
         {} outliers",
        summary.frames,
        summary.left_out,
        summary.milliseconds,
        summary.points_in_sight,
        summary.tracks,
        summary.track_length,
        summary.outliers
    );
    if summary.stereo_share > 0.0 {
        println!("{:.0} % of them in both cameras of a pair", 100.0 * summary.stereo_share);
    }
    for path in &summary.written {
        println!("written to {}", path.display());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser as _;

    #[derive(clap::Parser)]
    struct Line {
        #[command(flatten)]
        args: Args,
    }

    #[test]
    fn the_copied_calibration_is_the_one_that_is_used() {
        let folder = tempfile::tempdir().unwrap();
        let [rec, rig, out] = ["rec", "rig", "out"].map(|name| folder.path().join(name));
        for (root, file) in [(&rec, "data.csv"), (&rec, "sensor.yaml"), (&rig, "sensor.yaml")] {
            let sensor = root.join("mav0/imu0");
            std::fs::create_dir_all(&sensor).unwrap();
            std::fs::write(sensor.join(file), root.to_str().unwrap()).unwrap();
        }
        let copied = |switches: &[&Path]| {
            let line = [Path::new("track"), rec.as_path(), Path::new("--out"), out.as_path()];
            let Line { args } = Line::try_parse_from(line.iter().chain(switches)).unwrap();
            copy_without_images(&args, &out, 0, &CalibrationFiles::default()).unwrap();
            ["data.csv", "sensor.yaml"]
                .map(|file| std::fs::read_to_string(out.join("mav0/imu0").join(file)).unwrap())
        };
        let [in_rec, in_rig] = [&rec, &rig].map(|root| root.to_str().unwrap().to_owned());
        assert_eq!(copied(&[Path::new("--calibration"), rig.as_path()]), [in_rec.clone(), in_rig]);
        assert_eq!(copied(&[]), [in_rec.clone(), in_rec]);
    }
}
