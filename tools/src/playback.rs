//! Publishes a recording as live sensors would, in Driftless' own messages.

use anyhow::{Context as _, Result};
use onboard::StopSignal;
use protocol::keys;
use protocol::sensors::{ImageHeader, ImuMessage, TracksMessage};
use sensors::{Contents, Frame, ImageData, ImuSample, SensorEvent, SensorSource};
use std::time::{Duration, Instant};
use tokio::runtime::Handle;
use zenoh::pubsub::Publisher;
use zenoh::qos::CongestionControl;

/// How often it is looked whether a robot listens, and how often it is said that none does.
const LOOK: Duration = Duration::from_millis(50);
const LOOKS_A_WARNING: u32 = 40;

/// What was published.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Published {
    /// Readings of the IMU.
    pub readings: usize,
    /// Frames: images or pairs of images, or tracks.
    pub frames: usize,
}

/// The topics of a robot.
#[derive(Debug)]
pub struct NativePlayer<'a> {
    runtime: Handle,
    imu: Publisher<'a>,
    cameras: [Publisher<'a>; 2],
    tracks: Publisher<'a>,
    contents: Contents,
}

impl NativePlayer<'_> {
    /// Declares the topics of a robot.
    ///
    /// # Arguments
    /// * `contents`: of the recording; tracks are played where it has them, else images.
    ///
    /// # Errors
    /// The name of the robot cannot be part of a key, or the session is closed.
    pub fn new(session: &zenoh::Session, runtime: &Handle, robot: &str, contents: Contents) -> Result<Self> {
        let declare = |key: String| {
            let declared = runtime.block_on(async {
                session.declare_publisher(key.clone()).congestion_control(CongestionControl::Block).await
            });
            declared.map_err(|error| anyhow::anyhow!("{key} cannot be published: {error}"))
        };
        Ok(Self {
            runtime: runtime.clone(),
            imu: declare(keys::robot_imu(robot)?)?,
            cameras: [declare(keys::robot_camera(robot, 0)?)?, declare(keys::robot_camera(robot, 1)?)?],
            tracks: declare(keys::robot_tracks(robot)?)?,
            contents,
        })
    }

    /// Waits until a robot listens to the IMU and to the frames, or until `stop` is raised.
    ///
    /// # Errors
    /// The session is closed.
    pub fn wait_for_robot(&self, stop: &StopSignal) -> Result<()> {
        let frames = if self.contents.tracks { &self.tracks } else { &self.cameras[0] };
        let mut looks = 0;
        while !stop.is_stopped() {
            let listens = |publisher: &Publisher<'_>| {
                let status = self.runtime.block_on(async { publisher.matching_status().await });
                status.map(|status| status.matching()).map_err(|error| anyhow::anyhow!("{error}"))
            };
            if listens(&self.imu)? && listens(frames)? {
                break;
            }
            looks += 1;
            if looks % LOOKS_A_WARNING == 0 {
                tracing::warn!("no robot listens to {} yet", frames.key_expr());
            }
            std::thread::sleep(LOOK);
        }
        Ok(())
    }

    /// Plays a source until its end, or until `stop` is raised.
    ///
    /// # Arguments
    /// * `rate`: 1 for the speed of the recording.
    /// * `time_offset_ns`: subtracted from the stamps of frames: a calibrated offset, which the robot adds.
    ///
    /// # Errors
    /// A recording that cannot be read, a session that is closed.
    pub fn play(
        &self,
        source: &mut dyn SensorSource,
        rate: f64,
        time_offset_ns: i64,
        stop: &StopSignal,
    ) -> Result<Published> {
        let (mut published, begin, mut first_ns) = (Published::default(), Instant::now(), None);
        while let Some(event) = source.next()? {
            let Some(stamp_ns) = event.stamp_ns() else { continue };
            let since_ns = (stamp_ns - *first_ns.get_or_insert(stamp_ns)).max(0);
            stop.sleep_until(begin + Duration::from_secs_f64(since_ns as f64 * 1e-9 / rate));
            if stop.is_stopped() {
                break;
            }
            match event {
                SensorEvent::Imu(reading) => {
                    self.reading(&reading)?;
                    published.readings += 1;
                }
                SensorEvent::Frame(frame) => {
                    self.frame(Frame { stamp_ns: frame.stamp_ns - time_offset_ns, ..frame })?;
                    published.frames += 1;
                }
                _ => {}
            }
        }
        Ok(published)
    }

    fn reading(&self, reading: &ImuSample) -> Result<()> {
        let ImuSample { stamp_ns, gyroscope, accelerometer } = *reading;
        let message =
            ImuMessage { stamp_ns, gyroscope: gyroscope.into(), accelerometer: accelerometer.into() };
        self.put(&self.imu, serde_json::to_vec(&message)?, None)
    }

    fn frame(&self, frame: Frame) -> Result<()> {
        let stamp_ns = frame.stamp_ns;
        if self.contents.tracks {
            let row = |track: &sensors::TrackObservation| {
                (track.camera, track.feature_id, track.pixel.x, track.pixel.y)
            };
            let tracks = frame.tracks.iter().map(row).collect();
            let message = TracksMessage { stamp_ns, tracks, features: frame.features };
            return self.put(&self.tracks, serde_json::to_vec(&message)?, None);
        }
        for (image, publisher) in frame.images.iter().zip(&self.cameras) {
            let Some(image) = image else { continue };
            let (header, bytes) = message_of(stamp_ns, image)?;
            self.put(publisher, bytes, Some(serde_json::to_vec(&header)?))?;
        }
        Ok(())
    }

    fn put(&self, publisher: &Publisher<'_>, payload: Vec<u8>, attachment: Option<Vec<u8>>) -> Result<()> {
        let sent = self.runtime.block_on(async { publisher.put(payload).attachment(attachment).await });
        sent.map_err(|error| anyhow::anyhow!("{}: {error}", publisher.key_expr()))
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
        let bytes = std::fs::read(path).with_context(|| path.display().to_string())?;
        let is_png = bytes.starts_with(b"\x89PNG");
        return Ok((header(if is_png { "png" } else { "jpeg" }, 0, 0), bytes));
    }
    let gray = image.read()?;
    Ok((header("mono8", gray.width() as u32, gray.height() as u32), gray.pixels().to_vec()))
}
