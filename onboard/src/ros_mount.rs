//! Where the robot's frame is on its IMU, by `/tf_static` of ROS 2.

use anyhow::{Result, bail};
use geometry::Pose;
use robot::stop::StopSignal;
use ros_messages::sensor_msgs::Imu;
use ros_messages::tf2_msgs::TFMessage;
use ros2::{Node, NodeOptions, Qos};
use sensors::ros::StaticTransforms;
use std::time::{Duration, Instant};

/// How often it is looked whether the program is to stop.
const LOOK: Duration = Duration::from_millis(100);
/// So long it is waited for a reading, which names the frame of the IMU, and for the transforms; then the robot starts without them.
const WAIT: Duration = Duration::from_secs(5);
/// Publishers of `/tf_static`, each with one message.
const QUEUE: usize = 100;
const TF_STATIC: &str = "/tf_static";

/// Waits for the transforms from the IMU to a frame of the robot, as a node of its own. Needs a tokio runtime.
///
/// # Arguments
/// * `imu`: topic of the readings, whose header names the frame of the IMU.
/// * `base`: the robot's frame.
///
/// # Returns
/// `imu_from_base`; `None` where nobody states it within five seconds, which is logged.
///
/// # Errors
/// A topic whose name ROS does not allow, a closed session, and a stop.
pub async fn wait_for_base(
    session: zenoh::Session,
    node: NodeOptions,
    imu: &str,
    base: &str,
    stop: &StopSignal,
) -> Result<Option<Pose>> {
    let node = Node::new(session, node).await?;
    let readings = node.subscriber::<Imu>(imu, Qos::sensor_data(), 1).await?;
    let stated = node.subscriber::<TFMessage>(TF_STATIC, Qos::latched(), QUEUE).await?;
    let (mut frame, mut transforms) = (None, StaticTransforms::default());
    let begin = Instant::now();
    while begin.elapsed() < WAIT {
        if stop.is_stopped() {
            bail!("interrupted before {TF_STATIC} came")
        }
        tokio::select! {
            reading = readings.receive(), if frame.is_none() => {
                frame = reading?.message.ok().map(|reading| reading.header.frame_id);
            }
            message = stated.receive() => {
                if let Ok(message) = message?.message {
                    transforms.add(&message);
                }
            }
            () = tokio::time::sleep(LOOK) => {}
        }
        let Some(imu) = &frame else { continue };
        if let Some(imu_from_base) = transforms.imu_from_base(imu, base) {
            tracing::info!(imu, base, "{TF_STATIC} states where the robot's frame is on the IMU");
            return Ok(Some(imu_from_base));
        }
        if imu.trim_start_matches('/') == base {
            return Ok(None);
        }
    }
    tracing::warn!(
        "{TF_STATIC} does not say where {base} is on {:?}: {base} is taken to be the IMU; give --imu-in-base-link",
        frame.unwrap_or_default()
    );
    Ok(None)
}
