//! Readings and frames of a bag in order of time.

use super::image::BagImage;
use super::messages::{self, MessageError};
use crate::ros::imu_sample;
use crate::{Frame, ImageData, ImuSample, SequenceError};
use bags::Bag;
use nalgebra::Vector3;
use ros_messages::sensor_msgs::Imu;
use std::iter::Peekable;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Images of two cameras are of one instant if their stamps differ by no more, nanoseconds.
const SAME_INSTANT_NS: i64 = 1_000_000;

/// Messages of a topic that were left out; told once for a recording, however often it is read.
#[derive(Debug, Default)]
pub(super) struct LeftOut {
    is_told: AtomicBool,
}

/// Stamped values of a topic, strictly increasing in time. What is damaged or out of order is left out and counted.
struct Ordered<F> {
    bag: Arc<Bag>,
    topic: usize,
    /// Number of the next message.
    next: usize,
    before_ns: Option<i64>,
    /// The value of a message and its stamp.
    read: F,
    damaged: usize,
    out_of_order: usize,
    left_out: Arc<LeftOut>,
}

impl<T, F: FnMut(&Arc<Bag>, usize, bags::Place) -> Option<(i64, T)>> Iterator for Ordered<F> {
    type Item = (i64, T);

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            let Some(message) = self.bag.topics()[self.topic].messages.get(self.next) else {
                self.tell();
                return None;
            };
            self.next += 1;
            match (self.read)(&self.bag, self.topic, message.place) {
                None => self.damaged += 1,
                Some((stamp_ns, _)) if self.before_ns.is_some_and(|before_ns| stamp_ns <= before_ns) => {
                    self.out_of_order += 1;
                }
                Some(value) => {
                    self.before_ns = Some(value.0);
                    return Some(value);
                }
            }
        }
    }
}

impl<F> Ordered<F> {
    fn tell(&self) {
        if self.damaged + self.out_of_order == 0 || self.left_out.is_told.swap(true, Ordering::Relaxed) {
            return;
        }
        tracing::warn!(
            "{}: of {} messages of {}, {} are damaged, of another encoding or not finite, and {} are not newer than those before; \
             they are left out",
            self.bag.path().display(),
            self.bag.topics()[self.topic].messages.len(),
            self.bag.topics()[self.topic].name,
            self.damaged,
            self.out_of_order
        );
    }
}

/// The readings of the IMU.
pub(super) fn readings(
    bag: &Arc<Bag>,
    topic: usize,
    left_out: &Arc<LeftOut>,
) -> impl Iterator<Item = Result<ImuSample, SequenceError>> + 'static {
    let read = |bag: &Arc<Bag>, topic, place| {
        let reading = reading(messages::read(bag, topic, place))?;
        Some((reading.stamp_ns, reading))
    };
    ordered(bag, topic, left_out, read).map(|(_, reading)| Ok(reading))
}

fn reading(message: Result<Imu, MessageError>) -> Option<ImuSample> {
    let sample = imu_sample(&message.ok()?).ok()?;
    let is_finite = |vector: &Vector3<f64>| vector.iter().all(|value| value.is_finite());
    (is_finite(&sample.gyroscope) && is_finite(&sample.accelerometer)).then_some(sample)
}

fn ordered<T, F: FnMut(&Arc<Bag>, usize, bags::Place) -> Option<(i64, T)>>(
    bag: &Arc<Bag>,
    topic: usize,
    left_out: &Arc<LeftOut>,
    read: F,
) -> Ordered<F> {
    Ordered {
        bag: Arc::clone(bag),
        topic,
        next: 0,
        before_ns: None,
        read,
        damaged: 0,
        out_of_order: 0,
        left_out: Arc::clone(left_out),
    }
}

type Images = Peekable<Box<dyn Iterator<Item = (i64, ImageData)>>>;

/// The frames of one or two cameras: one for every instant at which any of them has an image.
pub(super) struct FrameRows {
    cameras: Vec<Images>,
    time_offset_ns: i64,
}

impl FrameRows {
    /// # Arguments
    /// * `topics`: of each camera, with what was left out of it.
    /// * `time_offset_ns`: added to the stamps.
    pub(super) fn new(bag: &Arc<Bag>, topics: &[(usize, Arc<LeftOut>)], time_offset_ns: i64) -> Self {
        let images = |(topic, left_out): &(usize, Arc<LeftOut>)| -> Images {
            let read = |bag: &Arc<Bag>, topic, place| {
                let stamp_ns = messages::read_stamp(bag, topic, place)?;
                let image = BagImage { bag: Arc::clone(bag), topic, stamp_ns, place };
                Some((stamp_ns, ImageData::Stored(Arc::new(image))))
            };
            let rows: Box<dyn Iterator<Item = _>> = Box::new(ordered(bag, *topic, left_out, read));
            rows.peekable()
        };
        Self { cameras: topics.iter().map(images).collect(), time_offset_ns }
    }
}

impl Iterator for FrameRows {
    type Item = Result<Frame, SequenceError>;

    fn next(&mut self) -> Option<Self::Item> {
        let stamps = self.cameras.iter_mut().map(|images| images.peek().map(|(stamp_ns, _)| *stamp_ns));
        let stamps: Vec<Option<i64>> = stamps.collect();
        let first_ns = stamps.iter().flatten().min().copied()?;
        let is_due = |stamp_ns: &i64| stamp_ns - first_ns <= SAME_INSTANT_NS;
        let mut frame = Frame::default();
        // The stamp of a pair is that of camera 0.
        let stamp_ns = stamps.iter().flatten().copied().find(is_due).unwrap_or(first_ns);
        frame.stamp_ns = stamp_ns + self.time_offset_ns;
        for (index, images) in self.cameras.iter_mut().enumerate() {
            frame.images[index] = images.next_if(|(stamp_ns, _)| is_due(stamp_ns)).map(|(_, image)| image);
        }
        Some(Ok(frame))
    }
}
