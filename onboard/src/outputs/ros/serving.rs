//! Connects to ROS 2 and publishes what is queued.

use super::diagnostics::Diagnostics;
use super::initial_pose::{InitialPoseSubscription, next_initial_pose};
use super::messages::Messages;
use super::output::{Changes, Outgoing};
use super::path::DrivenPath;
use super::settings::RosSettings;
use client::session::{close_session, open_session};
use ros_messages::diagnostic_msgs::DiagnosticArray;
use ros_messages::geometry_msgs::PoseWithCovarianceStamped;
use ros_messages::nav_msgs::{Odometry, Path};
use ros_messages::rosgraph_msgs::Clock;
use ros_messages::tf2_msgs::TFMessage;
use ros2::{History, Node, NodeOptions, Publisher, Qos, RosError};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::{mpsc, watch};

/// Period of the diagnostics, and of a path that changes.
const PERIOD: Duration = Duration::from_secs(1);
/// Depth of `/tf`: what `tf2_ros` publishes with.
const TF_DEPTH: usize = 100;

struct Topics {
    _node: Node,
    initial_pose: Option<InitialPoseSubscription>,
    odometry: Publisher<Odometry>,
    predicted: Publisher<Odometry>,
    pose: Publisher<PoseWithCovarianceStamped>,
    transforms: Publisher<TFMessage>,
    static_transforms: Option<Publisher<TFMessage>>,
    diagnostics: Publisher<DiagnosticArray>,
    path: Publisher<Path>,
    clock: Option<Publisher<Clock>>,
}

/// Publishes until nobody sends any more.
pub(super) async fn serve(
    settings: Arc<RosSettings>,
    mut queue: mpsc::Receiver<Outgoing>,
    mut changes: Changes,
) {
    let session = tokio::select! {
        opened = open_session(&settings.session) => opened,
        () = closed(changes.diagnostics.clone()) => return,
    };
    let session = match session {
        Ok(session) => session,
        Err(error) => return tracing::error!(%error, "there will be no ROS topics in this run"),
    };
    match Topics::announce(&session, &settings).await {
        Ok(topics) => {
            // What was queued before the connection is old.
            while queue.try_recv().is_ok() {}
            topics.publish_all(&mut queue, &mut changes).await;
        }
        Err(error) => tracing::error!(%error, "there will be no ROS topics in this run"),
    }
    close_session(&session).await;
}

/// Waits until all outputs are dropped.
async fn closed(mut diagnostics: watch::Receiver<Option<Diagnostics>>) {
    while diagnostics.changed().await.is_ok() {}
}

impl Topics {
    async fn announce(session: &zenoh::Session, settings: &RosSettings) -> Result<Self, RosError> {
        let options = NodeOptions {
            domain: settings.domain,
            namespace: settings.namespace.clone(),
            ..NodeOptions::default()
        };
        let node = Node::new(session.clone(), options).await?;
        let transforms = Qos { history: History::KeepLast(TF_DEPTH), ..Qos::reliable() };
        let has_static = !settings.body.sensor_frames.names.is_empty();
        let static_transforms =
            if has_static { Some(node.publisher("/tf_static", Qos::latched()).await?) } else { None };
        let clock =
            if settings.has_clock { Some(node.publisher("/clock", Qos::sensor_data()).await?) } else { None };
        Ok(Self {
            static_transforms,
            clock,
            initial_pose: InitialPoseSubscription::announce(&node, settings).await?,
            odometry: node.publisher("odometry", Qos::reliable()).await?,
            predicted: node.publisher("odometry_predicted", Qos::sensor_data()).await?,
            pose: node.publisher("pose", Qos::reliable()).await?,
            transforms: node.publisher("/tf", transforms).await?,
            diagnostics: node.publisher("/diagnostics", Qos::reliable()).await?,
            path: node.publisher("path", Qos::latched()).await?,
            _node: node,
        })
    }

    async fn publish_all(&self, queue: &mut mpsc::Receiver<Outgoing>, changes: &mut Changes) {
        let Changes { diagnostics, static_transforms } = changes;
        let mut period = tokio::time::interval(PERIOD);
        let mut path = DrivenPath::default();
        loop {
            let published = tokio::select! {
                messages = queue.recv() => match messages {
                    Some(Outgoing::Estimate(messages)) => {
                        if let Some(pose) = &messages.pose {
                            path.add(pose);
                        }
                        self.publish(&messages).await
                    }
                    Some(Outgoing::Predicted(odometry)) => self.predicted.publish(&odometry).await,
                    None => return self.publish_path(&mut path).await,
                },
                Ok(()) = diagnostics.changed() => self.publish_diagnostics(diagnostics).await,
                _ = period.tick() => {
                    self.publish_path(&mut path).await;
                    self.publish_diagnostics(diagnostics).await
                }
                Ok(()) = static_transforms.changed() => self.publish_static(static_transforms).await,
                received = next_initial_pose(self.initial_pose.as_ref()) => received,
            };
            if let Err(error) = published {
                tracing::debug!(%error, "a ROS message was not published");
            }
        }
    }

    async fn publish(&self, messages: &Messages) -> Result<(), RosError> {
        if let Some(clock) = &self.clock {
            clock.publish(&Clock { clock: messages.odometry.header.stamp }).await?;
        }
        self.transforms.publish(&messages.transforms).await?;
        self.odometry.publish(&messages.odometry).await?;
        if let Some(pose) = &messages.pose {
            self.pose.publish(pose).await?;
        }
        Ok(())
    }

    async fn publish_path(&self, path: &mut DrivenPath) {
        if let Some(message) = path.changed()
            && let Err(error) = self.path.publish(message).await
        {
            tracing::debug!(%error, "the path was not published");
        }
    }

    async fn publish_static(&self, newest: &mut watch::Receiver<TFMessage>) -> Result<(), RosError> {
        let message = newest.borrow_and_update().clone();
        match &self.static_transforms {
            Some(publisher) => publisher.publish(&message).await,
            None => Ok(()),
        }
    }

    async fn publish_diagnostics(
        &self,
        diagnostics: &mut watch::Receiver<Option<Diagnostics>>,
    ) -> Result<(), RosError> {
        let message = diagnostics.borrow_and_update().as_ref().map(|last| last.at(Instant::now()));
        match message {
            Some(message) => self.diagnostics.publish(&message).await,
            None => Ok(()),
        }
    }
}
