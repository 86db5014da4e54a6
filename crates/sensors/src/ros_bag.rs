//! Bags of ROS 2 messages, written.

use crate::SensorCalibration;
use crate::euroc::writer::gnss_yaml;
use crate::ros::{ImageMessage, RosSensors};
use crate::ros_sensors::CameraTiming;
use bags::{BagError, BagWriter, Format, MessageType, Metadata, OfferedQos, WrittenTopic};
use calibration::sensor_yaml::text_of_imu;
use calibration::wheel_yaml::text_of_wheels;
use ros_messages::RosMessage;
use ros_messages::sensor_msgs::{CompressedImage, Image};
use std::collections::BTreeMap;
use std::path::Path;

/// The text of a recording whose sensors Driftless recorded. Its images are stamped on the clock of the IMU.
pub(crate) const METADATA: &str = "driftless";
/// Its entry with the IMU, for whose noise ROS has no message.
pub(crate) const IMU_ENTRY: &str = "imu0/sensor.yaml";
/// Its entry with the wheels whose readings are in it.
pub(crate) const WHEELS_ENTRY: &str = "wheels0/sensor.yaml";
/// Its entry with the antenna of GNSS whose positions are in it.
pub(crate) const GNSS_ENTRY: &str = "gnss0/sensor.yaml";
/// Its entry with the name of the IMU's frame, which a recording without readings has in no message.
pub(crate) const IMU_FRAME_ENTRY: &str = "imu0/frame_id";
/// Its entry with the rate of a camera, by the topic of its projection.
pub(crate) fn rate_entry(info_topic: &str) -> String {
    format!("{info_topic} rate_hz")
}
/// Its entry with the readout time of a camera with a rolling shutter.
pub(crate) fn readout_entry(info_topic: &str) -> String {
    format!("{info_topic} readout_s")
}
/// Its entry with how much later than the stamp of the frame a camera's image is.
pub(crate) fn delay_entry(info_topic: &str) -> String {
    format!("{info_topic} delay_s")
}

/// Depth of `/tf`: what `tf2_ros` publishes with.
const TF_DEPTH: u32 = 100;

impl ImageMessage {
    /// Its type.
    pub fn message_type(&self) -> MessageType {
        match self {
            Self::Raw(_) => message_type::<Image>(),
            Self::Compressed(_) => message_type::<CompressedImage>(),
        }
    }
}

/// The type of a message, with its definition: a text that is put together.
pub fn message_type<M: RosMessage>() -> MessageType {
    MessageType { name: M::TYPE_NAME, hash: M::TYPE_HASH, definition: ros_messages::definition::<M>() }
}

/// A bag whose topics are added when they are first written.
#[derive(Debug)]
pub struct RosBagWriter {
    writer: BagWriter,
    topics: BTreeMap<String, WrittenTopic>,
    /// Of topics that are not offered as ROS's default.
    offered: BTreeMap<String, OfferedQos>,
}

impl RosBagWriter {
    /// Creates the bag.
    ///
    /// # Errors
    /// As [`BagWriter::create`].
    pub fn create(path: &Path, format: Format) -> Result<Self, BagError> {
        let offered = [
            ("/tf_static", OfferedQos::Latched { depth: 1 }),
            ("/tf", OfferedQos::Reliable { depth: TF_DEPTH }),
        ];
        let offered = offered.map(|(topic, qos)| (topic.to_owned(), qos)).into();
        Ok(Self { writer: BagWriter::create(path, format)?, topics: BTreeMap::new(), offered })
    }

    /// States what the publisher of a topic offers, before its first message; later it changes nothing. Without it that is reliable, 10, of `/tf_static`
    /// transient local.
    pub fn offer(&mut self, topic: &str, qos: OfferedQos) {
        if !self.topics.contains_key(topic) {
            self.offered.insert(topic.to_owned(), qos);
        }
    }

    /// Writes what no message states of the sensors: the noise of the IMU, wheels and antenna of GNSS, where there are any, the rates, readout times and delays of the cameras, and that the
    /// images are stamped on the IMU's clock. A recording of readings and of images with `CameraInfo` and `/tf_static` needs no other
    /// calibration then.
    ///
    /// # Arguments
    /// * `calibration`: its cameras are those of `sensors`.
    ///
    /// # Errors
    /// [`BagError`]: the file cannot be written.
    pub fn write_sensors(
        &mut self,
        sensors: &RosSensors,
        calibration: &SensorCalibration,
    ) -> Result<(), BagError> {
        let SensorCalibration { imu, wheels, gnss, .. } = calibration;
        let mut entries = BTreeMap::from([(IMU_FRAME_ENTRY.to_owned(), sensors.imu_frame().to_owned())]);
        for (topic, CameraTiming { rate_hz, readout_s, delay_s }) in sensors.timing() {
            entries.insert(rate_entry(&topic), rate_hz.to_string());
            for (entry, seconds) in [(readout_entry(&topic), readout_s), (delay_entry(&topic), delay_s)] {
                if seconds != 0.0 {
                    entries.insert(entry, seconds.to_string());
                }
            }
        }
        if let Some(imu) = imu {
            entries.insert(IMU_ENTRY.to_owned(), text_of_imu(imu));
        }
        if let Some(wheels) = wheels {
            entries.insert(WHEELS_ENTRY.to_owned(), text_of_wheels(wheels));
        }
        if let Some(gnss) = gnss {
            let mut text = Vec::new();
            // Memory can be written to.
            let _ = gnss_yaml(&mut text, gnss);
            entries.insert(GNSS_ENTRY.to_owned(), String::from_utf8_lossy(&text).into_owned());
        }
        self.writer.metadata(&Metadata { name: METADATA.to_owned(), entries })
    }

    /// Appends a message as CDR.
    ///
    /// # Arguments
    /// * `of`: its type, asked for only where the topic is new.
    /// * `log_ns`: when it was recorded, nanoseconds.
    ///
    /// # Errors
    /// [`BagError`]: the file cannot be written.
    pub fn write(
        &mut self,
        name: &str,
        of: impl FnOnce() -> MessageType,
        log_ns: i64,
        bytes: &[u8],
    ) -> Result<(), BagError> {
        let topic = if let Some(topic) = self.topics.get(name) {
            *topic
        } else {
            let qos = self.offered.get(name).copied().unwrap_or_default();
            let topic = self.writer.topic(name, &of(), qos)?;
            self.topics.insert(name.to_owned(), topic);
            topic
        };
        self.writer.write(topic, log_ns, bytes)
    }

    /// As [`BagWriter::flush`].
    ///
    /// # Errors
    /// [`BagError`]: the file cannot be written.
    pub fn flush(&mut self) -> Result<(), BagError> {
        self.writer.flush()
    }

    /// As [`BagWriter::finish`].
    ///
    /// # Errors
    /// [`BagError`]: the file cannot be written.
    pub fn finish(self) -> Result<(), BagError> {
        self.writer.finish()
    }
}
