//! Topics of ROS 2, named as `driftless convert` names them in bags.

use super::SensorTopics;
use anyhow::{Context as _, Result};
use geometry::camera::Camera as Projection;
use ros_messages::builtin_interfaces::Time;
use ros_messages::rosgraph_msgs::Clock;
use ros_messages::sensor_msgs::{CameraInfo, CompressedImage, Image, Imu};
use ros_messages::std_msgs::Header;
use ros2::liveliness::Endpoint;
use ros2::{Node, NodeOptions, Publisher, Qos, explain_silence};
use sensors::ros::{
    ImageMessage, camera_info_message, has_ros_name, image_message, imu_message, pixels_message,
};
use sensors::{CameraSensor, Frame, ImageData, ImuSample};
use std::cell::Cell;
use tokio::runtime::Handle;

/// Topic of the IMU.
const IMU: &str = "/imu0";

/// Nanoseconds between two messages of `/clock`, at least.
const CLOCK_PERIOD_NS: i64 = 10_000_000;

/// `/clock`, `/imu0`, `/cam0/image_raw`, `/cam0/image_raw/compressed`, `/cam0/camera_info` and those of camera 1, for `onboard --source ros2` and other
/// nodes.
#[derive(Debug)]
pub struct RosTopics {
    runtime: Handle,
    clock: Publisher<Clock>,
    /// Time of the last message of `/clock`, nanoseconds.
    told_ns: Cell<i64>,
    imu: Publisher<Imu>,
    cameras: Vec<Camera>,
    node: Node,
}

/// The images of a camera in both forms, each published where somebody listens.
#[derive(Debug)]
struct Camera {
    raw: Publisher<Image>,
    compressed: Publisher<CompressedImage>,
    info: Publisher<CameraInfo>,
    projection: Projection,
}

impl RosTopics {
    /// Announces a node and its topics.
    ///
    /// # Arguments
    /// * `cameras`: those of the recording, whose projections are published with the images.
    ///
    /// # Errors
    /// A name that ROS does not allow, or a session that is closed.
    pub fn new(
        session: zenoh::Session,
        runtime: &Handle,
        node: NodeOptions,
        cameras: &[CameraSensor],
    ) -> Result<Self> {
        runtime.block_on(async {
            let node = Node::new(session, node).await?;
            let qos = Qos::every_message();
            let imu = node.publisher(IMU, qos).await?;
            let clock = node.publisher("/clock", Qos::sensor_data()).await?;
            let mut topics = Vec::new();
            for (camera, sensor) in cameras.iter().enumerate() {
                let raw = node.publisher(&format!("/cam{camera}/image_raw"), qos).await?;
                let compressed = node.publisher(&format!("/cam{camera}/image_raw/compressed"), qos).await?;
                let info = node.publisher(&format!("/cam{camera}/camera_info"), qos).await?;
                let distortion = &sensor.camera.distortion;
                if !has_ros_name(distortion) {
                    let name = distortion.name();
                    tracing::warn!("cam{camera}: ROS has no name for its distortion ({name}): other nodes cannot use its CameraInfo");
                }
                topics.push(Camera { raw, compressed, info, projection: sensor.camera.clone() });
            }
            let told_ns = Cell::new(i64::MIN);
            Ok(Self { runtime: runtime.clone(), clock, told_ns, imu, cameras: topics, node })
        })
    }
}

impl RosTopics {
    /// Publishes the time, unless that was just done.
    fn tell_time(&self, stamp_ns: i64, clock: Time) -> Result<()> {
        let since_ns = stamp_ns.saturating_sub(self.told_ns.get());
        if (0..CLOCK_PERIOD_NS).contains(&since_ns) {
            return Ok(());
        }
        self.told_ns.set(stamp_ns);
        Ok(self.runtime.block_on(self.clock.publish(&Clock { clock }))?)
    }
}

impl Camera {
    async fn is_heard(&self) -> Result<bool> {
        Ok(self.raw.is_matched().await? || self.compressed.is_matched().await?)
    }

    /// Publishes the projection, for those who wait for it before they listen to images too.
    async fn publish_info(&self, header: Header) -> Result<()> {
        Ok(self.info.publish(&camera_info_message(&self.projection, header)).await?)
    }

    /// Publishes an image in the forms that somebody listens to; a file as it is, to those who want it compressed.
    async fn publish(&self, image: &ImageData, header: Header) -> Result<()> {
        self.publish_info(header.clone()).await?;
        if self.raw.is_matched().await? {
            self.raw.publish(&pixels_message(image.read()?.as_ref(), header.clone())).await?;
        }
        if self.compressed.is_matched().await? {
            let stamp_ns = header.stamp.to_nanoseconds();
            let stored = image_message(image, stamp_ns, &header.frame_id)?;
            let message = if let Some(ImageMessage::Compressed(message)) = stored {
                message
            } else {
                let format = "png".to_owned();
                CompressedImage { header, format, data: image.read()?.to_png()? }
            };
            self.compressed.publish(&message).await?;
        }
        Ok(())
    }
}

impl SensorTopics for RosTopics {
    fn are_heard(&self) -> Result<bool> {
        let Some(first) = self.cameras.first() else { return Ok(false) };
        self.runtime.block_on(async { Ok(self.imu.is_matched().await? && first.is_heard().await?) })
    }

    /// The projections: a robot may need them for its calibration.
    fn prepare(&self) -> Result<()> {
        for (index, camera) in self.cameras.iter().enumerate() {
            let header = Header { frame_id: format!("cam{index}"), ..Header::default() };
            self.runtime.block_on(camera.publish_info(header))?;
        }
        Ok(())
    }

    fn why_unheard(&self) -> Result<String> {
        let Some(first) = self.cameras.first() else { return Ok("the recording has no camera".to_owned()) };
        self.runtime.block_on(async {
            let wanted = if !self.imu.is_matched().await? {
                self.node.counterpart::<Imu>(Endpoint::Subscriber, IMU)?
            } else if first.is_heard().await? {
                return Ok("robots listen".to_owned());
            } else {
                self.node.counterpart::<Image>(Endpoint::Subscriber, "/cam0/image_raw")?
            };
            Ok(explain_silence(&self.node.discover().await?, &wanted))
        })
    }

    fn reading(&self, reading: &ImuSample) -> Result<()> {
        let message = imu_message(reading, "imu").with_context(|| not_a_time(reading.stamp_ns))?;
        self.tell_time(reading.stamp_ns, message.header.stamp)?;
        Ok(self.runtime.block_on(self.imu.publish(&message))?)
    }

    fn frame(&self, frame: &Frame) -> Result<()> {
        for (index, image) in &frame.images {
            let Some(camera) = self.cameras.get(*index) else { continue };
            let header = Header::new(frame.stamp_ns, &format!("cam{index}"))
                .with_context(|| not_a_time(frame.stamp_ns))?;
            self.runtime.block_on(camera.publish(image, header))?;
        }
        Ok(())
    }
}

fn not_a_time(stamp_ns: i64) -> String {
    format!("{stamp_ns} ns is no time that ROS can write")
}
