//! The recording of a run as ROS 2 messages in an MCAP file: what the robot publishes, its queries, and its sensors.
//!
//! Files are written on a thread of their own. A failing disk ends the recording, not the run.

use super::event::Event;
use super::publisher::QueryCounts;
use super::recording_settings::RecordingSettings;
use super::ros::{Diagnostics, Estimate, OdomFrame, messages, static_transforms};
use bags::{BagError, Format, MessageType};
use estimator::{ImuSample, Status};
use geometry::PoseWithCovariance;
use ros_messages::diagnostic_msgs::{DiagnosticArray, DiagnosticStatus, KeyValue};
use ros_messages::sensor_msgs::{CompressedImage, Image};
use ros_messages::std_msgs::Header;
use ros_messages::{RosMessage, encode};
use sensors::ros::{image_message, imu_message};
use sensors::ros_bag::{RosBagWriter, message_type};
use sensors::{Frame, ImageData};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Messages that may wait for the disk; in real time further ones are dropped.
const QUEUE: usize = 256;
/// What was written is readable after so long, also when the robot is switched off.
const FLUSH: Duration = Duration::from_secs(1);

/// Statuses before the first frame that are kept; of more the last.
const MOST_FIRST_STATUSES: usize = 600;

/// A recording that is being written.
#[derive(Debug)]
pub(crate) struct MessageRecording {
    settings: RecordingSettings,
    odom: OdomFrame,
    clock_shift_ns: i64,
    /// Whether it is recorded where the sensors are mounted.
    has_mounting: bool,
    path: PathBuf,
    queue: Option<SyncSender<Item>>,
    thread: Option<JoinHandle<()>>,
    dropped: u64,
    /// Statuses before the first frame, which tells the time of the sensors, and when they were made.
    first_statuses: Vec<(Instant, Status, QueryCounts)>,
}

/// A message on its way to the disk.
struct Item {
    topic: String,
    /// Makes the type, with its definition: by the thread, once a topic.
    of: fn() -> MessageType,
    stamp_ns: i64,
    content: Content,
}

enum Content {
    Cdr(Vec<u8>),
    /// Read and encoded by the thread.
    Image(ImageData),
}

impl MessageRecording {
    /// Creates the file, beside an older one of that name under another: `drive_2.mcap`.
    ///
    /// # Errors
    /// [`BagError`]: the file cannot be created.
    pub(crate) fn start(path: &Path, settings: RecordingSettings) -> Result<Self, BagError> {
        let path = unused(path);
        let writer = RosBagWriter::create(&path, Format::Mcap)?;
        let (queue, items) = sync_channel(QUEUE);
        let file = path.clone();
        let thread = std::thread::Builder::new()
            .name("recording".into())
            .spawn(move || {
                if let Err(error) = write_all(writer, &items) {
                    tracing::warn!(%error, "the recording {} ends here; the run continues", file.display());
                }
            })
            .map_err(|source| BagError::Io { path: path.clone(), source })?;
        let (queue, thread) = (Some(queue), Some(thread));
        let odom = OdomFrame::default();
        Ok(Self {
            settings,
            odom,
            clock_shift_ns: 0,
            has_mounting: false,
            path,
            queue,
            thread,
            dropped: 0,
            first_statuses: Vec::new(),
        })
    }

    /// Sets what is added to all stamps, nanoseconds.
    pub(crate) fn set_clock_shift(&mut self, shift_ns: i64) {
        self.clock_shift_ns = shift_ns;
    }

    /// The estimator starts again, with another odometry frame.
    pub(crate) fn restart(&mut self) {
        self.odom.restart();
    }

    /// The map corrected the pose of the IMU in L, at one time.
    pub(crate) fn correct(&mut self, before: &PoseWithCovariance, after: &PoseWithCovariance) {
        self.odom.correct(before, after);
    }

    /// Records odometry, transforms, and the pose in the map.
    pub(crate) fn estimate(&mut self, estimate: &Estimate) {
        let mut estimate = estimate.clone();
        estimate.motion.stamp_ns = estimate.motion.stamp_ns.saturating_add(self.clock_shift_ns);
        let stamp_ns = estimate.motion.stamp_ns;
        let Some(made) = messages(&self.settings.body, &mut self.odom, &estimate) else { return };
        if !std::mem::replace(&mut self.has_mounting, true) {
            let stamp = made.odometry.header.stamp;
            let mounting = static_transforms(&self.settings.body, &self.settings.cameras, stamp);
            self.message("/tf_static", stamp_ns, &mounting);
        }
        self.message("/odometry", stamp_ns, &made.odometry);
        self.message("/tf", stamp_ns, &made.transforms);
        if let Some(pose) = &made.pose {
            self.message("/pose", stamp_ns, pose);
        }
    }

    /// Records the status.
    pub(crate) fn status(&mut self, stamp_ns: i64, status: &Status, counts: QueryCounts) {
        let stamp_ns = stamp_ns.saturating_add(self.clock_shift_ns);
        let RecordingSettings { robot, map_expected, .. } = &self.settings;
        let diagnostics = Diagnostics::of(robot, *map_expected, stamp_ns, status, counts).message;
        self.message("/diagnostics", stamp_ns, &diagnostics);
    }

    /// Keeps a status until the time of the sensors is known. Without any frame it is not recorded.
    pub(crate) fn first_status(&mut self, status: &Status, counts: QueryCounts) {
        if self.first_statuses.len() == MOST_FIRST_STATUSES {
            self.first_statuses.remove(0);
        }
        self.first_statuses.push((Instant::now(), status.clone(), counts));
    }

    /// The first frame has come: records the statuses that were kept, as long before it as they were made.
    pub(crate) fn begin(&mut self, stamp_ns: i64) {
        let now = Instant::now();
        for (made, status, counts) in std::mem::take(&mut self.first_statuses) {
            let before_ns = i64::try_from(now.duration_since(made).as_nanos()).unwrap_or(i64::MAX);
            self.status(stamp_ns.saturating_sub(before_ns), &status, counts);
        }
    }

    /// Records the result of a query, at the time of its image.
    pub(crate) fn event(&mut self, event: &Event) {
        let stamp_ns = event.stamp_ns.saturating_add(self.clock_shift_ns);
        let value = |key: &str, value: String| KeyValue { key: key.to_owned(), value };
        let status = DiagnosticStatus {
            level: if event.accepted { DiagnosticStatus::OK } else { DiagnosticStatus::WARN },
            name: "driftless: map query".to_owned(),
            message: [event.outcome.as_str(), event.reason.as_str()].join(" ").trim_end().to_owned(),
            hardware_id: self.settings.robot.clone(),
            values: vec![
                value("applied at", event.applied_at_s.to_string()),
                value("keyframes", event.keyframes.to_string()),
                value("matches", event.matches.to_string()),
                value("inliers", event.inliers.to_string()),
                value("used", event.used.to_string()),
            ],
        };
        let Some(header) = Header::new(stamp_ns, "") else { return };
        self.message("/map_queries", stamp_ns, &DiagnosticArray { header, status: vec![status] });
    }

    /// Records a reading of the IMU, where sensors are to be recorded.
    pub(crate) fn reading(&mut self, reading: &ImuSample) {
        if !self.settings.sensors {
            return;
        }
        let stamp_ns = reading.stamp_ns.saturating_add(self.clock_shift_ns);
        if let Some(message) = imu_message(&ImuSample { stamp_ns, ..*reading }) {
            self.message("/imu", stamp_ns, &message);
        }
    }

    /// Records the images of a frame, where sensors are to be recorded.
    pub(crate) fn frame(&mut self, frame: &Frame) {
        if !self.settings.sensors {
            return;
        }
        let stamp_ns = frame.stamp_ns.saturating_add(self.clock_shift_ns);
        for (camera, image) in frame.images.iter().enumerate() {
            let Some(image) = image.clone() else { continue };
            let (topic, of): (_, fn() -> MessageType) = match image.path() {
                Some(_) => (format!("/cam{camera}/image_raw/compressed"), message_type::<CompressedImage>),
                None => (format!("/cam{camera}/image_raw"), message_type::<Image>),
            };
            self.send(Item { topic, of, stamp_ns, content: Content::Image(image) });
        }
    }

    fn message<M: RosMessage>(&mut self, topic: &str, stamp_ns: i64, message: &M) {
        let Ok(bytes) = encode(message) else { return };
        let content = Content::Cdr(bytes);
        self.send(Item { topic: topic.to_owned(), of: message_type::<M>, stamp_ns, content });
    }

    /// Sends to the thread, which is gone where writing failed: that was said.
    fn send(&mut self, item: Item) {
        let Some(queue) = &self.queue else { return };
        if !self.settings.realtime {
            let _ = queue.send(item);
        } else if matches!(queue.try_send(item), Err(std::sync::mpsc::TrySendError::Full(_))) {
            self.dropped += 1;
        }
    }
}

impl Drop for MessageRecording {
    fn drop(&mut self) {
        self.queue = None;
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the thread of the recording panicked");
        }
        if self.dropped > 0 {
            let path = self.path.display();
            tracing::warn!("{} messages are missing in {path}: the disk is too slow", self.dropped);
        }
    }
}

/// The path itself, or one beside it that does not exist.
fn unused(path: &Path) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let extension = path.extension().unwrap_or_default().to_string_lossy().into_owned();
    let numbered = |number: u32| path.with_file_name(format!("{stem}_{number}")).with_extension(&extension);
    let candidates = std::iter::once(path.to_path_buf()).chain((2..).map(numbered));
    candidates.into_iter().find(|candidate| !candidate.exists()).unwrap_or_else(|| path.to_path_buf())
}

fn write_all(mut writer: RosBagWriter, items: &Receiver<Item>) -> Result<(), BagError> {
    let mut flushed = Instant::now();
    loop {
        match items.recv_timeout(FLUSH) {
            Ok(Item { topic, of, stamp_ns, content }) => {
                let bytes = match content {
                    Content::Cdr(bytes) => Some(bytes),
                    Content::Image(image) => image_bytes(&image, stamp_ns, &topic),
                };
                if let Some(bytes) = bytes {
                    writer.write(&topic, of, stamp_ns, &bytes)?;
                }
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return writer.finish(),
        }
        if flushed.elapsed() >= FLUSH {
            writer.flush()?;
            flushed = Instant::now();
        }
    }
}

/// An image as CDR; one that cannot be read is left out.
fn image_bytes(image: &ImageData, stamp_ns: i64, topic: &str) -> Option<Vec<u8>> {
    let frame = topic.trim_start_matches('/').split('/').next().unwrap_or_default();
    let message = image_message(image, stamp_ns, frame)
        .inspect_err(|error| tracing::warn!(%error, "an image is not recorded"));
    message.ok()??.encode().ok()
}
