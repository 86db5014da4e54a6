//! Switches of live sensors.

use super::choices::FrameKind;
use super::{INPUT, RobotArguments};
use anyhow::{Result, bail};
use clap::Args;
use client::SessionOptions;
use sensors::FolderCalibration;
use sensors::live::{LiveFrames, LiveSettings, Stream};

/// Frames that may wait for the estimator.
const DEFAULT_WAITING_FRAMES: usize = 5;

/// How live sensors are taken.
#[derive(Args, Clone, Debug)]
pub struct LiveArguments {
    /// What live frames are made of
    #[arg(long, value_enum, value_name = "WHAT", default_value = "images", help_heading = INPUT)]
    pub live_frames: FrameKind,
    /// Endpoint on which the robot itself listens to drivers of --source native, for example tcp/127.0.0.1:7448 [default: they
    /// come over the session to the map]
    ///
    /// Whoever reaches it is believed, so use an address of the robot itself. Sensors then come without a map server or a
    /// router, and not over the network.
    #[arg(long, value_name = "ENDPOINT", conflicts_with = "sensors_connect", help_heading = INPUT)]
    pub sensors_listen: Option<String>,
    /// Zenoh router that drivers of --source native are connected to, where that is not the one of the map
    #[arg(long, value_name = "ENDPOINT", help_heading = INPUT)]
    pub sensors_connect: Option<String>,
    /// Live frames that may wait for the estimator, of each of several cameras that are triggered apart; beyond, the oldest is
    /// dropped
    #[arg(long, value_name = "N", default_value_t = DEFAULT_WAITING_FRAMES, help_heading = INPUT)]
    pub max_waiting_frames: usize,
}

impl LiveArguments {
    /// Settings of the source.
    ///
    /// # Errors
    /// A switch is out of range, or contradicts the calibration.
    pub fn settings(&self, calibration: &FolderCalibration, robot: &RobotArguments) -> Result<LiveSettings> {
        if self.max_waiting_frames == 0 {
            bail!("--max-waiting-frames is 0; it must be at least 1");
        }
        let mut settings = LiveSettings::of_files(calibration);
        settings.cameras = robot.camera_count(&calibration.sensors)?;
        settings.max_waiting_frames = self.max_waiting_frames;
        settings.frames = match self.live_frames {
            FrameKind::Images => LiveFrames::Images,
            FrameKind::Tracks => LiveFrames::Tracks { features: false },
            FrameKind::Features => LiveFrames::Tracks { features: true },
        };
        Ok(settings)
    }

    /// The switches that differ from their defaults and have no effect where a recording is played.
    fn unused_by_recording(&self) -> Vec<&'static str> {
        let switches = [
            ("--live-frames", self.live_frames != FrameKind::default()),
            ("--max-waiting-frames", self.max_waiting_frames != DEFAULT_WAITING_FRAMES),
        ];
        switches.into_iter().filter(|(_, is_given)| *is_given).map(|(name, _)| name).collect()
    }

    /// Warns of switches that have no effect where a recording is played.
    pub fn warn_of_recording(&self) {
        let unused = self.unused_by_recording();
        if !unused.is_empty() {
            tracing::warn!(
                "{}: this is about live sensors, and a recording is played: leave it out, or name the sensors with --source",
                unused.join(", ")
            );
        }
    }

    /// The session that native sensors come over, where they have one of their own.
    pub fn session(&self) -> Option<SessionOptions> {
        let [listen, connect] =
            [&self.sensors_listen, &self.sensors_connect].map(|endpoint| endpoint.iter().cloned().collect());
        let options = SessionOptions { listen, connect, ..SessionOptions::default() };
        (self.sensors_listen.is_some() || self.sensors_connect.is_some()).then_some(options)
    }

    /// The streams that are expected with these settings.
    pub fn streams(settings: &LiveSettings) -> Vec<Stream> {
        let frames = match settings.frames {
            LiveFrames::Images => (0..settings.cameras).map(Stream::Camera).collect(),
            _ => vec![Stream::Tracks],
        };
        let wheels = settings.wheels.map(|_| Stream::Wheels);
        let gnss = settings.gnss.then_some(Stream::Gnss);
        std::iter::once(Stream::Imu).chain(frames).chain(wheels).chain(gnss).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        live: LiveArguments,
    }

    #[test]
    fn switches_that_have_no_effect_on_a_recording_are_named() {
        let unused = |line: &str| {
            let line = std::iter::once("robot").chain(line.split_whitespace());
            Line::try_parse_from(line).unwrap().live.unused_by_recording()
        };
        assert!(unused("").is_empty() && unused("--live-frames images").is_empty());
        assert_eq!(
            unused("--live-frames tracks --max-waiting-frames 9"),
            ["--live-frames", "--max-waiting-frames"]
        );
    }
}
