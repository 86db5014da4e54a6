//! Projections of cameras from their `sensor_msgs/CameraInfo`.

use anyhow::{Context as _, Result, bail};
use geometry::Camera;
use robot::stop::StopSignal;
use ros_messages::sensor_msgs::CameraInfo;
use ros2::liveliness::Endpoint;
use ros2::{Node, NodeOptions, Qos, Subscriber, explain_silence};
use sensors::ros::{camera_info_topic, camera_of_info};
use std::path::Path;
use std::time::Duration;

/// How often it is looked whether the program is to stop.
const LOOK: Duration = Duration::from_millis(100);
/// Looks without a message before that is said, each time.
const LOOKS_A_WARNING: u32 = 20;
/// Only the newest message counts.
const QUEUE: usize = 1;

/// Waits until every camera has stated its projection, as a node of its own. Needs a tokio runtime.
///
/// # Arguments
/// * `images`: the topics of the images; `camera_info` is in the namespace of each.
///
/// # Errors
/// A projection that is not supported or missing, a topic whose name ROS does not allow, a closed session, and a stop.
pub async fn wait_for_cameras(
    session: zenoh::Session,
    node: NodeOptions,
    images: &[String],
    stop: &StopSignal,
) -> Result<Vec<Camera>> {
    let node = Node::new(session, node).await?;
    let mut cameras = Vec::new();
    for images in images {
        let topic = camera_info_topic(images);
        let messages = node.subscriber::<CameraInfo>(&topic, Qos::sensor_data(), QUEUE).await?;
        let message = next(&node, &messages, &topic, stop).await?;
        let found = camera_of_info(&message, images, Path::new(&topic))?;
        let camera = found.with_context(|| {
            format!("{topic} says that the camera is not calibrated (K is zero): calibrate it, or state intrinsics in --calibration")
        })?;
        tracing::info!(
            topic,
            width = camera.width,
            height = camera.height,
            "the camera stated its projection"
        );
        cameras.push(camera);
    }
    Ok(cameras)
}

async fn next(
    node: &Node,
    messages: &Subscriber<CameraInfo>,
    topic: &str,
    stop: &StopSignal,
) -> Result<CameraInfo> {
    let wanted = node.counterpart::<CameraInfo>(Endpoint::Publisher, topic)?;
    let mut looks = 0;
    loop {
        if stop.is_stopped() {
            bail!("interrupted before {topic} came")
        }
        looks += 1;
        if looks % LOOKS_A_WARNING == 0 {
            let why = explain_silence(&node.discover().await?, &wanted);
            tracing::warn!("no CameraInfo has come yet, and the calibration states no intrinsics: {why}");
        }
        let Ok(received) = tokio::time::timeout(LOOK, messages.receive()).await else { continue };
        match received?.message {
            Ok(message) => return Ok(message),
            Err(error) => tracing::warn!(%error, topic, "a message is not used"),
        }
    }
}
