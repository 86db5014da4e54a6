//! `driftless info`: what a bag holds, and what of it a robot would use.

use anyhow::Result;
use bags::Bag;
use geometry::camera::Distortion;
use onboard::PairSummary;
use onboard::arguments::CalibrationArguments;
use sensors::{BagSensors, CalibrationFiles, Recording};
use serde::Serialize;
use std::path::PathBuf;

/// An interval is a gap if it is so many times as long as the median interval.
const GAP_FACTOR: i64 = 5;

/// Arguments of `driftless info`.
#[derive(clap::Args, Debug)]
#[command(after_help = "Examples:\n  driftless info drive.mcap\n  \
    driftless info drive.bag --calibration camchain-imucam.yaml --imu-calibration imu.yaml\n\n\
    Rates and gaps of readings and images are those of the stamps in their headers, of other messages those of the times at which they \
    were recorded; a gap is five median intervals long or more.")]
pub struct Args {
    /// The recording: MCAP, rosbag1 (.bag) or rosbag2 (its folder, or a .db3)
    #[arg(value_name = "REC")]
    recording: PathBuf,
    /// Calibration
    #[command(flatten)]
    calibration: CalibrationArguments,
    /// Print as JSON
    #[arg(long)]
    json: bool,
}

/// What a bag holds.
#[derive(Debug, Serialize)]
struct Report {
    topics: Vec<TopicReport>,
    damage: Vec<String>,
    /// What was done to read the recording, and which topics are no cameras.
    notes: Vec<String>,
    /// Topic of the IMU, or of its gyroscope.
    imu: Option<String>,
    /// Topic of the accelerometer, where it has its own.
    accelerometer: Option<String>,
    /// Topics of the cameras.
    cameras: Vec<String>,
    /// Why no sensors were found.
    no_sensors: Option<String>,
    /// Stereo pairs and images without a partner; none for one camera, and where the calibration is not known.
    stereo_pairs: Option<PairSummary>,
    /// Whether the sensors can be used as they are, else why not.
    calibration: Calibration,
}

#[derive(Debug, Serialize)]
#[serde(untagged)]
enum Calibration {
    Found { imu: bool, cameras: Vec<CameraReport> },
    Missing { problem: String },
}

#[derive(Debug, Serialize)]
struct CameraReport {
    resolution: [u32; 2],
    focal_px: [f64; 2],
    distortion: String,
}

#[derive(Debug, Serialize)]
struct TopicReport {
    name: String,
    #[serde(rename = "type")]
    type_name: String,
    encoding: String,
    messages: usize,
    first_ns: Option<i64>,
    last_ns: Option<i64>,
    /// By the median interval.
    rate_hz: Option<f64>,
    gaps: usize,
    longest_gap_s: f64,
}

impl TopicReport {
    fn of(bag: &Bag, index: usize) -> Self {
        let topic = &bag.topics()[index];
        let times: Vec<i64> = BagSensors::stamps(bag, index)
            .unwrap_or_else(|| topic.messages.iter().map(|message| message.log_ns).collect());
        let stamps = || times.iter().copied();
        let mut intervals: Vec<i64> =
            stamps().zip(stamps().skip(1)).map(|(a, b)| b.saturating_sub(a)).collect();
        intervals.sort_unstable();
        let median = intervals.get(intervals.len() / 2).copied().filter(|&median| median > 0);
        let is_gap =
            |interval: &&i64| median.is_some_and(|median| **interval >= median.saturating_mul(GAP_FACTOR));
        // Sorted, so that the last one is the longest.
        let gaps: Vec<i64> = intervals.iter().filter(is_gap).copied().collect();
        Self {
            name: topic.name.clone(),
            type_name: topic.type_name.clone(),
            encoding: topic.encoding.to_string(),
            messages: topic.messages.len(),
            first_ns: stamps().next(),
            last_ns: stamps().next_back(),
            rate_hz: median.map(|median| 1e9 / median as f64),
            gaps: gaps.len(),
            longest_gap_s: gaps.last().map_or(0.0, |&gap| gap as f64 * 1e-9),
        }
    }
}

/// Runs the command.
///
/// # Errors
/// A file that is no bag, or cannot be read.
pub fn run(args: &Args) -> Result<()> {
    let report = report(args)?;
    if args.json {
        println!("{}", serde_json::to_string_pretty(&report)?);
    } else {
        print(&report);
    }
    Ok(())
}

fn report(args: &Args) -> Result<Report> {
    let bag = Bag::open(&args.recording)?;
    let files: CalibrationFiles = args.calibration.files();
    let name = |index: usize| bag.topics()[index].name.clone();
    let found = BagSensors::find(&bag, &files);
    let no_sensors = found.as_ref().err().map(ToString::to_string);
    let found = found.ok();
    let mut notes = bag.notes().to_vec();
    notes.extend(found.iter().flat_map(|found| found.notes.clone()));
    let cameras = found.iter().flat_map(|found| &found.cameras).map(|camera| name(camera.images)).collect();
    let mut stereo_pairs = None;
    let calibration = match Recording::open_with(&args.recording, &files) {
        Ok(recording) => {
            stereo_pairs = recording.stereo_pairs().map(PairSummary::from);
            let found = recording.calibration();
            let camera = |sensor: &sensors::CameraSensor| CameraReport {
                resolution: [sensor.camera.width, sensor.camera.height],
                focal_px: sensor.camera.focal,
                distortion: distortion(&sensor.camera.distortion),
            };
            Calibration::Found {
                imu: found.imu.is_some(),
                cameras: found.cameras.iter().map(camera).collect(),
            }
        }
        Err(error) => Calibration::Missing { problem: error.to_string() },
    };
    let topics = (0..bag.topics().len()).map(|index| TopicReport::of(&bag, index)).collect();
    let imu = found.as_ref().and_then(|found| found.imu).map(name);
    let accelerometer = found.as_ref().and_then(|found| found.accelerometer).map(name);
    let damage = bag.damage().to_vec();
    Ok(Report { topics, damage, notes, imu, accelerometer, cameras, no_sensors, stereo_pairs, calibration })
}

/// A distortion: the name of its model, and its coefficients in the order of the model.
fn distortion(distortion: &Distortion) -> String {
    let numbers: Vec<String> = distortion.coefficients().iter().map(ToString::to_string).collect();
    format!("{} {}", distortion.name(), numbers.join(", ")).trim_end().to_owned()
}

fn print(report: &Report) {
    println!(
        "{:<34} {:<30} {:>9} {:>9} {:>9} {:>14}",
        "topic", "type", "messages", "rate Hz", "seconds", "gaps (longest)"
    );
    for topic in &report.topics {
        let seconds =
            topic.first_ns.zip(topic.last_ns).map_or(0.0, |(a, b)| b.saturating_sub(a) as f64 * 1e-9);
        let rate = topic.rate_hz.map_or_else(|| "-".to_owned(), |rate| format!("{rate:.1}"));
        let gaps = match topic.gaps {
            0 => "-".to_owned(),
            gaps => format!("{gaps} ({:.2} s)", topic.longest_gap_s),
        };
        println!(
            "{:<34} {:<30} {:>9} {rate:>9} {seconds:>9.1} {gaps:>14}",
            topic.name, topic.type_name, topic.messages
        );
    }
    for line in &report.damage {
        println!("damage: {line}");
    }
    for line in &report.notes {
        println!("note: {line}");
    }
    if let Some(problem) = &report.no_sensors {
        println!("sensors: {problem}");
        return;
    }
    println!("IMU: {}", report.imu.as_deref().unwrap_or("none"));
    if let Some(accelerometer) = &report.accelerometer {
        println!("accelerometer: {accelerometer}");
    }
    println!("cameras: {}", report.cameras.join(", "));
    if let Some(pairs) = &report.stereo_pairs {
        println!(
            "stereo pairs: {}, at most {:.3} ms apart; without a partner: {} of the first camera, {} of the second",
            pairs.pairs, pairs.largest_difference_ms, pairs.lone_first, pairs.lone_second
        );
    }
    match &report.calibration {
        Calibration::Missing { problem } => println!("calibration: {problem}"),
        Calibration::Found { cameras, .. } => {
            for (index, camera) in cameras.iter().enumerate() {
                println!(
                    "calibration of cam{index}: {} x {} pixels, focal length {:.1}, {:.1} px, distortion {}",
                    camera.resolution[0],
                    camera.resolution[1],
                    camera.focal_px[0],
                    camera.focal_px[1],
                    camera.distortion
                );
            }
        }
    }
}
