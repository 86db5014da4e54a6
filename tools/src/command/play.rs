//! `driftless play`: a recording as live topics.

use crate::playback::{NativeTopics, Published, RosTopics, SensorTopics, play, wait_for_robot};
use anyhow::{Context as _, Result, bail};
use client::SessionArguments;
use client::session::{close_session, open_session};
use onboard::StopSignal;
use onboard::arguments::{CalibrationArguments, DEFAULT_ROBOT};
use onboard::stop::NetworkRuntime;
use ros2::NodeOptions;
use sensors::Recording;
use std::path::PathBuf;

/// Form of the topics.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Form {
    /// Driftless' own messages, for `onboard --source native`.
    Native,
    /// ROS 2 over rmw_zenoh: /clock, /imu0, /cam0/image_raw, /cam0/image_raw/compressed, /cam0/camera_info.
    Ros2,
}

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Example:\n  \
    map_server --map hall=hall.db --listen tcp/127.0.0.1:7447 &\n  \
    onboard --source native --calibration MH_03 --map hall --robot cart7 --out run &\n  \
    driftless play MH_03 --as native --robot cart7\n\n  \
    onboard --source ros2 --imu-topic /imu0 --camera-topic /cam0/image_raw --calibration MH_03 --mode odometry --out run &\n  \
    driftless play MH_03 --as ros2\n\n\
    Playing begins when the robot listens.")]
pub struct Args {
    /// The recording: a folder in the EuRoC layout, or a bag
    #[arg(value_name = "REC")]
    pub recording: PathBuf,
    /// Form of the topics
    #[arg(long = "as", value_enum, value_name = "FORM", default_value = "native")]
    pub form: Form,
    /// Speed: 1 is that of the recording
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    pub rate: f64,
    /// Name of the robot that listens to native topics
    #[arg(long, value_name = "NAME", default_value = DEFAULT_ROBOT)]
    pub robot: String,
    /// ROS_DOMAIN_ID of the nodes that listen
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub ros2_domain: u32,
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
    let stop = StopSignal::on_interrupt().context("signals cannot be handled")?;
    let files = args.calibration.files();
    let recording = Recording::open_with(&args.recording, &files)?;
    let mut contents = recording.contents();
    contents.tracks &= !args.images;
    let runtime = NetworkRuntime::new()?;
    let opened = runtime.block_on(stop.until(open_session(&args.session.connecting())));
    let Some(session) = opened else { bail!("interrupted before {} answered", args.session.place()) };
    let session = session.context("the Zenoh session cannot be opened")?;
    let topics: Box<dyn SensorTopics> = match args.form {
        Form::Native => {
            let cameras = recording.calibration().cameras.len();
            Box::new(NativeTopics::new(&session, runtime.handle(), &args.robot, cameras, contents)?)
        }
        Form::Ros2 if !contents.images => {
            bail!(
                "{} has no images, and ROS 2 has no messages for tracks: play it --as native",
                args.recording.display()
            )
        }
        Form::Ros2 => {
            let node = NodeOptions {
                domain: args.ros2_domain,
                name: "driftless_play".to_owned(),
                ..NodeOptions::default()
            };
            let cameras = &recording.calibration().cameras;
            Box::new(RosTopics::new(session.clone(), runtime.handle(), node, cameras)?)
        }
    };
    wait_for_robot(topics.as_ref(), &stop)?;
    let published =
        play(topics.as_ref(), &mut recording.source()?, args.rate, recording.time_offset_ns(), &stop)?;
    let Published { readings, frames, wheels, positions } = published;
    println!(
        "published {readings} readings, {frames} frames, {wheels} readings of wheels and {positions} positions of GNSS"
    );
    drop(topics);
    runtime.block_on(close_session(&session));
    Ok(())
}
