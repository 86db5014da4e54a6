//! Where the robot's frame is on its IMU, by `/tf_static` of ROS 2.

use crate::outputs::BaseMount;
use anyhow::{Result, bail};
use geometry::Pose;
use robot::stop::StopSignal;
use ros_messages::sensor_msgs::Imu;
use ros_messages::tf2_msgs::TFMessage;
use ros2::{Node, NodeOptions, Qos, RosError, Subscriber};
use sensors::ros::StaticTransforms;
use std::time::Duration;

/// So long it is waited for a reading, which names the frame of the IMU, and for the transforms; then the robot starts without them.
const WAIT: Duration = Duration::from_secs(5);
/// Publishers of `/tf_static`, each with one message.
const QUEUE: usize = 100;
const TF_STATIC: &str = "/tf_static";

/// Finds the robot's frame on the IMU.
///
/// Where nobody states it within five seconds it is taken for that of the IMU, which log and diagnostics report, and is looked for in the
/// background: it is used as soon as it is stated. Needs a tokio runtime.
///
/// # Arguments
/// * `imu`: topic of the readings, whose header names the frame of the IMU.
/// * `base`: the robot's frame.
///
/// # Errors
/// A topic whose name ROS does not allow, a closed session, and a stop.
pub async fn find_base(
    session: zenoh::Session,
    node: NodeOptions,
    imu: &str,
    base: &str,
    stop: &StopSignal,
) -> Result<BaseMount> {
    find_base_within(WAIT, BaseSearch::announce(session, node, imu, base).await?, stop).await
}

async fn find_base_within(wait: Duration, mut search: BaseSearch, stop: &StopSignal) -> Result<BaseMount> {
    match stop.until(tokio::time::timeout(wait, search.find())).await {
        Some(Ok(found)) => return Ok(BaseMount::known(found?)),
        Some(Err(_)) => {}
        None => bail!("interrupted before {TF_STATIC} came"),
    }
    tracing::warn!(
        "{TF_STATIC} does not say where {base} is on {:?}: {base} is taken to be the IMU until it does; give --imu-in-base-link",
        search.frame.as_deref().unwrap_or_default(),
        base = search.base
    );
    let mount = BaseMount::assumed();
    tokio::spawn({
        let mount = mount.clone();
        async move {
            // An error: the session is closed, since the run has ended.
            if let Ok(imu_from_base) = search.find().await {
                mount.state(imu_from_base);
                tracing::warn!("poses are of {} from now on; they were of the IMU", search.base);
            }
        }
    });
    Ok(mount)
}

/// What transforms say, and which frame is that of the IMU.
struct BaseSearch {
    _node: Node,
    readings: Subscriber<Imu>,
    stated: Subscriber<TFMessage>,
    base: String,
    /// Of the IMU, by the first reading.
    frame: Option<String>,
    transforms: StaticTransforms,
}

impl BaseSearch {
    /// A node of its own that subscribes.
    async fn announce(
        session: zenoh::Session,
        node: NodeOptions,
        imu: &str,
        base: &str,
    ) -> Result<Self, RosError> {
        let node = Node::new(session, node).await?;
        Ok(Self {
            readings: node.subscriber::<Imu>(imu, Qos::sensor_data(), 1).await?,
            stated: node.subscriber::<TFMessage>(TF_STATIC, Qos::latched(), QUEUE).await?,
            _node: node,
            base: base.to_owned(),
            frame: None,
            transforms: StaticTransforms::default(),
        })
    }

    /// Waits until `imu_from_base` is stated. It can be dropped and called again.
    async fn find(&mut self) -> Result<Pose, RosError> {
        loop {
            if let Some(imu) = &self.frame {
                if let Some(imu_from_base) = self.transforms.imu_from_base(imu, &self.base) {
                    tracing::info!(
                        imu,
                        self.base,
                        "{TF_STATIC} states where the robot's frame is on the IMU"
                    );
                    return Ok(imu_from_base);
                }
                if imu.trim_start_matches('/') == self.base {
                    return Ok(Pose::identity());
                }
            }
            tokio::select! {
                reading = self.readings.receive(), if self.frame.is_none() => {
                    self.frame = reading?.message.ok().map(|reading| reading.header.frame_id);
                }
                message = self.stated.receive() => {
                    if let Ok(message) = message?.message {
                        self.transforms.add(&message);
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use client::SessionOptions;
    use client::session::{close_session, open_session};
    use nalgebra::{UnitQuaternion, Vector3};
    use ros_messages::builtin_interfaces::Time;
    use sensors::ros::transform_message;

    /// Both must be published again and again: a subscriber that comes later hears nothing of the first.
    async fn publish(session: &zenoh::Session, transforms: Option<TFMessage>, stop: &StopSignal) {
        let node = Node::new(session.clone(), NodeOptions::default()).await.unwrap();
        let readings = node.publisher::<Imu>("/imu", Qos::sensor_data()).await.unwrap();
        let stated = node.publisher::<TFMessage>(TF_STATIC, Qos::latched()).await.unwrap();
        let mut reading = Imu::default();
        reading.header.frame_id = "imu_link".to_owned();
        while !stop.is_stopped() {
            readings.publish(&reading).await.unwrap();
            if let Some(transforms) = &transforms {
                stated.publish(transforms).await.unwrap();
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_frame_that_is_stated_late_is_used_from_then_on() {
        let session = open_session(&SessionOptions::default()).await.unwrap();
        let (stop, never) = (StopSignal::default(), StopSignal::default());
        let base_from_imu = Pose::new(UnitQuaternion::identity(), Vector3::new(0.1, 0.0, 0.4));
        let search = |wait_ms| {
            let session = session.clone();
            let never = &never;
            async move {
                let search =
                    BaseSearch::announce(session, NodeOptions::default(), "/imu", "base_link").await.unwrap();
                find_base_within(Duration::from_millis(wait_ms), search, never).await.unwrap()
            }
        };
        let without = tokio::spawn({
            let (session, stop) = (session.clone(), stop.clone());
            async move { publish(&session, None, &stop).await }
        });
        let mount = search(300).await;
        assert!(mount.is_assumed());
        assert_eq!(mount.imu_from_base(), Pose::identity());
        let transforms = TFMessage {
            transforms: vec![transform_message(Time::default(), "base_link", "imu_link", &base_from_imu)],
        };
        let with = tokio::spawn({
            let (session, stop) = (session.clone(), stop.clone());
            async move { publish(&session, Some(transforms), &stop).await }
        });
        let stated = async {
            while mount.is_assumed() {
                tokio::time::sleep(Duration::from_millis(10)).await;
            }
        };
        tokio::time::timeout(Duration::from_secs(20), stated).await.unwrap();
        assert!((mount.imu_from_base() * base_from_imu).local(&Pose::identity()).norm() < 1e-12);
        let in_time = search(20_000).await;
        assert!(!in_time.is_assumed());
        assert_eq!(in_time.imu_from_base(), mount.imu_from_base());
        stop.stop();
        let _ = tokio::join!(without, with);
        close_session(&session).await;
    }
}
