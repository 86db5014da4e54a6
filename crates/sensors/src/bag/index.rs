//! The messages of a sensor's topic in order of the stamps in their headers.

use super::messages;
use crate::stamps::{StampOrder, Step, Told, median_interval_ns, order};
use bags::{Bag, Place};
use std::sync::atomic::{AtomicBool, Ordering};

/// So many messages of a sensor were not measured at one time.
const MANY: usize = 10;

/// A message and its stamp.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stamped {
    /// Nanoseconds.
    pub(super) stamp_ns: i64,
    pub(super) place: Place,
}

/// A topic whose stamps were read.
#[derive(Debug)]
pub(super) struct StampedTopic {
    /// Index in [`Bag::topics`].
    pub(super) topic: usize,
    /// Strictly increasing in time.
    pub(super) messages: Vec<Stamped>,
    /// Steps back of the clock.
    pub(super) steps: Vec<Step>,
    /// Whether unusable messages have been reported: once, however often the topic is read.
    is_told: AtomicBool,
}

impl StampedTopic {
    /// Reads the stamps of a topic, and says which messages are left out and what else is odd about them.
    ///
    /// # Arguments
    /// * `known_steps`: of the clock, as another topic shows them.
    pub(super) fn read(bag: &Bag, topic: usize, known_steps: &[Step]) -> Self {
        let recorded = &bag.topics()[topic].messages;
        let stamped = recorded.iter().filter_map(|message| {
            let stamp_ns = messages::read_stamp(bag, topic, message.place)?;
            Some((message.log_ns, Stamped { stamp_ns, place: message.place }))
        });
        let (logs, stamped): (Vec<i64>, Vec<Stamped>) = stamped.unzip();
        let stamps: Vec<i64> = stamped.iter().map(|message| message.stamp_ns).collect();
        let order = order(&stamps, &logs, known_steps);
        // If all messages have one stamp, that alone is reported.
        if order.sorted.len() > 1 || order.doubled < MANY {
            tell(bag, topic, &stamps, &order);
        }
        let place = |&(stamp_ns, index): &(i64, usize)| Stamped { stamp_ns, place: stamped[index].place };
        let messages = order.sorted.iter().map(place).collect();
        Self { topic, messages, steps: order.steps, is_told: AtomicBool::new(false) }
    }

    /// Whether many messages have one and the same stamp.
    pub(super) fn is_stopped(&self, bag: &Bag) -> bool {
        self.messages.len() == 1 && bag.topics()[self.topic].messages.len() >= MANY
    }

    /// Messages a second by the median interval of their stamps; 1 for a single message.
    pub(super) fn rate_hz(&self) -> f64 {
        let interval_ns = median_interval_ns(self.messages.iter().map(|message| message.stamp_ns));
        interval_ns.map_or(1.0, |interval_ns| 1e9 / interval_ns as f64)
    }

    /// Says once for a recording why some of its messages are not used.
    pub(super) fn tell_once(&self, bag: &Bag, unusable: usize, why: &str) {
        if unusable > 0 && !self.is_told.swap(true, Ordering::Relaxed) {
            let topic = &bag.topics()[self.topic];
            let (path, name, all) = (bag.path().display(), &topic.name, topic.messages.len());
            tracing::warn!("{path}: {unusable} of {all} messages of {name} {why}; they are left out");
        }
    }
}

/// The stamps of a topic in order, without those that are wrong.
pub(super) fn stamps(bag: &Bag, topic: usize) -> Vec<i64> {
    let recorded = bag.topics()[topic].messages.iter();
    let stamped = recorded
        .filter_map(|message| Some((messages::read_stamp(bag, topic, message.place)?, message.log_ns)));
    let (stamps, logs): (Vec<i64>, Vec<i64>) = stamped.unzip();
    order(&stamps, &logs, &[]).sorted.into_iter().map(|(stamp_ns, _)| stamp_ns).collect()
}

/// Says what is odd about the stamps of a topic.
fn tell(bag: &Bag, topic: usize, stamps: &[i64], order: &StampOrder) {
    let topic = &bag.topics()[topic];
    let (path, name, all) = (bag.path().display(), &topic.name, topic.messages.len());
    let damaged = all - stamps.len();
    if damaged > 0 {
        tracing::warn!(
            "{path}: {damaged} of {all} messages of {name} are damaged or of another encoding; they are left out"
        );
    }
    let (name, which) = (format!("{path}, {name}"), |index| format!("message {} of {all}", index + 1));
    order.tell(stamps, &Told { name: &name, which: &which, all: "messages" });
    if order.out_of_order > 0 {
        tracing::info!("{name}: {}", order.describe_order(all, "messages"));
    }
}
