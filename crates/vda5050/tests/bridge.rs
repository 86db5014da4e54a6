//! The bridge between a Zenoh session and a broker.

use crate::broker::{Broker, Message, Received};
use crate::robot::{odometry, pose, status};
use crate::schema::faults;
use client::SessionOptions;
use protocol::{Format, RobotState, keys};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::sync::oneshot;
use tokio::task::JoinHandle;
use tokio::time::{sleep, timeout};
use vda5050::{BridgeError, BridgeEvent, BridgeSettings, BrokerUser};
use zenoh::Session;

/// A bridge that runs.
pub struct Running {
    session: Session,
    stop: oneshot::Sender<()>,
    task: JoinHandle<Result<(), BridgeError>>,
    events: Arc<Mutex<Vec<BridgeEvent>>>,
}

async fn session() -> Session {
    client::open_session(&SessionOptions::default()).await.unwrap()
}

pub async fn start(settings: BridgeSettings) -> Running {
    let (session, events) = (session().await, Arc::new(Mutex::new(Vec::new())));
    let (stop, stopped) = oneshot::channel();
    let (of_bridge, told) = (session.clone(), Arc::clone(&events));
    let task = tokio::spawn(async move {
        let stopped = async {
            let _ = stopped.await;
        };
        vda5050::run(&of_bridge, settings, stopped, move |event| told.lock().unwrap().push(event)).await
    });
    Running { session, stop, task, events }
}

impl Running {
    async fn publish<M: protocol::Message>(&self, key: String, message: &M) {
        let payload = protocol::encode(Format::Json, message).unwrap();
        self.session.put(key, payload).encoding(Format::Json.encoding()).await.unwrap();
    }

    /// The status of a robot, ten times a second, until it is aborted.
    pub fn presence(&self, robot: &'static str) -> JoinHandle<()> {
        let session = self.session.clone();
        tokio::spawn(async move {
            let payload = protocol::encode(Format::Json, &status(RobotState::Localized)).unwrap();
            loop {
                let put = session.put(keys::robot_status(robot).unwrap(), payload.clone());
                if put.encoding(Format::Json.encoding()).await.is_err() {
                    return;
                }
                sleep(Duration::from_millis(100)).await;
            }
        })
    }

    async fn status(&self, robot: &str, state: RobotState) {
        self.publish(keys::robot_status(robot).unwrap(), &status(state)).await;
    }

    /// Pose, odometry and status of a robot, ten times a second, until it is aborted.
    pub fn drive(&self, robot: &'static str) -> JoinHandle<()> {
        let session = self.session.clone();
        tokio::spawn(async move {
            let put = async |key: String, payload: Vec<u8>| {
                session.put(key, payload).encoding(Format::Json.encoding()).await.unwrap();
            };
            for step in 1_i32.. {
                let stamp_ns = i64::from(step) * 100_000_000;
                let pose = pose(stamp_ns, f64::from(step) * 0.1, 0.25);
                put(keys::robot_pose(robot).unwrap(), protocol::encode(Format::Json, &pose).unwrap()).await;
                let odometry = protocol::encode(Format::Json, &odometry(stamp_ns, 0.25)).unwrap();
                put(keys::robot_odometry(robot).unwrap(), odometry).await;
                let status = protocol::encode(Format::Json, &status(RobotState::Localized)).unwrap();
                put(keys::robot_status(robot).unwrap(), status).await;
                sleep(Duration::from_millis(100)).await;
            }
        })
    }

    fn events(&self) -> Vec<BridgeEvent> {
        self.events.lock().unwrap().clone()
    }

    pub async fn wait_for(&self, is_wanted: impl Fn(&BridgeEvent) -> bool) {
        let told = async {
            while !self.events().iter().any(&is_wanted) {
                sleep(Duration::from_millis(20)).await;
            }
        };
        assert!(timeout(Duration::from_secs(20), told).await.is_ok(), "{:?}", self.events());
    }

    /// Stops the bridge, which must not take long.
    pub async fn stop(self) {
        self.stop.send(()).unwrap();
        timeout(Duration::from_secs(5), self.task).await.unwrap().unwrap().unwrap();
        client::close_session(&self.session).await;
    }
}

fn settings(url: &str) -> BridgeSettings {
    BridgeSettings { rate_hz: 20.0, ..BridgeSettings::new(url.parse().unwrap(), "acme") }
}

fn is_initialized(payload: &serde_json::Value) -> bool {
    payload["agvPosition"]["positionInitialized"] == true
}

fn is_connection(state: &str) -> impl Fn(&serde_json::Value) -> bool {
    move |payload| payload["connectionState"] == state
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_is_a_vehicle_from_its_first_message_to_the_end_of_the_bridge() {
    let mut broker = Broker::start(0, 0).await;
    let user = BrokerUser { name: "fleet".to_owned(), password: "secret".to_owned() };
    let running = start(BridgeSettings { user: Some(user), ..settings(&broker.url()) }).await;
    let driving = running.drive("cart7");

    let Received::Connect { id, will, user } = broker.next().await else { panic!("no connection") };
    assert_eq!(id, "driftless-acme-cart7");
    assert_eq!(user, Some(("fleet".to_owned(), "secret".to_owned())));
    let will = will.unwrap();
    assert_eq!((will.topic.as_str(), will.qos, will.is_retained), ("uagv/v2/acme/cart7/connection", 1, true));
    assert_eq!(will.payload["connectionState"], "CONNECTIONBROKEN");
    assert_eq!(faults("connection", &will.payload), [""; 0]);

    let online = broker.message("/connection", |_| true).await;
    assert_eq!((online.qos, online.is_retained), (1, true));
    assert_eq!(online.payload["connectionState"], "ONLINE");
    assert!(online.payload["headerId"].as_u64() > will.payload["headerId"].as_u64());

    let mut last = broker.message("/visualization", is_initialized).await;
    assert_eq!(
        (last.topic.as_str(), last.qos, last.is_retained),
        ("uagv/v2/acme/cart7/visualization", 0, false)
    );
    for _ in 0..20 {
        let next = broker.message("/visualization", |_| true).await;
        assert_eq!(faults("visualization", &next.payload), [""; 0]);
        assert_eq!(next.payload["headerId"].as_u64(), last.payload["headerId"].as_u64().map(|id| id + 1));
        assert!(next.payload["timestamp"].as_str() >= last.payload["timestamp"].as_str());
        assert!(next.payload["agvPosition"]["x"].as_f64() >= last.payload["agvPosition"]["x"].as_f64());
        last = next;
    }
    driving.abort();
    running.status("cart7", RobotState::Lost).await;
    // On a busy machine the last pose may be too old before the status comes: then there is a velocity still.
    let is_lost = |payload: &serde_json::Value| !is_initialized(payload) && payload.get("velocity").is_none();
    let lost = broker.message("/visualization", is_lost).await;
    assert_eq!(faults("visualization", &lost.payload), [""; 0]);
    assert_eq!(lost.payload["agvPosition"]["localizationScore"], 0.0);

    running.stop().await;
    let offline = broker.message("/connection", |_| true).await;
    assert_eq!(offline.payload["connectionState"], "OFFLINE");
    assert!(offline.is_retained);
    assert_eq!(broker.next().await, Received::Disconnect);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_that_goes_is_told_of_and_comes_again() {
    let mut broker = Broker::start(0, 0).await;
    let running = start(settings(&broker.url())).await;
    let token = running.session.liveliness().declare_token("robot/cart7").await.unwrap();
    let driving = running.drive("cart7");
    broker.message("/visualization", is_initialized).await;
    driving.abort();
    token.undeclare().await.unwrap();
    let last = broker.message("/visualization", |payload| !is_initialized(payload)).await;
    broker.message("/connection", is_connection("CONNECTIONBROKEN")).await;
    assert_eq!(broker.next().await, Received::Disconnect);

    let token = running.session.liveliness().declare_token("robot/cart7").await.unwrap();
    broker.message("/connection", is_connection("ONLINE")).await;
    let first = broker.message("/visualization", |_| true).await;
    assert!(first.payload["headerId"].as_u64() > last.payload["headerId"].as_u64());
    assert!(!is_initialized(&first.payload), "its pose is from before");
    let driving = running.drive("cart7");
    broker.message("/visualization", is_initialized).await;
    driving.abort();

    // Shut down in order; its last status comes after its token went.
    token.undeclare().await.unwrap();
    running.status("cart7", RobotState::Off).await;
    let offline = broker.message("/connection", |_| true).await;
    assert_eq!(offline.payload["connectionState"], "OFFLINE");
    assert!(offline.is_retained);
    assert_eq!(broker.next().await, Received::Disconnect);
    running.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_that_goes_is_told_of_between_two_messages_of_a_slow_rate() {
    let mut broker = Broker::start(0, 0).await;
    let running = start(BridgeSettings { rate_hz: 0.01, ..settings(&broker.url()) }).await;
    let token = running.session.liveliness().declare_token("robot/cart7").await.unwrap();
    let driving = running.drive("cart7");
    broker.message("/connection", is_connection("ONLINE")).await;
    driving.abort();
    token.undeclare().await.unwrap();
    broker.message("/connection", is_connection("CONNECTIONBROKEN")).await;
    assert_eq!(broker.next().await, Received::Disconnect);
    running.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_broker_that_goes_is_tried_again_and_what_was_missed_is_not_sent_later() {
    let mut broker = Broker::start(0, 0).await;
    let (url, port) = (broker.url(), broker.address.port());
    let running = start(settings(&url)).await;
    let driving = running.drive("cart7");
    let before = broker.message("/visualization", is_initialized).await;
    broker.stop().await;
    running.wait_for(|event| matches!(event, BridgeEvent::BrokerFailed { .. })).await;
    sleep(Duration::from_millis(1500)).await;
    let back = vda5050::iso_8601(std::time::SystemTime::now());
    let mut broker = Broker::start(port, 0).await;
    broker.message("/connection", is_connection("ONLINE")).await;
    let after = broker.message("/visualization", |_| true).await;
    assert!(is_initialized(&after.payload));
    assert!(after.payload["headerId"].as_u64() > before.payload["headerId"].as_u64());
    assert!(after.payload["timestamp"].as_str() >= Some(&back), "{} {back}", after.payload);
    let reached = running.events().iter().filter(|event| **event == BridgeEvent::BrokerReached).count();
    assert_eq!(reached, 2, "{:?}", running.events());
    driving.abort();
    running.stop().await;
}

/// Whether a connection was for a goodbye only: what came of it.
async fn goodbye(broker: &mut Broker) -> Message {
    assert!(matches!(broker.next().await, Received::Connect { .. }));
    let Received::Publish(message) = broker.next().await else { panic!("no message") };
    assert!(message.topic.ends_with("/connection") && message.is_retained && message.qos == 1, "{message:?}");
    assert_eq!(broker.next().await, Received::Disconnect);
    message
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_that_went_while_the_broker_was_gone_does_not_stay_online_there() {
    let mut broker = Broker::start(0, 0).await;
    let (url, port) = (broker.url(), broker.address.port());
    let running = start(settings(&url)).await;
    let token = running.session.liveliness().declare_token("robot/cart7").await.unwrap();
    let driving = running.drive("cart7");
    broker.message("/connection", is_connection("ONLINE")).await;
    // It is killed: nobody publishes the last will, and what it retained is on its disk.
    broker.stop().await;
    running.wait_for(|event| matches!(event, BridgeEvent::BrokerFailed { .. })).await;
    driving.abort();
    token.undeclare().await.unwrap();
    sleep(Duration::from_millis(300)).await;
    let mut broker = Broker::start(port, 0).await;
    assert_eq!(goodbye(&mut broker).await.payload["connectionState"], "CONNECTIONBROKEN");
    // Once.
    sleep(Duration::from_secs(1)).await;
    running.stop().await;
    assert!(broker.is_idle());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_that_is_off_when_the_bridge_begins_does_not_stay_online_at_the_broker() {
    let mut broker = Broker::start(0, 0).await;
    let serials: BTreeMap<String, String> = [("cart7".to_owned(), "AGV-0007".to_owned())].into();
    let running = start(BridgeSettings { serials, ..settings(&broker.url()) }).await;
    let message = goodbye(&mut broker).await;
    assert_eq!(message.topic, "uagv/v2/acme/AGV-0007/connection");
    assert_eq!(message.payload["connectionState"], "OFFLINE");
    assert!(running.events().iter().all(|event| !matches!(event, BridgeEvent::Vehicle { .. })));
    let driving = running.drive("cart7");
    broker.message("/connection", is_connection("ONLINE")).await;
    broker.message("/visualization", is_initialized).await;
    driving.abort();
    running.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_refusal_is_named_and_nothing_blocks() {
    let broker = Broker::start(0, 5).await;
    let running = start(settings(&broker.url())).await;
    let _present = running.presence("cart7");
    let is_named = |event: &BridgeEvent| matches!(event, BridgeEvent::BrokerFailed { error } if error.contains("NotAuthorized"));
    running.wait_for(is_named).await;
    running.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_broker_that_says_nothing_is_named_and_nothing_blocks() {
    // Connections are accepted by the system, and nobody reads.
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let running = start(settings(&format!("mqtt://{}", listener.local_addr().unwrap()))).await;
    let _present = running.presence("cart7");
    let is_named = |event: &BridgeEvent| matches!(event, BridgeEvent::BrokerFailed { error } if error.contains("does not answer"));
    running.wait_for(is_named).await;
    running.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_bridge_ends_at_once_without_a_broker() {
    // Nobody listens there any more.
    let broker = Broker::start(0, 0).await;
    let url = broker.url();
    broker.stop().await;
    let running = start(settings(&url)).await;
    let _present = running.presence("cart7");
    running.wait_for(|event| matches!(event, BridgeEvent::BrokerFailed { .. })).await;
    running.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn only_robots_that_are_wanted_and_can_be_named_are_vehicles() {
    let mut broker = Broker::start(0, 0).await;
    let serials: BTreeMap<String, String> = [("cart7".to_owned(), "AGV-0007".to_owned())].into();
    let running = start(BridgeSettings { serials, announces: false, ..settings(&broker.url()) }).await;
    let _other = running.presence("cart8");
    let _present = running.presence("cart7");
    let Received::Connect { id, will, .. } = broker.next().await else { panic!("no connection") };
    assert_eq!((id.as_str(), will), ("driftless-acme-AGV-0007", None));
    let message = broker.message("/visualization", |_| true).await;
    assert_eq!(
        (&message.payload["serialNumber"], &message.payload["version"]),
        (&"AGV-0007".into(), &"2.1.0".into())
    );
    running.stop().await;
    // Neither the other robot nor `connection`.
    loop {
        match broker.next().await {
            Received::Publish(message) => assert_eq!(message.topic, "uagv/v2/acme/AGV-0007/visualization"),
            Received::Disconnect => break,
            other => panic!("{other:?}"),
        }
    }

    let running = start(settings(&broker.url())).await;
    let _named = running.presence("käfer");
    running.wait_for(|event| matches!(event, BridgeEvent::Refused(_))).await;
    running.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn settings_that_cannot_be_used_are_refused() {
    let session = session().await;
    let run = async |settings: BridgeSettings| {
        vda5050::run(&session, settings, std::future::pending(), |_| {}).await.unwrap_err()
    };
    let good = settings("mqtt://127.0.0.1:1");
    let same = [("a", "1"), ("b", "1")].map(|(robot, serial)| (robot.to_owned(), serial.to_owned())).into();
    let error = run(BridgeSettings { serials: same, ..good.clone() }).await;
    assert!(matches!(error, BridgeError::SameSerial { .. }), "{error}");
    for rate_hz in [0.0, 1e-20, 0.009, -1.0, f64::NAN, 1e9] {
        assert!(matches!(run(BridgeSettings { rate_hz, ..good.clone() }).await, BridgeError::Rate(_)));
    }
    let error = run(BridgeSettings { manufacturer: "a/b".to_owned(), ..good.clone() }).await;
    assert!(matches!(error, BridgeError::Name(_)), "{error}");
    client::close_session(&session).await;
}
