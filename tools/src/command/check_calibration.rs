//! `driftless check-calibration`: whether a calibration agrees with a recording.

use crate::calibration_check::{Agreement, CalibrationCheck, CoarseTimeOffset, Fit, check_calibration};
use anyhow::{Context as _, Result, bail};
use indicatif::ProgressBar;
use mapping::odometry_config;
use onboard::arguments::CalibrationArguments;
use sensors::Sequence;
use std::path::PathBuf;

/// IMU readings before the first frame that are kept, nanoseconds: more than the time offset is searched for.
const EARLIER_READINGS_NS: i64 = 1_500_000_000;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    driftless check-calibration MH_01\n  \
    driftless check-calibration drive.mcap --calibration camchain-imucam.yaml --from 20\n\n\
    The time offset is searched for within 1.2 s of the stated one by the rotation rates of images and gyroscope. Then\n\
    odometry runs over the recording twice: with the calibration as it is, and estimating time offset, extrinsics and\n\
    intrinsics. A parameter differs where the recording contradicts the stated value, and is not shown where the motion\n\
    tells nothing of it: turn the robot about all axes and accelerate it. The exit code is 1 where something differs, or\n\
    where nothing can be said.\n\
    What is found in half a minute shows what is wrong; it does not replace a calibration with a target.")]
pub struct Args {
    /// The recording: a folder in the EuRoC layout, or a bag (MCAP, rosbag2, rosbag1)
    #[arg(value_name = "REC")]
    pub recording: PathBuf,
    /// Calibration
    #[command(flatten)]
    pub calibration: CalibrationArguments,
    /// Begin so many seconds after the first frame
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0)]
    pub from: f64,
    /// Play so many seconds
    #[arg(long, value_name = "SECONDS", default_value_t = 30.0)]
    pub duration: f64,
    /// Use camera 0 only, where the recording has two
    #[arg(long)]
    pub mono: bool,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
///
/// # Errors
/// A recording that cannot be read, odometry that is never initialized, a calibration that disagrees.
pub fn run(args: &Args) -> Result<()> {
    let mut sequence = Sequence::open_with(&args.recording, &args.calibration.files())?;
    cut(&mut sequence, args.from, args.duration)?;
    let cameras = if args.mono { 1 } else { sequence.cameras.len() };
    let config = odometry_config(&sequence)?;
    let bar = if args.json { ProgressBar::hidden() } else { ProgressBar::new(0) };
    let check = check_calibration(&mut sequence, cameras, &config, |done, all| {
        bar.set_length(all as u64);
        bar.set_position(done as u64);
    })
    .context("the calibration cannot be checked")?;
    bar.finish_and_clear();
    if args.json {
        println!("{:#}", serde_json::to_value(&check)?);
    } else {
        print(&check);
    }
    if !check.checked {
        bail!(
            "the calibration could not be checked with {}: {}; choose a part that moves and has texture with --from and --duration",
            args.recording.display(),
            check.stated.complaint().unwrap_or_default()
        );
    }
    if !check.agrees {
        bail!("the calibration does not agree with {}", args.recording.display());
    }
    Ok(())
}

/// Keeps the frames and readings of a time.
fn cut(sequence: &mut Sequence, from_s: f64, duration_s: f64) -> Result<()> {
    let wanted = from_s.is_finite() && from_s >= 0.0 && duration_s.is_finite() && duration_s > 0.0;
    let Some(first) = sequence.frames.first().filter(|_| wanted) else {
        bail!("--from {from_s} and --duration {duration_s} leave no frame of {}", sequence.root.display());
    };
    let begin_ns = first.stamp_ns + (from_s * 1e9) as i64;
    let end_ns = begin_ns + (duration_s * 1e9) as i64;
    sequence.frames.retain(|frame| (begin_ns..=end_ns).contains(&frame.stamp_ns));
    if sequence.frames.is_empty() {
        bail!("--from {from_s} is behind the last frame of {}", sequence.root.display());
    }
    sequence.imu_samples.retain(|reading| reading.stamp_ns >= begin_ns - EARLIER_READINGS_NS);
    Ok(())
}

fn print(check: &CalibrationCheck) {
    println!("{:.0} s of the recording", check.seconds);
    print_coarse(&check.coarse_time_offset);
    print_fit("as stated", &check.stated);
    print_fit("estimated", &check.estimated);
    if let Some(mistake) = check.mistake {
        println!("MISTAKE: {mistake}");
        return;
    }
    for parameter in &check.parameters {
        let numbers =
            |values: &[f64]| values.iter().map(|value| format!("{value:.2}")).collect::<Vec<_>>().join(", ");
        let verdict = match parameter.agreement {
            Agreement::Agrees => "agrees".to_owned(),
            Agreement::NotShown => "not shown by this motion".to_owned(),
            Agreement::Differs => format!("DIFFERS: {}", parameter.advice),
        };
        println!(
            "{:34} {verdict} (found minus stated {} {}, sigma {})",
            parameter.name,
            numbers(&parameter.difference),
            parameter.unit,
            numbers(&parameter.sigma)
        );
    }
}

fn print_coarse(coarse: &CoarseTimeOffset) {
    if let Some(best) = coarse.best {
        let milliseconds = |seconds: f64| format!("{:+.1} ms", 1e3 * seconds);
        let sigma = coarse.sigma_s.map_or("unknown".to_owned(), |sigma_s| format!("{:.1} ms", 1e3 * sigma_s));
        let second = coarse.second.map_or("no other peak".to_owned(), |second| {
            format!("next peak {:.2} at {}", second.correlation, milliseconds(second.lag_s))
        });
        println!(
            "rotation rates, images and gyro    best lag {}, sigma {sigma}, correlation {:.2}; {second}; sigma of unrelated signals \
             {:.2}; the rates vary by {:.1} deg/s",
            milliseconds(best.lag_s),
            best.correlation,
            coarse.noise_correlation,
            coarse.rate_rms_rad_s.to_degrees()
        );
    }
    if let Some(undetermined) = coarse.undetermined {
        println!(
            "  the time offset cannot be told from the rotation rates within {:.1} s: {}. It is estimated from the stated one on, with a \
             prior sigma of 30 ms: an error of 100 ms or more is not found. Turn the camera back and forth about several axes, \
             irregularly",
            coarse.range_s,
            undetermined.describe()
        );
    }
}

fn print_fit(name: &str, fit: &Fit) {
    let noise = fit.noise.map_or("never initialized".to_owned(), |noise| {
        format!(
            "IMU noise {:.1} times the stated, pixels {:.2} px",
            noise.imu_noise_scale, noise.sigma_track_px
        )
    });
    println!("odometry, {name:24} {noise}, {} images with a pose", fit.states);
    if let Some(complaint) = fit.complaint() {
        println!("  {complaint}");
    }
}
