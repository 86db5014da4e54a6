//! The recording of a run as ROS 2 messages in an MCAP file: what the robot publishes, its queries, and its sensors.
//!
//! Files are written on a thread of their own. A failing disk ends the recording, not the run.

use super::recording_queue::RecordingQueue;
use super::recording_settings::RecordingSettings;
use super::ros::{Diagnostics, OdomFrame, map_tilt_deg, messages};
use super::sensor_topics::{SensorTopics, mounting};
use bags::{BagError, Format};
use estimator::ImuSample;
use geometry::PoseWithCovariance;
use robot::{Estimate, Event, Output, StatusReport};
use ros_messages::RosMessage;
use ros_messages::builtin_interfaces::Time;
use ros_messages::diagnostic_msgs::{DiagnosticArray, DiagnosticStatus, KeyValue};
use ros_messages::std_msgs::Header;
use sensors::live::Stream;
use sensors::ros::{GNSS_TOPIC, WHEEL_TOPIC, imu_message, position_message, wheel_message};
use sensors::ros_bag::RosBagWriter;
use sensors::{Frame, GnssReading, WheelReading};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Statuses before the first frame that are kept; of more the last.
const MOST_FIRST_STATUSES: usize = 600;

/// A recording that is being written.
#[derive(Debug)]
pub(crate) struct MessageRecording {
    settings: RecordingSettings,
    topics: SensorTopics,
    queue: RecordingQueue,
    odom: OdomFrame,
    clock_shift_ns: i64,
    /// That of the last estimate.
    map_tilt_deg: Option<f64>,
    /// Whether the robot's frame was known when it was recorded where the sensors are.
    mounted: Option<bool>,
    /// Statuses before the first frame, which tells the time of the sensors, and when they were made.
    first_statuses: Vec<(Instant, StatusReport)>,
}

impl MessageRecording {
    /// Creates the file, beside an older one of that name under another: `drive_2.mcap`.
    ///
    /// # Errors
    /// [`BagError`]: the file cannot be created.
    pub(crate) fn start(path: &Path, settings: RecordingSettings) -> Result<Self, BagError> {
        let path = unused(path);
        let mut writer = RosBagWriter::create(&path, Format::Mcap)?;
        let cameras = if settings.sensors { &*settings.calibration.cameras } else { &[] };
        let topics = SensorTopics::new(&settings.body.sensor_frames, cameras);
        if settings.sensors {
            writer.write_sensors(&topics, &settings.calibration)?;
        }
        let queue = RecordingQueue::start(path, writer, settings.realtime)?;
        Ok(Self {
            settings,
            topics,
            queue,
            odom: OdomFrame::default(),
            clock_shift_ns: 0,
            map_tilt_deg: None,
            mounted: None,
            first_statuses: Vec::new(),
        })
    }

    fn record_status(&mut self, stamp_ns: i64, report: &StatusReport) {
        let stamp_ns = stamp_ns.saturating_add(self.clock_shift_ns);
        let RecordingSettings { robot, map_expected, body, .. } = &self.settings;
        let diagnostics =
            Diagnostics::of(robot, *map_expected, body, self.map_tilt_deg, stamp_ns, report).message;
        self.message("/diagnostics", stamp_ns, &diagnostics);
    }

    /// Keeps a status until the time of the sensors is known. Without any frame it is not recorded.
    fn keep_status(&mut self, report: &StatusReport) {
        if self.first_statuses.len() == MOST_FIRST_STATUSES {
            self.first_statuses.remove(0);
        }
        self.first_statuses.push((Instant::now(), report.clone()));
    }

    /// Says where the sensors are mounted, before anything else, and again where the robot's frame has become known.
    fn mount(&mut self, stamp_ns: i64) {
        let Some(stamp) = Time::from_nanoseconds(stamp_ns) else { return };
        let RecordingSettings { body, calibration, sensors, .. } = &self.settings;
        let is_known = Some(!body.mount.is_assumed());
        if self.mounted.is_some() && self.mounted == is_known {
            return;
        }
        self.mounted = is_known;
        let mounting = mounting(body, &calibration.cameras, *sensors, stamp);
        if !mounting.transforms.is_empty() {
            self.queue.message("/tf_static", stamp_ns, &mounting, None);
        }
    }

    fn message<M: RosMessage>(&mut self, topic: &str, stamp_ns: i64, message: &M) {
        self.mount(stamp_ns);
        self.queue.message(topic, stamp_ns, message, None);
    }
}

impl Output for MessageRecording {
    fn set_clock_shift(&mut self, shift_ns: i64) {
        self.clock_shift_ns = shift_ns;
    }

    fn restart(&mut self) {
        self.odom.restart();
    }

    fn correct(&mut self, before: &PoseWithCovariance, after: &PoseWithCovariance) {
        self.odom.correct(before, after);
    }

    /// Records odometry, transforms, and the pose in the map.
    fn estimate(&mut self, estimate: &Estimate) {
        self.map_tilt_deg = map_tilt_deg(estimate);
        let mut estimate = estimate.clone();
        estimate.motion.stamp_ns = estimate.motion.stamp_ns.saturating_add(self.clock_shift_ns);
        let stamp_ns = estimate.motion.stamp_ns;
        let Some(made) = messages(&self.settings.body, &mut self.odom, &estimate) else { return };
        self.message("/odometry", stamp_ns, &made.odometry);
        self.message("/tf", stamp_ns, &made.transforms);
        if let Some(pose) = &made.pose {
            self.message("/pose", stamp_ns, pose);
        }
    }

    /// Records the status; one before the first frame is kept until the time of the sensors is known.
    fn status(&mut self, report: &StatusReport) {
        match report.stamp_ns {
            Some(stamp_ns) => self.record_status(stamp_ns, report),
            None => self.keep_status(report),
        }
    }

    /// The first frame has come: records the statuses that were kept, as long before it as they were made.
    fn begin(&mut self, stamp_ns: i64) {
        let now = Instant::now();
        for (made, report) in std::mem::take(&mut self.first_statuses) {
            let before_ns = i64::try_from(now.duration_since(made).as_nanos()).unwrap_or(i64::MAX);
            // Clocks that begin with the robot are young.
            self.record_status(stamp_ns.saturating_sub(before_ns).max(0), &report);
        }
    }

    /// Records the result of a query, at the time of its image.
    fn query(&mut self, event: &Event) {
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

    fn set_best_effort(&mut self, streams: &[Stream]) {
        self.topics.set_best_effort(streams);
    }

    /// Records a reading of the IMU, where sensors are to be recorded.
    fn reading(&mut self, reading: &ImuSample) {
        if !self.settings.sensors {
            return;
        }
        let stamp_ns = reading.stamp_ns.saturating_add(self.clock_shift_ns);
        self.mount(stamp_ns);
        if let Some(message) = imu_message(&ImuSample { stamp_ns, ..*reading }, self.topics.imu_frame()) {
            self.queue.message("/imu", stamp_ns, &message, Some(self.topics.qos(Stream::Imu)));
        }
    }

    /// Records a reading of the wheels, where sensors are to be recorded.
    fn wheels(&mut self, reading: &WheelReading) {
        let Some(wheels) = self.settings.calibration.wheels.filter(|_| self.settings.sensors) else { return };
        let stamp_ns = reading.stamp_ns.saturating_add(self.clock_shift_ns);
        self.mount(stamp_ns);
        let (reading, base) = (WheelReading { stamp_ns, ..*reading }, &self.settings.body.frames.base_link);
        if let Some(message) = wheel_message(&reading, wheels.base.kind(), base) {
            self.queue.message(WHEEL_TOPIC, stamp_ns, &message, Some(self.topics.qos(Stream::Wheels)));
        }
    }

    /// Records a position of GNSS, where sensors are to be recorded.
    fn gnss(&mut self, reading: &GnssReading) {
        if !self.settings.sensors || self.settings.calibration.gnss.is_none() {
            return;
        }
        let stamp_ns = reading.stamp_ns.saturating_add(self.clock_shift_ns);
        self.mount(stamp_ns);
        let reading = GnssReading { stamp_ns, ..*reading };
        if let Some(message) = position_message(&reading, &self.settings.body.frames.map) {
            self.queue.message(GNSS_TOPIC, stamp_ns, &message, Some(self.topics.qos(Stream::Gnss)));
        }
    }

    /// Records the images of a frame with the projections of their cameras, where sensors are to be recorded.
    fn frame(&mut self, frame: &Frame) {
        if !self.settings.sensors {
            return;
        }
        let stamp_ns = frame.stamp_ns.saturating_add(self.clock_shift_ns);
        self.mount(stamp_ns);
        for (&camera, image) in &frame.images {
            let Some(name) = self.topics.camera_frame(camera) else { continue };
            let qos = Some(self.topics.qos(Stream::Camera(camera)));
            if let Some((topic, info)) = self.topics.info(camera, stamp_ns) {
                self.queue.message(&topic, stamp_ns, &info, qos);
            }
            self.queue.image((camera, name), stamp_ns, image.clone(), qos);
        }
    }
}

/// The path itself, or one beside it that does not exist. What is behind the last dot of the name stays its end.
fn unused(path: &Path) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let extension = path.extension().map_or_else(String::new, |end| format!(".{}", end.to_string_lossy()));
    let numbered = |number: u32| path.with_file_name(format!("{stem}_{number}{extension}"));
    let candidates = std::iter::once(path.to_path_buf()).chain((2..).map(numbered));
    candidates.into_iter().find(|candidate| !candidate.exists()).unwrap_or_else(|| path.to_path_buf())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_that_is_taken_gets_a_number_before_its_end_whatever_dots_it_has() {
        let folder = tempfile::tempdir().unwrap();
        for (name, second, third) in [
            ("drive.mcap", "drive_2.mcap", "drive_3.mcap"),
            ("2026.11.30.mcap", "2026.11.30_2.mcap", "2026.11.30_3.mcap"),
            ("robot.v1.5.mcap", "robot.v1.5_2.mcap", "robot.v1.5_3.mcap"),
            ("drive", "drive_2", "drive_3"),
        ] {
            let path = folder.path().join(name);
            for expected in [name, second, third] {
                let found = unused(&path);
                assert_eq!(found, folder.path().join(expected));
                std::fs::write(found, "").unwrap();
            }
        }
    }
}
