//! Hands estimates over to the task that publishes them.

use super::diagnostics::Diagnostics;
use super::messages::{Messages, map_tilt_deg, messages, odometry};
use super::odom_frame::OdomFrame;
use super::serving::serve;
use super::settings::RosSettings;
use super::static_transforms::static_transforms;
use estimator::Motion;
use geometry::PoseWithCovariance;
use robot::{Estimate, Output, PublishMotion, StatusReport};
use ros_messages::builtin_interfaces::Time;
use ros_messages::nav_msgs::Odometry;
use ros_messages::tf2_msgs::TFMessage;
use sensors::{CameraSensor, Frame};
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};
use tokio::runtime::Handle;
use tokio::sync::{mpsc, watch};
use tokio::task::JoinHandle;

/// Estimates that may be queued for the network before new ones are dropped.
const QUEUE: usize = 64;
/// How long the last messages may take when the run ends.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(2);

/// What is queued.
#[derive(Debug)]
pub(super) enum Outgoing {
    Estimate(Box<Messages>),
    Predicted(Box<Odometry>),
}

/// What is published when it changes, the newest only.
pub(super) struct Changes {
    pub(super) diagnostics: watch::Receiver<Option<Diagnostics>>,
    pub(super) static_transforms: watch::Receiver<TFMessage>,
}

/// The ROS 2 topics of a run. Nothing here waits for the network.
#[derive(Clone, Debug)]
pub struct RosOutput {
    settings: Arc<RosSettings>,
    odom: OdomFrame,
    queue: mpsc::Sender<Outgoing>,
    /// Added to all stamps, nanoseconds.
    clock_shift_ns: i64,
    /// That of the last estimate.
    map_tilt_deg: Option<f64>,
    /// When the last image was processed: one that waits for readings of the IMU is not.
    last_image: Option<Instant>,
    pub(super) diagnostics: watch::Sender<Option<Diagnostics>>,
    static_transforms: watch::Sender<TFMessage>,
    /// The cameras, where it was published where they are while the robot's frame was not known: it is again when that is.
    mounted: Option<Vec<CameraSensor>>,
}

/// The task that publishes. It ends when all its [`RosOutput`]s are dropped.
#[derive(Debug)]
pub struct RosOutputTask(JoinHandle<()>);

impl RosOutput {
    /// Begins to connect, in the background.
    ///
    /// # Errors
    /// An endpoint or a name that cannot be used.
    pub fn start(settings: RosSettings, runtime: &Handle) -> anyhow::Result<(Self, RosOutputTask)> {
        settings.session.to_config()?;
        let namespace = ros2::names::absolute_namespace(&settings.namespace)?;
        if let Some(initial_pose) = &settings.initial_pose {
            ros2::names::absolute_topic(&namespace, &initial_pose.topic)?;
        }
        let settings = Arc::new(settings);
        let (queue, waiting) = mpsc::channel(QUEUE);
        let (diagnostics, last) = watch::channel(None);
        let (static_transforms, mounting) = watch::channel(TFMessage::default());
        let changes = Changes { diagnostics: last, static_transforms: mounting };
        let task = RosOutputTask(runtime.spawn(serve(Arc::clone(&settings), waiting, changes)));
        let output = Self {
            settings,
            odom: OdomFrame::default(),
            queue,
            clock_shift_ns: 0,
            map_tilt_deg: None,
            last_image: None,
            diagnostics,
            static_transforms,
            mounted: None,
        };
        Ok((output, task))
    }

    /// Publishes where the sensors are mounted, for those who come later as well.
    pub fn publish_mounting(&mut self, cameras: &[CameraSensor]) {
        self.mounted = self.settings.body.mount.is_assumed().then(|| cameras.to_vec());
        let since_epoch = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        let stamp = Time::from_nanoseconds(since_epoch.as_nanos() as i64).unwrap_or_default();
        self.static_transforms.send_replace(static_transforms(&self.settings.body, cameras, stamp));
    }
}

impl Output for RosOutput {
    fn frame(&mut self, _: &Frame) {
        self.last_image = Some(Instant::now());
    }

    /// Publishes an estimate; dropped where the network is slow, newer ones follow.
    fn estimate(&mut self, estimate: &Estimate) {
        let is_assumed = self.settings.body.mount.is_assumed();
        if let Some(cameras) = self.mounted.take_if(|_| !is_assumed) {
            self.publish_mounting(&cameras);
        }
        self.map_tilt_deg = map_tilt_deg(estimate);
        let mut estimate = estimate.clone();
        estimate.motion.stamp_ns = estimate.motion.stamp_ns.saturating_add(self.clock_shift_ns);
        let Some(messages) = messages(&self.settings.body, &mut self.odom, &estimate) else {
            let stamp_ns = estimate.motion.stamp_ns;
            return tracing::warn!(stamp_ns, "this time cannot be written in ROS: not published");
        };
        // A full queue means a slow network: these messages are dropped.
        let _ = self.queue.try_send(Outgoing::Estimate(Box::new(messages)));
    }

    /// Publishes odometry that is predicted from the last estimate, where there is one; dropped where the network is slow.
    fn predicted(&self) -> Option<PublishMotion> {
        let (settings, queue) = (Arc::clone(&self.settings), self.queue.clone());
        let (odom_from_local, clock_shift_ns) = (self.odom.newest()?, self.clock_shift_ns);
        Some(Box::new(move |motion: &Motion| {
            let mut motion = *motion;
            motion.stamp_ns = motion.stamp_ns.saturating_add(clock_shift_ns);
            if let Some(odometry) = odometry(&settings.body, &odom_from_local, &motion) {
                let _ = queue.try_send(Outgoing::Predicted(Box::new(odometry)));
            }
        }))
    }

    /// The robot does not move in `odom`.
    fn correct(&mut self, before: &PoseWithCovariance, after: &PoseWithCovariance) {
        self.odom.correct(before, after);
    }

    fn set_clock_shift(&mut self, shift_ns: i64) {
        self.clock_shift_ns = shift_ns;
    }

    /// Publishes the status now if it changed, and every second.
    fn status(&mut self, report: &StatusReport) {
        let stamp_ns = report.stamp_or_now_ns().saturating_add(self.clock_shift_ns);
        let RosSettings { robot, map_expected, body, .. } = &*self.settings;
        let mut new = Diagnostics::of(robot, *map_expected, body, self.map_tilt_deg, stamp_ns, report);
        new.last_image = self.last_image.unwrap_or(new.last_image);
        self.diagnostics.send_if_modified(|last| {
            let changed = last.as_ref().is_none_or(|last| new.differs_from(last));
            *last = Some(new);
            changed
        });
    }

    fn restart(&mut self) {
        self.odom.restart();
    }
}

impl RosOutputTask {
    /// Waits until the last messages are sent. All outputs must be dropped before.
    pub async fn finish(self) {
        let Self(mut task) = self;
        if tokio::time::timeout(CLOSE_TIMEOUT, &mut task).await.is_err() {
            tracing::warn!("the last ROS messages were not published within {CLOSE_TIMEOUT:?}");
            task.abort();
        }
    }
}
