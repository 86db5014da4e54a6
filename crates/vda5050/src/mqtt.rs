//! One vehicle at the broker.

use crate::bridge::{BridgeEvent, BridgeSettings};
use crate::fleet::{SharedVehicle, lock};
use crate::messages::{Connection, ConnectionState, Header, Visualization};
use crate::names::Topics;
use crate::session::{Endpoint, Session, SessionError};
use rumqttc::{Connect, LastWill, Publish, QoS};
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};
use std::time::{Duration, Instant, SystemTime};
use tokio::sync::mpsc::{Sender, channel};
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio::time::{MissedTickBehavior, interval, sleep, timeout};

/// Messages that may wait for the network before new ones are dropped.
const QUEUE: usize = 4;
/// Time between two attempts: it doubles with each that fails.
const RETRY: [Duration; 2] = [Duration::from_millis(500), Duration::from_secs(10)];
/// How long saying goodbye may take.
const GOODBYE: Duration = Duration::from_secs(2);
/// How long the last status of a robot may come after its token went.
const LAST_STATUS: Duration = Duration::from_millis(500);
/// Time between two looks at whether a robot is there.
const LOOK: Duration = Duration::from_millis(100);

/// Whether the broker answers, told once for all vehicles.
pub(crate) struct BrokerWatch {
    tell: Box<dyn Fn(BridgeEvent) + Send + Sync>,
    state: AtomicU8,
}

impl BrokerWatch {
    const REACHED: u8 = 1;
    const FAILED: u8 = 2;

    pub(crate) fn new(tell: impl Fn(BridgeEvent) + Send + Sync + 'static) -> Self {
        Self { tell: Box::new(tell), state: AtomicU8::new(0) }
    }

    pub(crate) fn tell(&self, event: BridgeEvent) {
        (self.tell)(event);
    }

    fn note_reached(&self) {
        if self.state.swap(Self::REACHED, Ordering::Relaxed) != Self::REACHED {
            self.tell(BridgeEvent::BrokerReached);
        }
    }

    fn note_failed(&self, error: &SessionError) {
        if self.state.swap(Self::FAILED, Ordering::Relaxed) != Self::FAILED {
            self.tell(BridgeEvent::BrokerFailed { error: error.to_string() });
        }
    }
}

/// How a connection ended that nobody broke.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum End {
    /// The robot is gone.
    Gone,
    /// The bridge stops.
    Stopped,
}

/// What a vehicle is called.
pub(crate) struct VehicleNames {
    pub(crate) robot: String,
    pub(crate) serial: String,
    pub(crate) topics: Topics,
}

/// One vehicle at the broker.
pub(crate) struct VehicleConnection {
    settings: Arc<BridgeSettings>,
    endpoint: Endpoint,
    watch: Arc<BrokerWatch>,
    names: VehicleNames,
    vehicle: SharedVehicle,
    visualizations: u32,
    connections: u32,
    /// Whether it was told that there is such a vehicle.
    is_told: bool,
    /// Whether it was told that its map is not level.
    is_tilt_told: bool,
    /// Whether the broker may have it retained that the vehicle is online, and a goodbye is due.
    is_announced: bool,
}

impl VehicleConnection {
    pub(crate) fn new(
        settings: Arc<BridgeSettings>,
        endpoint: Endpoint,
        watch: Arc<BrokerWatch>,
        names: VehicleNames,
        vehicle: SharedVehicle,
    ) -> Self {
        // A bridge before this one may have announced it.
        let is_announced = settings.announces && !lock(&vehicle).is_online(Instant::now());
        let (visualizations, connections) = (0, 0);
        Self {
            settings,
            endpoint,
            watch,
            names,
            vehicle,
            visualizations,
            connections,
            is_told: false,
            is_tilt_told: false,
            is_announced,
        }
    }

    /// Publishes the vehicle while its robot is there, until the bridge stops. Where the robot is gone, it connects only to say so, once.
    pub(crate) async fn serve(mut self, mut stopped: watch::Receiver<bool>) {
        let mut retry = RETRY[0];
        while !*stopped.borrow() {
            if !self.is_online() && !self.is_announced {
                sleep(LOOK).await;
                continue;
            }
            match self.connected(&mut stopped).await {
                Ok(End::Stopped) => return,
                Ok(End::Gone) => retry = RETRY[0],
                Err((error, was_connected)) => {
                    self.watch.note_failed(&error);
                    if was_connected {
                        retry = RETRY[0];
                    }
                    tokio::select! {
                        () = sleep(retry) => {}
                        _ = stopped.changed() => {}
                    }
                    retry = (2 * retry).min(RETRY[1]);
                }
            }
        }
    }

    /// One connection, from its begin to its end.
    ///
    /// # Errors
    /// What broke it, and whether the broker had accepted it.
    async fn connected(&mut self, stopped: &mut watch::Receiver<bool>) -> Result<End, (SessionError, bool)> {
        let connect = self.connect();
        let session = tokio::select! {
            opened = Session::open(&self.endpoint, connect) => opened.map_err(|error| (error, false))?,
            _ = stopped.changed() => return Ok(End::Stopped),
        };
        self.watch.note_reached();
        let (messages, waiting) = channel(QUEUE);
        // It must not be cancelled at any place, so that it has a task of its own.
        let mut network = tokio::spawn(session.run(waiting));
        let end = if self.is_online() {
            self.publish_while_online(&messages, &mut network, stopped).await?
        } else {
            End::Gone
        };
        let is_in_order = end == End::Stopped || self.is_shut_down().await;
        let state = if is_in_order { ConnectionState::Offline } else { ConnectionState::ConnectionBroken };
        let last = self.announcement(state);
        match say_goodbye(messages, last, network).await {
            Ok(()) => self.is_announced = false,
            Err(error) if end == End::Gone => return Err((error, true)),
            Err(error) => tracing::debug!("the last messages may be lost: {error}"),
        }
        Ok(end)
    }

    /// Announces the vehicle and publishes where it is, until its robot is gone or the bridge stops.
    ///
    /// # Errors
    /// What broke the connection.
    async fn publish_while_online(
        &mut self,
        messages: &Sender<Publish>,
        network: &mut JoinHandle<Result<(), SessionError>>,
        stopped: &mut watch::Receiver<bool>,
    ) -> Result<End, (SessionError, bool)> {
        if let Some(message) = self.announcement(ConnectionState::Online) {
            publish(messages, message);
            self.is_announced = true;
        }
        let mut ticks = interval(Duration::from_secs_f64(1.0 / self.settings.rate_hz));
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut looks = interval(LOOK);
        looks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                ended = &mut *network => {
                    let error = match ended {
                        Ok(Err(error)) => error,
                        _ => SessionError::Ended,
                    };
                    return Err((error, true));
                }
                _ = stopped.changed() => return Ok(End::Stopped),
                _ = ticks.tick() => self.publish_position(messages),
                _ = looks.tick() => {}
            }
            if !self.is_online() {
                // Where it was is not where it is.
                self.publish_position(messages);
                return Ok(End::Gone);
            }
        }
    }

    /// Whether the robot is there; the first time it is told.
    fn is_online(&mut self) -> bool {
        let is_online = lock(&self.vehicle).is_online(Instant::now());
        if is_online && !self.is_told {
            self.is_told = true;
            let (robot, topic) = (self.names.robot.clone(), self.names.topics.visualization.clone());
            self.watch.tell(BridgeEvent::Vehicle { robot, topic });
        }
        is_online
    }

    /// Whether the robot shut down in order; its status that says so may be on its way. Of one that was not heard of nothing else is known.
    async fn is_shut_down(&self) -> bool {
        if !lock(&self.vehicle).is_heard() {
            return true;
        }
        let is_off = async {
            while !lock(&self.vehicle).is_off() {
                sleep(LOOK / 4).await;
            }
        };
        lock(&self.vehicle).has_ended() && timeout(LAST_STATUS, is_off).await.is_ok()
    }

    fn connect(&mut self) -> Connect {
        let BridgeSettings { user, manufacturer, announces, .. } = &*self.settings;
        let mut connect = Connect::new(format!("driftless-{manufacturer}-{}", self.names.serial));
        if let Some(user) = user {
            connect.set_login(&user.name, &user.password);
        }
        if *announces {
            let will = self.connection(ConnectionState::ConnectionBroken);
            let will = LastWill::new(&self.names.topics.connection, will, QoS::AtLeastOnce, true);
            connect.last_will = Some(will);
        }
        connect
    }

    fn header(&self, header_id: u32) -> Header {
        Header::new(header_id, SystemTime::now(), &self.settings.manufacturer, &self.names.serial)
    }

    /// A message `connection` as JSON.
    fn connection(&mut self, connection_state: ConnectionState) -> Vec<u8> {
        let header = self.header(self.connections);
        self.connections = self.connections.wrapping_add(1);
        written(&Connection { header, connection_state })
    }

    /// Whether the vehicle is connected, as a message; `None` where its own controller tells.
    fn announcement(&mut self, state: ConnectionState) -> Option<Publish> {
        let message = self.settings.announces.then(|| self.connection(state))?;
        Some(Publish {
            retain: true,
            ..Publish::new(&self.names.topics.connection, QoS::AtLeastOnce, message)
        })
    }

    fn publish_position(&mut self, messages: &Sender<Publish>) {
        let header = self.header(self.visualizations);
        self.visualizations = self.visualizations.wrapping_add(1);
        let now = Instant::now();
        let vehicle = lock(&self.vehicle);
        let message =
            Visualization { header, agv_position: vehicle.position(now), velocity: vehicle.velocity(now) };
        let tilt = vehicle.map_tilt().map(|(map, tilt_deg)| (map.to_owned(), tilt_deg));
        drop(vehicle);
        if let Some((map, tilt_deg)) = tilt
            && !std::mem::replace(&mut self.is_tilt_told, true)
        {
            self.watch.tell(BridgeEvent::MapNotLevel { robot: self.names.robot.clone(), map, tilt_deg });
        }
        publish(messages, Publish::new(&self.names.topics.visualization, QoS::AtMostOnce, written(&message)));
    }
}

/// Ends a connection after what waits, and a last message, was sent and acknowledged.
///
/// # Errors
/// What broke it before, or [`SessionError::Silent`]: the last messages may be lost.
async fn say_goodbye(
    messages: Sender<Publish>,
    last: Option<Publish>,
    mut network: JoinHandle<Result<(), SessionError>>,
) -> Result<(), SessionError> {
    let goodbye = async {
        if let Some(last) = last {
            // An error: the connection ended by itself.
            let _ = messages.send(last).await;
        }
        drop(messages);
        (&mut network).await
    };
    if let Ok(ended) = timeout(GOODBYE, goodbye).await {
        return ended.unwrap_or(Err(SessionError::Ended));
    }
    network.abort();
    Err(SessionError::Silent)
}

/// Sends a message; it is dropped where the network is slow or gone: newer ones follow.
fn publish(messages: &Sender<Publish>, message: Publish) {
    if let Err(error) = messages.try_send(message) {
        tracing::debug!("not published: {error}");
    }
}

/// A message as JSON. Its values are finite, so that it can always be written.
fn written(message: &impl serde::Serialize) -> Vec<u8> {
    serde_json::to_vec(message).unwrap_or_default()
}
