//! `driftless info`: what a bag holds, and what of it a robot would use.

use anyhow::Result;
use bags::{Bag, Topic};
use geometry::camera::Distortion;
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
    Rates and gaps are those of the times at which messages were recorded; a gap is five median intervals long or more.")]
pub struct Args {
    /// The recording: MCAP, rosbag1 (.bag) or rosbag2 (.db3, or the folder with metadata.yaml)
    #[arg(value_name = "FILE")]
    bag: PathBuf,
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
    /// Topic of the IMU.
    imu: Option<String>,
    /// Topics of the cameras.
    cameras: Vec<String>,
    /// Why no sensors were found.
    no_sensors: Option<String>,
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
    fn of(topic: &Topic) -> Self {
        let stamps = || topic.messages.iter().map(|message| message.log_ns);
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
    let bag = Bag::open(&args.bag)?;
    let files: CalibrationFiles = args.calibration.files();
    let name = |index: usize| bag.topics()[index].name.clone();
    let (imu, cameras, no_sensors) = match BagSensors::find(&bag, &files) {
        Ok(found) => {
            (found.imu.map(name), found.cameras.iter().map(|camera| name(camera.images)).collect(), None)
        }
        Err(error) => (None, Vec::new(), Some(error.to_string())),
    };
    let calibration = match Recording::open_with(&args.bag, &files) {
        Ok(recording) => {
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
    let topics = bag.topics().iter().map(TopicReport::of).collect();
    Ok(Report { topics, damage: bag.damage().to_vec(), imu, cameras, no_sensors, calibration })
}

/// A distortion as in a `sensor.yaml`.
fn distortion(distortion: &Distortion) -> String {
    let (model, coefficients): (&str, &[f64]) = match distortion {
        Distortion::None => return "none".to_owned(),
        Distortion::RadialTangential(coefficients) => ("radial-tangential", coefficients),
        Distortion::Equidistant(coefficients) => ("equidistant", coefficients),
        Distortion::Fov(omega) => ("fov", std::slice::from_ref(omega)),
    };
    let numbers: Vec<String> = coefficients.iter().map(ToString::to_string).collect();
    format!("{model} {}", numbers.join(", "))
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
    if let Some(problem) = &report.no_sensors {
        println!("sensors: {problem}");
        return;
    }
    println!("IMU: {}", report.imu.as_deref().unwrap_or("none"));
    println!("cameras: {}", report.cameras.join(", "));
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
