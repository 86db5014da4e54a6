//! `driftless play`: a recording as live topics.

use crate::playback::NativePlayer;
use anyhow::{Context as _, Result, bail};
use client::SessionArguments;
use client::session::{close_session, open_session};
use onboard::StopSignal;
use onboard::arguments::{CalibrationArguments, DEFAULT_ROBOT};
use sensors::{FolderCalibration, Recording};
use std::path::PathBuf;

/// Form of the topics.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Form {
    /// Driftless' own messages, for `onboard --source native`.
    Native,
}

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Example:\n  \
    map_server --map hall=hall.db --listen tcp/127.0.0.1:7447 &\n  \
    onboard --source native --calibration MH_03 --map hall --robot cart7 --out run &\n  \
    driftless play MH_03 --as native --robot cart7\n\n\
    Playing begins when the robot listens.")]
pub struct Args {
    /// The recording: a folder in the EuRoC layout
    #[arg(value_name = "SEQUENCE")]
    pub sequence: PathBuf,
    /// Form of the topics
    #[arg(long = "as", value_enum, value_name = "FORM", default_value = "native")]
    pub form: Form,
    /// Speed: 1 is that of the recording
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    pub rate: f64,
    /// Name of the robot that listens
    #[arg(long, value_name = "NAME", default_value = DEFAULT_ROBOT)]
    pub robot: String,
    /// Play images also where the recording has tracks
    #[arg(long)]
    pub images: bool,
    /// Calibration
    #[command(flatten)]
    pub calibration: CalibrationArguments,
    /// How it is connected
    #[command(flatten)]
    pub session: SessionArguments,
}

/// Runs the command.
///
/// # Errors
/// A recording that cannot be read, a session that cannot be opened.
pub fn run(args: &Args) -> Result<()> {
    if !(args.rate.is_finite() && args.rate > 0.0) {
        bail!("--rate is {}; it must be a positive number", args.rate);
    }
    let Form::Native = args.form;
    let stop = StopSignal::on_interrupt().context("signals cannot be handled")?;
    let files = args.calibration.files();
    let recording = Recording::open_with(&args.sequence, &files)?;
    let offset_ns = FolderCalibration::read(&args.sequence, &files)?.time_offset_ns;
    let mut contents = recording.contents();
    contents.tracks &= !args.images;
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?;
    let session = runtime
        .block_on(open_session(&args.session.connecting()))
        .context("the Zenoh session cannot be opened")?;
    let player = NativePlayer::new(&session, runtime.handle(), &args.robot, contents)?;
    player.wait_for_robot(&stop)?;
    let published = player.play(&mut recording.source()?, args.rate, offset_ns, &stop)?;
    println!("published {} readings and {} frames", published.readings, published.frames);
    drop(player);
    runtime.block_on(close_session(&session));
    Ok(())
}
