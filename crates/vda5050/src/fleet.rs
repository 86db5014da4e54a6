//! The robots of a fleet, as they publish on Zenoh.

use crate::bridge::BridgeError;
use crate::vehicle::{Vehicle, VehicleSettings};
use protocol::{Published, keys};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;
use zenoh::Session;
use zenoh::pubsub::Subscriber;
use zenoh::sample::{Sample, SampleKind};

/// Robots that are followed; those that come later are ignored.
pub(crate) const MAX_ROBOTS: usize = 1000;

/// A vehicle that several tasks look at.
pub(crate) type SharedVehicle = Arc<Mutex<Vehicle>>;

/// Locks what is shared; a task that panicked leaves nothing half done.
pub(crate) fn lock<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The robots, by name.
pub(crate) struct Fleet {
    settings: VehicleSettings,
    /// The robots that are followed; empty for all.
    chosen: BTreeSet<String>,
    vehicles: Mutex<BTreeMap<String, SharedVehicle>>,
    is_full: AtomicBool,
}

/// Follows robots until it is dropped.
pub(crate) struct Following {
    _subscribers: Vec<Subscriber<()>>,
}

impl Fleet {
    /// # Arguments
    /// * `chosen`: names of the robots that are followed; empty for all.
    pub(crate) fn new(settings: VehicleSettings, chosen: BTreeSet<String>) -> Self {
        Self { settings, chosen, vehicles: Mutex::default(), is_full: AtomicBool::new(false) }
    }

    /// Whether there were more robots than [`MAX_ROBOTS`].
    pub(crate) fn is_full(&self) -> bool {
        self.is_full.load(Ordering::Relaxed)
    }

    /// The robots that were heard of, and those that were expected.
    pub(crate) fn vehicles(&self) -> Vec<(String, SharedVehicle)> {
        let vehicles = lock(&self.vehicles);
        vehicles.iter().map(|(name, vehicle)| (name.clone(), Arc::clone(vehicle))).collect()
    }

    /// Adds the robots that are chosen and were not heard of, as such.
    pub(crate) fn expect_chosen(&self, now: Instant) {
        let mut vehicles = lock(&self.vehicles);
        for robot in &self.chosen {
            if vehicles.len() < MAX_ROBOTS && !vehicles.contains_key(robot) {
                let expected = Vehicle::expected(self.settings.clone(), now);
                vehicles.insert(robot.clone(), Arc::new(Mutex::new(expected)));
            }
        }
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
        if !self.chosen.is_empty() && !self.chosen.contains(robot) {
            return;
        }
        let mut vehicles = lock(&self.vehicles);
        if vehicles.len() >= MAX_ROBOTS && !vehicles.contains_key(robot) {
            return self.is_full.store(true, Ordering::Relaxed);
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
