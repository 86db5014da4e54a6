//! The bridge: robots on Zenoh, vehicles at an MQTT broker.

use crate::broker::{BrokerAddress, BrokerUser};
use crate::fleet::{Fleet, MAX_ROBOTS};
use crate::mqtt::{BrokerWatch, VehicleConnection, VehicleNames};
use crate::names::{INTERFACE, NameError, Topics, check_level, check_serial};
use crate::session::Endpoint;
use crate::tls::{BrokerTls, BrokerTlsError};
use crate::vehicle::VehicleSettings;
use protocol::presence::SILENCE;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::{Duration, Instant};
use thiserror::Error;
use tokio::sync::watch;
use tokio::task::JoinSet;
use zenoh::Session;

/// Messages of a vehicle a second, at least and at most.
const MIN_RATE_HZ: f64 = 0.01;
const MAX_RATE_HZ: f64 = 100.0;
/// Time between two looks for new robots.
const LOOK: Duration = Duration::from_millis(200);

/// Why a bridge cannot begin.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum BridgeError {
    /// A name that cannot be a part of a topic.
    #[error(transparent)]
    Name(#[from] NameError),
    /// Two robots with one serial number.
    #[error("the robots {first} and {second} have the same serial number {serial}: give each its own")]
    SameSerial {
        /// One robot.
        first: String,
        /// The other.
        second: String,
        /// The serial number of both.
        serial: String,
    },
    /// A rate below 0.01 Hz, or beyond 100 Hz.
    #[error("{0} Hz cannot be the rate of a topic: {min} to {max} are possible", min = MIN_RATE_HZ, max = MAX_RATE_HZ)]
    Rate(f64),
    /// Certificates or a key that cannot be used.
    #[error(transparent)]
    Tls(#[from] BrokerTlsError),
    /// Certificates for an address without TLS.
    #[error("certificates are given, but {0} is an address without TLS: give mqtts://HOST:PORT")]
    NoTls(BrokerAddress),
    /// Zenoh refused, as of a closed session.
    #[error("the robots cannot be followed: {0}")]
    Zenoh(zenoh::Error),
}

/// What a bridge does.
#[derive(Clone, Debug)]
pub struct BridgeSettings {
    /// The broker.
    pub broker: BrokerAddress,
    /// Certificates, where it is reached by TLS.
    pub tls: BrokerTls,
    /// The user there, if any.
    pub user: Option<BrokerUser>,
    /// First level of all topics.
    pub interface: String,
    /// Manufacturer of the vehicles.
    pub manufacturer: String,
    /// Serial numbers of the robots that are bridged, by name; empty for all robots, whose names are their serial numbers.
    pub serials: BTreeMap<String, String>,
    /// Messages of a vehicle a second, 0.01 to 100.
    pub rate_hz: f64,
    /// Whether `connection` is published; not where the vehicle's own controller does.
    pub announces: bool,
    /// How vehicles are described.
    pub vehicle: VehicleSettings,
}

impl BridgeSettings {
    /// All robots, five times a second, with `connection`.
    pub fn new(broker: BrokerAddress, manufacturer: impl Into<String>) -> Self {
        Self {
            broker,
            tls: BrokerTls::default(),
            user: None,
            interface: INTERFACE.to_owned(),
            manufacturer: manufacturer.into(),
            serials: BTreeMap::new(),
            rate_hz: 5.0,
            announces: true,
            vehicle: VehicleSettings::default(),
        }
    }

    fn check(&self) -> Result<(), BridgeError> {
        check_level(&self.interface)?;
        check_level(&self.manufacturer)?;
        if !(MIN_RATE_HZ..=MAX_RATE_HZ).contains(&self.rate_hz) {
            return Err(BridgeError::Rate(self.rate_hz));
        }
        let mut robots = BTreeMap::new();
        for (robot, serial) in &self.serials {
            check_serial(serial)?;
            if let Some(first) = robots.insert(serial, robot) {
                let (first, second, serial) = (first.clone(), robot.clone(), serial.clone());
                return Err(BridgeError::SameSerial { first, second, serial });
            }
        }
        Ok(())
    }

    /// How the broker is reached.
    fn endpoint(&self) -> Result<Endpoint, BridgeError> {
        let BrokerAddress { host, port, has_tls } = self.broker.clone();
        let tls = match has_tls {
            true => Some((self.tls.client_config()?, BrokerTls::name_of(&host)?)),
            false if self.tls == BrokerTls::default() => None,
            false => return Err(BridgeError::NoTls(self.broker.clone())),
        };
        Ok(Endpoint { host, port, tls })
    }

    /// The serial number of a robot; `None` for one that is not bridged.
    fn serial_of(&self, robot: &str) -> Option<String> {
        if self.serials.is_empty() { Some(robot.to_owned()) } else { self.serials.get(robot).cloned() }
    }
}

/// What a bridge tells its program.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum BridgeEvent {
    /// A robot was found, and is published under a topic.
    Vehicle {
        /// Its name.
        robot: String,
        /// Where its position is.
        topic: String,
    },
    /// A robot whose name cannot be a serial number: it is not published.
    Refused(NameError),
    /// The z axis of a robot's map is not vertical: its position is published as not initialized. Told once.
    MapNotLevel {
        /// The robot.
        robot: String,
        /// The map.
        map: String,
        /// Angle between z and the vertical, degrees.
        tilt_deg: f64,
    },
    /// More robots were heard of than are bridged: those that came later are not published. Told once.
    TooManyRobots {
        /// How many are bridged.
        limit: usize,
    },
    /// The broker answers.
    BrokerReached,
    /// The broker does not answer, or refuses; it is tried again until it does.
    BrokerFailed {
        /// What went wrong.
        error: String,
    },
}

/// Publishes the robots of a session's namespace as VDA 5050 vehicles until `stop` is complete, then says goodbye at the broker.
///
/// Each vehicle has a connection to the broker of its own, since a last will belongs to a connection. Nothing waits for the broker: while it
/// does not answer positions are dropped, and after it does the newest follow.
///
/// `connection` is retained, and a broker keeps `ONLINE` of who went off while it, or the bridge, was not there. The end of an announced vehicle is published
/// until the broker takes it; robots of [`BridgeSettings::serials`] that nothing is heard of within 5 s are `OFFLINE` from then on.
///
/// # Arguments
/// * `tell`: takes what happens; it must not block.
///
/// # Errors
/// Settings that cannot be used, among them certificates, and a session that is closed.
pub async fn run(
    session: &Session,
    settings: BridgeSettings,
    stop: impl Future<Output = ()>,
    tell: impl Fn(BridgeEvent) + Send + Sync + 'static,
) -> Result<(), BridgeError> {
    settings.check()?;
    let endpoint = settings.endpoint()?;
    let chosen = settings.serials.keys().cloned().collect();
    let fleet = Arc::new(Fleet::new(settings.vehicle.clone(), chosen));
    let _following = fleet.follow(session).await?;
    let settings = Arc::new(settings);
    let watch = Arc::new(BrokerWatch::new(tell));
    let (stopping, stopped) = watch::channel(false);
    let (mut tasks, mut known, mut is_full) = (JoinSet::new(), BTreeSet::new(), false);
    let mut expected_at = settings.announces.then(|| Instant::now() + SILENCE);
    let mut looks = tokio::time::interval(LOOK);
    tokio::pin!(stop);
    loop {
        tokio::select! {
            () = &mut stop => break,
            _ = looks.tick() => {}
        }
        if fleet.is_full() && !std::mem::replace(&mut is_full, true) {
            watch.tell(BridgeEvent::TooManyRobots { limit: MAX_ROBOTS });
        }
        if expected_at.take_if(|at| *at <= Instant::now()).is_some() {
            fleet.expect_chosen(Instant::now());
        }
        for (robot, vehicle) in fleet.vehicles() {
            let Some(serial) = settings.serial_of(&robot).filter(|_| known.insert(robot.clone())) else {
                continue;
            };
            match Topics::new(&settings.interface, &settings.manufacturer, &serial) {
                Ok(topics) => {
                    let names = VehicleNames { robot, serial, topics };
                    let (settings, watch) = (Arc::clone(&settings), Arc::clone(&watch));
                    let connection =
                        VehicleConnection::new(settings, endpoint.clone(), watch, names, vehicle);
                    tasks.spawn(connection.serve(stopped.clone()));
                }
                Err(error) => watch.tell(BridgeEvent::Refused(error)),
            }
        }
    }
    // Nobody is left to receive it where there are no vehicles.
    let _ = stopping.send(true);
    while tasks.join_next().await.is_some() {}
    Ok(())
}
