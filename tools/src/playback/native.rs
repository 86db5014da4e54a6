//! Topics in Driftless' own messages.

use super::SensorTopics;
use anyhow::{Context as _, Result};
use protocol::keys;
use protocol::sensors::{GnssMessage, ImageHeader, ImuMessage, TracksMessage, WheelMessage};
use sensors::{Contents, Frame, ImageData, ImuSample, TrackObservation};
use tokio::runtime::Handle;
use zenoh::pubsub::Publisher;
use zenoh::qos::CongestionControl;

/// The topics of a robot, for `onboard --source native`.
#[derive(Debug)]
pub struct NativeTopics<'a> {
    runtime: Handle,
    imu: Publisher<'a>,
    cameras: Vec<Publisher<'a>>,
    tracks: Publisher<'a>,
    wheels: Publisher<'a>,
    gnss: Publisher<'a>,
    contents: Contents,
}

impl NativeTopics<'_> {
    /// Declares the topics of a robot.
    ///
    /// # Arguments
    /// * `cameras`: how many the recording has.
    /// * `contents`: of the recording; tracks are played where it has them, else images.
    ///
    /// # Errors
    /// The name of the robot cannot be part of a key, or the session is closed.
    pub fn new(
        session: &zenoh::Session,
        runtime: &Handle,
        robot: &str,
        cameras: usize,
        contents: Contents,
    ) -> Result<Self> {
        let declare = |key: String| {
            let declared = runtime.block_on(async {
                session.declare_publisher(key.clone()).congestion_control(CongestionControl::Block).await
            });
            declared.map_err(|error| anyhow::anyhow!("{key} cannot be published: {error}"))
        };
        Ok(Self {
            runtime: runtime.clone(),
            imu: declare(keys::robot_imu(robot)?)?,
            cameras: (0..cameras)
                .map(|camera| declare(keys::robot_camera(robot, camera)?))
                .collect::<Result<_>>()?,
            tracks: declare(keys::robot_tracks(robot)?)?,
            wheels: declare(keys::robot_wheels(robot)?)?,
            gnss: declare(keys::robot_gnss(robot)?)?,
            contents,
        })
    }

    fn put(&self, publisher: &Publisher<'_>, payload: Vec<u8>, attachment: Option<Vec<u8>>) -> Result<()> {
        let sent = self.runtime.block_on(async { publisher.put(payload).attachment(attachment).await });
        sent.map_err(|error| anyhow::anyhow!("{}: {error}", publisher.key_expr()))
    }
}

impl SensorTopics for NativeTopics<'_> {
    fn are_heard(&self) -> Result<bool> {
        let frames = if self.contents.tracks { &self.tracks } else { &self.cameras[0] };
        let listens = |publisher: &Publisher<'_>| {
            let status = self.runtime.block_on(async { publisher.matching_status().await });
            status.map(|status| status.matching()).map_err(|error| anyhow::anyhow!("{error}"))
        };
        Ok(listens(&self.imu)? && listens(frames)?)
    }

    fn why_unheard(&self) -> Result<String> {
        let frames = if self.contents.tracks { &self.tracks } else { &self.cameras[0] };
        Ok(format!("nobody subscribes to {} and {}", self.imu.key_expr(), frames.key_expr()))
    }

    fn reading(&self, reading: &ImuSample) -> Result<()> {
        let ImuSample { stamp_ns, gyroscope, accelerometer } = *reading;
        let message =
            ImuMessage { stamp_ns, gyroscope: gyroscope.into(), accelerometer: accelerometer.into() };
        self.put(&self.imu, serde_json::to_vec(&message)?, None)
    }

    fn frame(&self, frame: &Frame) -> Result<()> {
        let stamp_ns = frame.stamp_ns;
        if self.contents.tracks {
            let row =
                |track: &TrackObservation| (track.camera, track.feature_id, track.pixel.x, track.pixel.y);
            let tracks = frame.tracks.iter().map(row).collect();
            let message = TracksMessage { stamp_ns, tracks, features: frame.features.get(&0).cloned() };
            return self.put(&self.tracks, serde_json::to_vec(&message)?, None);
        }
        for (camera, image) in &frame.images {
            let Some(publisher) = self.cameras.get(*camera) else { continue };
            let (header, bytes) = message_of(stamp_ns, image)?;
            self.put(publisher, bytes, Some(serde_json::to_vec(&header)?))?;
        }
        Ok(())
    }

    fn wheels(&self, message: &WheelMessage) -> Result<bool> {
        self.put(&self.wheels, serde_json::to_vec(message)?, None)?;
        Ok(true)
    }

    fn gnss(&self, message: &GnssMessage) -> Result<bool> {
        self.put(&self.gnss, serde_json::to_vec(message)?, None)?;
        Ok(true)
    }
}

/// Header and bytes of an image: files are sent as they are.
fn message_of(stamp_ns: i64, image: &ImageData) -> Result<(ImageHeader, Vec<u8>)> {
    let header = |encoding: &str, width, height| ImageHeader {
        stamp_ns,
        encoding: encoding.to_owned(),
        width,
        height,
        step: None,
    };
    if let Some(path) = image.path() {
        let bytes =
            files::read(path, vision::MAX_IMAGE_FILE_BYTES).with_context(|| path.display().to_string())?;
        let is_png = bytes.starts_with(b"\x89PNG");
        return Ok((header(if is_png { "png" } else { "jpeg" }, 0, 0), bytes));
    }
    let gray = image.read()?;
    Ok((header("mono8", gray.width() as u32, gray.height() as u32), gray.pixels().to_vec()))
}
