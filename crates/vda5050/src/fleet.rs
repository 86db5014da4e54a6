//! The robots of a fleet, as they publish on Zenoh.

use crate::bridge::BridgeError;
use crate::vehicle::{Vehicle, VehicleSettings};
use protocol::{Published, keys};
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
        for topic in Published::TOPICS {
            let fleet = Arc::clone(self);
            let callback = move |sample: Sample| fleet.note_sample(&sample);
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
        let Some(robot) = keys::robot_of(sample.key_expr().as_str()) else { return };
        let mut vehicles = lock(&self.vehicles);
        if vehicles.len() >= MAX_ROBOTS && !vehicles.contains_key(robot) {
            return;
        }
        let now = Instant::now();
        let new = || Arc::new(Mutex::new(Vehicle::new(self.settings.clone(), now)));
        change(&mut lock(vehicles.entry(robot.to_owned()).or_insert_with(new)), now);
    }

    fn note_sample(&self, sample: &Sample) {
        if sample.kind() != SampleKind::Put {
            return;
        }
        let key = sample.key_expr().as_str();
        match Published::decode(key, &sample.encoding().to_string(), &sample.payload().to_bytes()) {
            Ok(published) => self.with_vehicle(sample, |vehicle, now| vehicle.note(published, now)),
            Err(error) => tracing::debug!(key, "not read: {error}"),
        }
    }

    fn note_token(&self, sample: &Sample) {
        let is_there = sample.kind() == SampleKind::Put;
        self.with_vehicle(sample, |vehicle, now| vehicle.note_token(is_there, now));
    }
}
