//! One vehicle at the broker.

use crate::bridge::{BridgeEvent, BridgeSettings};
use crate::fleet::{SharedVehicle, lock};
use crate::messages::{Connection, ConnectionState, Header, Visualization};
use crate::names::Topics;
use rumqttc::{AsyncClient, ConnectionError, Event, EventLoop, LastWill, MqttOptions, Outgoing, Packet, QoS};
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};
use std::time::{Duration, Instant, SystemTime};
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio::time::{MissedTickBehavior, interval, sleep, timeout};

/// Time between two signs of life, as the standard suggests: after one and a half of it the broker publishes the last will.
const KEEP_ALIVE: Duration = Duration::from_secs(15);
/// How long the broker may take to answer, seconds.
const CONNECTING_S: u64 = 5;
/// Messages that may wait for the network before new ones are dropped.
const QUEUE: usize = 4;
/// Time between two attempts: it doubles with each that fails.
const RETRY: [Duration; 2] = [Duration::from_millis(500), Duration::from_secs(10)];
/// How long saying goodbye may take.
const GOODBYE: Duration = Duration::from_secs(2);
/// Time between two looks at a robot that is not there, or at a goodbye that is under way.
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

    fn note_failed(&self, error: &ConnectionError) {
        if self.state.swap(Self::FAILED, Ordering::Relaxed) != Self::FAILED {
            self.tell(BridgeEvent::BrokerFailed { error: describe(error) });
        }
    }
}

/// What went wrong, for people.
fn describe(error: &ConnectionError) -> String {
    match error {
        ConnectionError::ConnectionRefused(code) => format!("it refuses the connection: {code:?}"),
        ConnectionError::NetworkTimeout | ConnectionError::FlushTimeout => "it does not answer".to_owned(),
        other => other.to_string(),
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

/// One vehicle at the broker.
pub(crate) struct VehicleConnection {
    settings: Arc<BridgeSettings>,
    watch: Arc<BrokerWatch>,
    serial: String,
    topics: Topics,
    vehicle: SharedVehicle,
    visualizations: u32,
    connections: u32,
}

impl VehicleConnection {
    pub(crate) fn new(
        settings: Arc<BridgeSettings>,
        watch: Arc<BrokerWatch>,
        serial: String,
        topics: Topics,
        vehicle: SharedVehicle,
    ) -> Self {
        Self { settings, watch, serial, topics, vehicle, visualizations: 0, connections: 0 }
    }

    /// Publishes the vehicle while its robot is there, until the bridge stops.
    pub(crate) async fn serve(mut self, mut stopped: watch::Receiver<bool>) {
        let mut retry = RETRY[0];
        while !*stopped.borrow() {
            if !self.is_online() {
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
    async fn connected(
        &mut self,
        stopped: &mut watch::Receiver<bool>,
    ) -> Result<End, (ConnectionError, bool)> {
        let (client, mut events) = AsyncClient::new(self.options(), QUEUE);
        events.network_options.set_connection_timeout(CONNECTING_S);
        tokio::select! {
            accepted = accepted(&mut events) => accepted.map_err(|error| (error, false))?,
            _ = stopped.changed() => return Ok(End::Stopped),
        }
        self.watch.note_reached();
        let mut announced = self.announce(&client, ConnectionState::Online);
        let (acknowledging, acknowledged) = watch::channel(0);
        // It must not be cancelled at any place, so that it has a task of its own.
        let mut network = tokio::spawn(run_network(events, acknowledging));
        let mut ticks = interval(Duration::from_secs_f64(1.0 / self.settings.rate_hz));
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let end = loop {
            tokio::select! {
                ended = &mut network => {
                    let error = match ended {
                        Ok(Err(error)) => error,
                        _ => ConnectionError::RequestsDone,
                    };
                    return Err((error, true));
                }
                _ = stopped.changed() => break End::Stopped,
                _ = ticks.tick() => self.publish_position(&client),
            }
            if !self.is_online() {
                // Where it was is not where it is.
                self.publish_position(&client);
                break End::Gone;
            }
        };
        let state =
            if end == End::Stopped { ConnectionState::Offline } else { ConnectionState::ConnectionBroken };
        announced += self.announce(&client, state);
        say_goodbye(&client, network, acknowledged, announced).await;
        Ok(end)
    }

    fn is_online(&self) -> bool {
        lock(&self.vehicle).is_online(Instant::now())
    }

    fn options(&mut self) -> MqttOptions {
        let BridgeSettings { broker, user, manufacturer, announces, .. } = &*self.settings;
        let id = format!("driftless-{manufacturer}-{}", self.serial);
        let mut options = MqttOptions::new(id, &broker.host, broker.port);
        options.set_keep_alive(KEEP_ALIVE).set_clean_session(true);
        if let Some(user) = user {
            options.set_credentials(&user.name, &user.password);
        }
        if *announces {
            let will = self.connection(ConnectionState::ConnectionBroken);
            options.set_last_will(LastWill::new(&self.topics.connection, will, QoS::AtLeastOnce, true));
        }
        options
    }

    fn header(&self, header_id: u32) -> Header {
        Header::new(header_id, SystemTime::now(), &self.settings.manufacturer, &self.serial)
    }

    /// A message `connection` as JSON.
    fn connection(&mut self, connection_state: ConnectionState) -> Vec<u8> {
        let header = self.header(self.connections);
        self.connections = self.connections.wrapping_add(1);
        written(&Connection { header, connection_state })
    }

    /// Publishes whether the vehicle is connected.
    ///
    /// # Returns
    /// How many messages the broker will acknowledge: 0 or 1.
    fn announce(&mut self, client: &AsyncClient, state: ConnectionState) -> usize {
        if !self.settings.announces {
            return 0;
        }
        let message = self.connection(state);
        usize::from(publish(client, &self.topics.connection, QoS::AtLeastOnce, true, message))
    }

    fn publish_position(&mut self, client: &AsyncClient) {
        let header = self.header(self.visualizations);
        self.visualizations = self.visualizations.wrapping_add(1);
        let now = Instant::now();
        let vehicle = lock(&self.vehicle);
        let message =
            Visualization { header, agv_position: vehicle.position(now), velocity: vehicle.velocity(now) };
        drop(vehicle);
        publish(client, &self.topics.visualization, QoS::AtMostOnce, false, written(&message));
    }
}

/// Waits until the broker accepts the connection.
async fn accepted(events: &mut EventLoop) -> Result<(), ConnectionError> {
    while !matches!(events.poll().await?, Event::Incoming(Packet::ConnAck(_))) {}
    Ok(())
}

/// Runs a connection until it ends.
///
/// # Arguments
/// * `acknowledging`: counts the messages that the broker acknowledged.
async fn run_network(
    mut events: EventLoop,
    acknowledging: watch::Sender<usize>,
) -> Result<(), ConnectionError> {
    loop {
        match events.poll().await? {
            Event::Incoming(Packet::PubAck(_)) => acknowledging.send_modify(|count| *count += 1),
            Event::Outgoing(Outgoing::Disconnect) => return Ok(()),
            _ => {}
        }
    }
}

/// Ends a connection after what waits was sent and acknowledged: an acknowledgement that is not read resets the connection, and the broker
/// publishes the last will.
async fn say_goodbye(
    client: &AsyncClient,
    mut network: JoinHandle<Result<(), ConnectionError>>,
    mut acknowledged: watch::Receiver<usize>,
    announced: usize,
) {
    let goodbye = async {
        // An error: the connection ended by itself.
        if acknowledged.wait_for(|count| *count >= announced).await.is_err() {
            return;
        }
        while client.try_disconnect().is_err() && !network.is_finished() {
            sleep(LOOK).await;
        }
        let _ = (&mut network).await;
    };
    if timeout(GOODBYE, goodbye).await.is_err() {
        tracing::debug!("the broker did not take the last messages within {GOODBYE:?}");
        network.abort();
    }
}

/// Sends a message; it is dropped where the network is slow or gone: newer ones follow.
///
/// # Returns
/// Whether it was taken.
fn publish(client: &AsyncClient, topic: &str, qos: QoS, retain: bool, message: Vec<u8>) -> bool {
    let sent = client.try_publish(topic, qos, retain, message);
    if let Err(error) = &sent {
        tracing::debug!(topic, "not published: {error}");
    }
    sent.is_ok()
}

/// A message as JSON. Its values are finite, so that it can always be written.
fn written(message: &impl serde::Serialize) -> Vec<u8> {
    serde_json::to_vec(message).unwrap_or_default()
}
