//! `driftless convert`: a recording in another format.

use anyhow::{Result, bail};
use onboard::arguments::CalibrationArguments;
use onboard::progress;
use sensors::convert::{Converted, Target, convert};
use std::path::{Path, PathBuf};

/// Formats that are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum To {
    /// A folder in the EuRoC layout.
    Euroc,
    /// An MCAP file with messages of ROS 2.
    Mcap,
    /// A rosbag2: a folder with SQLite in it.
    Rosbag2,
}

impl From<To> for Target {
    fn from(to: To) -> Self {
        match to {
            To::Euroc => Self::Euroc,
            To::Mcap => Self::Mcap,
            To::Rosbag2 => Self::Rosbag2,
        }
    }
}

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    driftless convert MH_03 MH_03.mcap\n  \
    driftless convert drive.bag drive --to rosbag2 --calibration camchain-imucam.yaml\n  \
    driftless convert drive.mcap drive_folder --calibration camchain-imucam.yaml")]
pub struct Args {
    /// The recording: a folder in the EuRoC layout, or a bag (MCAP, rosbag2, rosbag1)
    #[arg(value_name = "REC")]
    pub recording: PathBuf,
    /// The file or folder to write; nothing that exists is overwritten
    #[arg(value_name = "OUT")]
    pub out: PathBuf,
    /// Format of OUT [default: mcap where OUT ends in .mcap, else euroc]
    #[arg(long, value_enum, value_name = "FORMAT")]
    pub to: Option<To>,
    /// Calibration
    #[command(flatten)]
    pub calibration: CalibrationArguments,
}

/// Runs the command.
///
/// # Errors
/// A recording that cannot be read, a format that is not written, an OUT that exists.
pub fn run(args: &Args) -> Result<()> {
    let to = match args.to {
        Some(to) => to,
        None => format_of(&args.out)?,
    };
    let bar = progress::frame_bar(None);
    let converted = convert(&args.recording, &args.calibration.files(), &args.out, to.into(), |frames| {
        bar.set_message(format!("{frames} frames"));
        bar.inc(1);
    })?;
    bar.finish_and_clear();
    let Converted { frames, left_out } = converted;
    println!("{frames} frames written to {}", args.out.display());
    if !left_out.is_empty() {
        println!("not in the bag, which has no place for it: {}", left_out.join(", "));
    }
    Ok(())
}

fn format_of(out: &Path) -> Result<To> {
    let extension = out.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    Ok(match extension.as_str() {
        "mcap" => To::Mcap,
        "bag" => bail!(
            "rosbag1 is read only: write {}.mcap, or give --to rosbag2",
            out.with_extension("").display()
        ),
        "db3" => bail!("a rosbag2 is a folder: write {} with --to rosbag2", out.with_extension("").display()),
        _ => To::Euroc,
    })
}
