//! Publishes pose, odometry and status of the robot in the background.

use super::name_watch::NameWatch;
use super::publisher_error::PublisherError;
use estimator::{Localization, Motion};
use protocol::{Format, Message, RobotOdometry, RobotPose, RobotState, RobotStatus, keys};
use robot::{Estimate, StatusReport};
use std::sync::Arc;
use std::time::Duration;
use tokio::runtime::Handle;
use tokio::sync::mpsc::{Sender, channel};
use tokio::task::JoinHandle;
use zenoh::liveliness::LivelinessToken;
use zenoh::qos::CongestionControl;

/// Messages that may be queued for the network before new ones are dropped.
const QUEUE: usize = 64;

/// Key, encoding and payload.
type Outgoing = (Arc<str>, &'static str, Vec<u8>);

/// Publishes under `robot/{robot}/...`, declares the robot's liveliness token, and watches for others of its name.
#[derive(Debug)]
pub struct Publisher {
    session: zenoh::Session,
    map: Option<String>,
    /// Added to all stamps, nanoseconds.
    clock_shift_ns: i64,
    format: Format,
    queue: Sender<Outgoing>,
    pose_key: Arc<str>,
    odometry_key: Arc<str>,
    predicted_key: Arc<str>,
    status_key: Arc<str>,
    runtime: Handle,
    sending: JoinHandle<()>,
    alive: LivelinessToken,
    name_watch: NameWatch,
}

/// How long the last messages may take when the run ends.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(2);

impl Publisher {
    /// Declares the robot's liveliness token and starts the publishing task.
    ///
    /// # Arguments
    /// * `map`: its name; `None` for a robot without a map, which publishes no pose in one.
    /// * `format`: of all messages; each sample states it as its encoding.
    ///
    /// # Errors
    /// [`PublisherError`]: the robot's name is not valid in a key expression, or the session is closed.
    pub fn new(
        session: zenoh::Session,
        runtime: &Handle,
        robot: &str,
        map: Option<&str>,
        format: Format,
    ) -> Result<Self, PublisherError> {
        let (queue, mut messages) = channel::<Outgoing>(QUEUE);
        let alive_key = keys::robot(robot)?;
        let alive = runtime
            .block_on(async { session.liveliness().declare_token(alive_key).await })
            .map_err(PublisherError::Liveliness)?;
        let name_watch = runtime.block_on(NameWatch::start(&session, robot))?;
        let sender = session.clone();
        let sending = runtime.spawn(async move {
            while let Some((key, encoding, payload)) = messages.recv().await {
                if let Err(error) = sender.put(&*key, payload).encoding(encoding).await {
                    tracing::debug!(%error, "a message was not published");
                }
            }
        });
        Ok(Self {
            session,
            map: map.map(str::to_owned),
            clock_shift_ns: 0,
            format,
            queue,
            pose_key: keys::robot_pose(robot)?.into(),
            odometry_key: keys::robot_odometry(robot)?.into(),
            predicted_key: keys::robot_odometry_predicted(robot)?.into(),
            status_key: keys::robot_status(robot)?.into(),
            runtime: runtime.clone(),
            sending,
            alive,
            name_watch,
        })
    }

    /// Number of other robots that were seen on the network with the name of this one.
    pub fn namesakes(&self) -> usize {
        self.name_watch.namesakes()
    }

    /// Sets what is added to all stamps, nanoseconds: jumps of the sensors' clock, which the estimator does not see.
    pub fn set_clock_shift(&mut self, shift_ns: i64) {
        self.clock_shift_ns = shift_ns;
    }

    /// Publishes where the robot is. Messages that do not fit into the queue are dropped: newer ones follow.
    pub fn publish(&self, estimate: &Estimate) {
        self.send(&self.odometry_key, &odometry(&estimate.motion, self.clock_shift_ns));
        let map = estimate.map_version.zip(estimate.map_identity);
        let named = self.map.as_ref().zip(estimate.trusted().zip(map));
        if let Some((map, (global, (map_version, map_identity)))) = named {
            let pose = RobotPose {
                stamp_ns: self.sensor_stamp_ns(estimate.motion.stamp_ns),
                map: map.clone(),
                map_version,
                map_identity,
                global_from_imu: global.global_from_imu,
                global_from_local: global.global_from_local,
            };
            self.send(&self.pose_key, &pose);
        }
    }

    /// Publishes the status, also while there is no pose.
    pub fn publish_status(&self, report: &StatusReport) {
        self.send(&self.status_key, &self.status(report));
    }

    fn status(&self, report: &StatusReport) -> RobotStatus {
        let StatusReport { status, queries, .. } = report;
        RobotStatus {
            stamp_ns: self.sensor_stamp_ns(report.stamp_or_now_ns()),
            state: robot_state(status.localization),
            reason: status.reason.clone(),
            map: self.map.clone(),
            last_map_update_ns: status.last_map_update_ns.map(|stamp_ns| self.sensor_stamp_ns(stamp_ns)),
            keyframes_held: status.held_keyframes as u32,
            queries_sent: queries.sent,
            queries_answered: queries.answered,
        }
    }

    /// Sends the queued messages, then undeclares the liveliness token.
    ///
    /// # Arguments
    /// * `last`: how a robot is that shuts down in order, which is published as [`RobotState::Off`] before the token goes; `None` for one
    ///   that ends by a fault, whose token goes without a word.
    pub fn close(self, last: Option<&StatusReport>) {
        let off = last.and_then(|report| {
            let reason = "it was shut down".to_owned();
            encoded(self.format, &RobotStatus { state: RobotState::Off, reason, ..self.status(report) })
        });
        let Self { session, format, queue, status_key, runtime, sending, alive, name_watch, .. } = self;
        drop(queue);
        runtime.block_on(async {
            let ending = async {
                // A task that panicked has sent what it could.
                let _ = sending.await;
                let Some(payload) = off else { return Ok(()) };
                // Nothing follows it that would replace it: it is not dropped where the network is slow.
                let put = session.put(&*status_key, payload).encoding(format.encoding());
                put.congestion_control(CongestionControl::Block).await
            };
            match tokio::time::timeout(CLOSE_TIMEOUT, ending).await {
                Ok(Ok(())) => {}
                Ok(Err(error)) => tracing::debug!(%error, "the last status was not published"),
                Err(_) => tracing::warn!("the last messages were not published within {CLOSE_TIMEOUT:?}: the network is slow or gone"),
            }
            name_watch.stop().await;
            if let Err(error) = alive.undeclare().await {
                tracing::debug!(%error, "the liveliness token was gone with its session");
            }
        });
    }

    /// A time of the estimator on the sensors' clock.
    fn sensor_stamp_ns(&self, stamp_ns: i64) -> i64 {
        stamp_ns.saturating_add(self.clock_shift_ns)
    }

    fn send<M: Message>(&self, key: &Arc<str>, message: &M) {
        send(&self.queue, self.format, key, message);
    }

    /// Publishes odometry that is predicted from the newest state; dropped where the network is slow.
    pub(crate) fn predicted(&self) -> impl Fn(&Motion) + Send + 'static {
        let (queue, format, key) = (self.queue.clone(), self.format, Arc::clone(&self.predicted_key));
        let clock_shift_ns = self.clock_shift_ns;
        move |motion| send(&queue, format, &key, &odometry(motion, clock_shift_ns))
    }
}

fn odometry(motion: &Motion, clock_shift_ns: i64) -> RobotOdometry {
    RobotOdometry {
        stamp_ns: motion.stamp_ns.saturating_add(clock_shift_ns),
        local_from_imu: motion.local_from_imu(),
        velocity_in_local: motion.state.velocity.into(),
        angular_velocity_in_imu: motion.angular_velocity.into(),
    }
}

fn send<M: Message>(queue: &Sender<Outgoing>, format: Format, key: &Arc<str>, message: &M) {
    if let Some(payload) = encoded(format, message) {
        // A full queue means a slow network: this message is dropped.
        let _ = queue.try_send((Arc::clone(key), format.encoding(), payload));
    }
}

fn encoded<M: Message>(format: Format, message: &M) -> Option<Vec<u8>> {
    let payload = protocol::encode(format, message);
    payload.inspect_err(|error| tracing::warn!(%error, "a message is invalid and was not published")).ok()
}

fn robot_state(localization: Localization) -> RobotState {
    match localization {
        Localization::OdometryOnly => RobotState::OdometryOnly,
        Localization::Localized => RobotState::Localized,
        Localization::Lost => RobotState::Lost,
        Localization::Starting => RobotState::Starting,
    }
}
