//! The robots of a fleet, as they publish on Zenoh.

use crate::bridge::BridgeError;
use crate::vehicle::{Published, Vehicle, VehicleSettings};
use protocol::{CodecError, Format, Message, keys};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;
use zenoh::Session;
use zenoh::pubsub::Subscriber;
use zenoh::sample::{Sample, SampleKind};

/// Robots that are followed; messages of others are ignored.
const MAX_ROBOTS: usize = 1000;

/// A vehicle that several tasks look at.
pub(crate) type SharedVehicle = Arc<Mutex<Vehicle>>;

/// Locks what is shared; a task that panicked leaves nothing half done.
pub(crate) fn lock<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The robots, by name.
pub(crate) struct Fleet {
    settings: VehicleSettings,
    vehicles: Mutex<BTreeMap<String, SharedVehicle>>,
}

/// Follows robots until it is dropped.
pub(crate) struct Following {
    _subscribers: Vec<Subscriber<()>>,
}

impl Fleet {
    pub(crate) fn new(settings: VehicleSettings) -> Self {
        Self { settings, vehicles: Mutex::default() }
    }

    /// The robots that were heard of.
    pub(crate) fn vehicles(&self) -> Vec<(String, SharedVehicle)> {
        let vehicles = lock(&self.vehicles);
        vehicles.iter().map(|(name, vehicle)| (name.clone(), Arc::clone(vehicle))).collect()
    }

    /// Follows all robots of the session's namespace.
    pub(crate) async fn follow(self: &Arc<Self>, session: &Session) -> Result<Following, BridgeError> {
        let mut subscribers = Vec::new();
        for topic in ["pose", "odometry", "status"] {
            let fleet = Arc::clone(self);
            let callback = move |sample: Sample| fleet.note_sample(topic, &sample);
            let declared = session.declare_subscriber(format!("robot/*/{topic}")).callback(callback).await;
            subscribers.push(declared.map_err(BridgeError::Zenoh)?);
        }
        let fleet = Arc::clone(self);
        let callback = move |sample: Sample| fleet.note_token(&sample);
        let declared = session.liveliness().declare_subscriber("robot/*").history(true).callback(callback);
        subscribers.push(declared.await.map_err(BridgeError::Zenoh)?);
        Ok(Following { _subscribers: subscribers })
    }

    fn with_vehicle(&self, sample: &Sample, change: impl FnOnce(&mut Vehicle, Instant)) {
        let robot = sample.key_expr().as_str().split('/').nth(1);
        let Some(robot) = robot.filter(|name| keys::validate_name(name).is_ok()) else { return };
        let mut vehicles = lock(&self.vehicles);
        if vehicles.len() >= MAX_ROBOTS && !vehicles.contains_key(robot) {
            return;
        }
        let now = Instant::now();
        let new = || Arc::new(Mutex::new(Vehicle::new(self.settings.clone(), now)));
        change(&mut lock(vehicles.entry(robot.to_owned()).or_insert_with(new)), now);
    }

    fn note_sample(&self, topic: &str, sample: &Sample) {
        if sample.kind() != SampleKind::Put {
            return;
        }
        let published = match topic {
            "pose" => decode(sample).map(|pose| Published::Pose(Box::new(pose))),
            "odometry" => decode(sample).map(|odometry| Published::Odometry(Box::new(odometry))),
            _ => decode(sample).map(Published::Status),
        };
        match published {
            Ok(published) => self.with_vehicle(sample, |vehicle, now| vehicle.note(published, now)),
            Err(error) => tracing::debug!(key = sample.key_expr().as_str(), "not read: {error}"),
        }
    }

    fn note_token(&self, sample: &Sample) {
        let is_there = sample.kind() == SampleKind::Put;
        self.with_vehicle(sample, |vehicle, now| vehicle.note_token(is_there, now));
    }
}

fn decode<M: Message>(sample: &Sample) -> Result<M, CodecError> {
    let encoding = sample.encoding().to_string();
    let format = Format::from_encoding(&encoding).ok_or(CodecError::UnknownFormat(encoding))?;
    protocol::decode(format, &sample.payload().to_bytes())
}
