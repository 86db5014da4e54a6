//! The two ends of a live source: inputs for drivers, and the source that a robot plays.

use super::assembly::PendingFrame;
use super::buffer::{LiveBuffer, Ready};
use super::fault::{FaultKind, LiveFault};
use super::image::LiveImage;
use super::settings::LiveSettings;
use super::stream::Stream;
use crate::{
    Contents, Frame, GnssReading, ImuSample, PairCounts, SensorCalibration, SensorError, SensorEvent,
    SensorSource, TrackObservation, WheelReading,
};
use protocol::FeatureSet;
use std::collections::BTreeMap;
use std::fmt::Display;
use std::sync::mpsc::{Receiver, sync_channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Without a frame for so long, [`SensorEvent::Tick`] comes.
const TICK: Duration = Duration::from_millis(200);
/// A waiting reader looks so often whether something is due that waited for late messages.
const LOOK: Duration = Duration::from_millis(5);
/// Readings that a tap holds: two seconds at 1 kHz.
const TAP: usize = 2000;

#[derive(Debug)]
struct Shared {
    buffer: Mutex<(LiveBuffer, bool)>,
    arrived: Condvar,
    begin: Instant,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, (LiveBuffer, bool)> {
        self.buffer.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn with(&self, change: impl FnOnce(&mut LiveBuffer, Duration)) {
        let mut guard = self.lock();
        // Within the lock, so that arrivals never decrease.
        change(&mut guard.0, self.begin.elapsed());
        drop(guard);
        self.arrived.notify_one();
    }
}

/// Where drivers hand in their measurements, from any thread. Clones belong to the same source.
///
/// No method waits for the reader, decodes an image, or fails: what cannot be used is counted and named in
/// [`LiveReport::faults`].
#[derive(Clone, Debug)]
pub struct LiveInputs {
    shared: Arc<Shared>,
}

impl LiveInputs {
    /// Hands in a reading of the IMU, stamped by the sensor's clock.
    pub fn imu(&self, reading: ImuSample) {
        self.shared.with(|buffer, now| buffer.imu(reading, now));
    }

    /// Hands in a reading of the wheels, where [`LiveSettings::wheels`] expects them.
    pub fn wheels(&self, reading: WheelReading) {
        self.shared.with(|buffer, now| buffer.wheels(reading, now));
    }

    /// Hands in a position of GNSS, where [`LiveSettings::gnss`] expects them.
    pub fn gnss(&self, reading: GnssReading) {
        self.shared.with(|buffer, now| buffer.gnss(reading, now));
    }

    /// Reports a message that measures nothing: a receiver without a position. The stream is not silent.
    pub fn nothing(&self, stream: Stream) {
        self.shared.with(|buffer, now| {
            buffer.arrived(stream, now);
        });
    }

    /// Hands in an image of a camera.
    ///
    /// # Arguments
    /// * `camera`: its index in the calibration; images of cameras that are not used are ignored.
    /// * `stamp_ns`: time of exposure on the clock of the camera, nanoseconds.
    pub fn image(&self, camera: usize, stamp_ns: i64, image: LiveImage) {
        self.shared.with(|buffer, now| buffer.image(camera, stamp_ns, image, now));
    }

    /// Hands in the tracks of an instant, and its features where there are any.
    pub fn tracks(&self, stamp_ns: i64, tracks: Vec<TrackObservation>, features: Option<FeatureSet>) {
        self.shared.with(|buffer, now| buffer.tracks(stamp_ns, tracks, features, now));
    }

    /// States that the publisher of a stream offers best effort: recordings of the stream offer the same.
    pub fn best_effort(&self, stream: Stream) {
        self.shared.with(|buffer, _| buffer.set_best_effort(stream));
    }

    /// Reports a message that could not be read: wrong encoding, wrong length.
    pub fn refuse(&self, stream: Stream, problem: impl Display) {
        self.shared.with(|buffer, now| buffer.refuse(stream, problem.to_string(), now));
    }

    /// Ends the source, after what has arrived.
    pub fn close(&self) {
        self.shared.lock().1 = true;
        self.shared.arrived.notify_one();
    }
}

/// What a live source says of itself.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LiveReport {
    /// What is wrong at present.
    pub faults: Vec<LiveFault>,
    /// Frames that were dropped since the start: the processor did not keep up, or there were no readings for them.
    pub dropped_frames: u64,
    /// Add this to the stamps of events to obtain those of the sensors now, nanoseconds: jumps of their clocks.
    pub clock_shift_ns: i64,
    /// Streams whose publishers offer best effort, as far as the driver knows.
    pub best_effort: Vec<Stream>,
}

/// Measurements that arrive now, as a [`SensorSource`].
///
/// # Order
/// Readings come out in order as soon as they are there, frames as soon as the readings up to them are. Out of order, messages
/// may be late by 200 ms. Readings are not dropped. Of frames, the oldest are, where the reader does not keep up.
///
/// # Faults
/// None ends the source. [`SensorSource::live`] names them within two seconds.
///
/// # Example
/// ```
/// use nalgebra::Vector3;
/// use sensors::live::{LiveSettings, LiveSource};
/// use sensors::{ImuSample, SensorCalibration, SensorEvent, SensorSource};
///
/// let calibration = SensorCalibration::default();
/// let settings = LiveSettings::images(&calibration);
/// let (inputs, mut source) = LiveSource::new("my robot", calibration, &settings);
/// // In the driver's thread:
/// inputs.imu(ImuSample { stamp_ns: 5, gyroscope: Vector3::zeros(), accelerometer: Vector3::z() * 9.81 });
/// inputs.close();
/// // In the estimator's:
/// assert!(matches!(source.next()?, Some(SensorEvent::Imu(reading)) if reading.stamp_ns == 5));
/// # Ok::<(), sensors::SensorError>(())
/// ```
#[derive(Debug)]
pub struct LiveSource {
    name: String,
    calibration: SensorCalibration,
    contents: Contents,
    shared: Arc<Shared>,
    last_return: Instant,
}

impl LiveSource {
    /// A source and its inputs.
    ///
    /// # Arguments
    /// * `name`: for messages.
    pub fn new(
        name: impl Into<String>,
        calibration: SensorCalibration,
        settings: &LiveSettings,
    ) -> (LiveInputs, Self) {
        let buffer = Mutex::new((LiveBuffer::new(&calibration, settings), false));
        let shared = Arc::new(Shared { buffer, arrived: Condvar::new(), begin: Instant::now() });
        let inputs = LiveInputs { shared: Arc::clone(&shared) };
        let (name, contents) = (name.into(), settings.contents());
        (inputs, Self { name, calibration, contents, shared, last_return: Instant::now() })
    }

    /// Decodes the images of a frame; `None` where none of them can be used.
    fn decode(&self, stamp_ns: i64, pending: PendingFrame) -> Option<Frame> {
        let PendingFrame { images, tracks, features } = pending;
        // A message has the features of camera 0.
        let features = features.into_iter().map(|features| (0, features)).collect();
        let mut frame = Frame { stamp_ns, images: BTreeMap::new(), tracks, features };
        for (camera, image) in images {
            let Some(sensor) = self.calibration.cameras.get(camera) else { continue };
            match image.into_image((sensor.camera.width, sensor.camera.height)) {
                Ok(image) => drop(frame.images.insert(camera, image)),
                Err(error) => {
                    let problem = error.to_string();
                    self.shared.with(|buffer, now| buffer.refuse(Stream::Camera(camera), problem, now));
                }
            }
        }
        (!frame.images.is_empty() || !self.contents.images).then_some(frame)
    }

    /// Waits for the next event; `None` when it is time for a tick, and an error at the end.
    fn wait(&self) -> Result<Option<Ready>, Ended> {
        let mut guard = self.shared.lock();
        loop {
            if self.last_return.elapsed() >= TICK {
                return Ok(None);
            }
            // At the end nothing waits for what is late.
            let now = if guard.1 { Duration::MAX } else { self.shared.begin.elapsed() };
            if let Some(ready) = guard.0.poll(now) {
                return Ok(Some(ready));
            }
            if guard.1 {
                return Err(Ended);
            }
            guard = self.shared.arrived.wait_timeout(guard, LOOK).unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

/// The inputs were closed.
struct Ended;

impl SensorSource for LiveSource {
    fn name(&self) -> &str {
        &self.name
    }

    fn calibration(&self) -> &SensorCalibration {
        &self.calibration
    }

    fn contents(&self) -> Contents {
        self.contents
    }

    fn next(&mut self) -> Result<Option<SensorEvent>, SensorError> {
        loop {
            match self.wait() {
                Ok(Some(Ready::Imu(reading))) => return Ok(Some(SensorEvent::Imu(reading))),
                Ok(Some(Ready::Wheels(reading))) => return Ok(Some(SensorEvent::Wheels(reading))),
                Ok(Some(Ready::Gnss(reading))) => return Ok(Some(SensorEvent::Gnss(reading))),
                Ok(Some(Ready::Frame(stamp_ns, pending))) => {
                    if let Some(frame) = self.decode(stamp_ns, pending) {
                        self.last_return = Instant::now();
                        return Ok(Some(SensorEvent::Frame(frame)));
                    }
                }
                Ok(None) => {
                    self.last_return = Instant::now();
                    return Ok(Some(SensorEvent::Tick));
                }
                Err(Ended) => return Ok(None),
            }
        }
    }

    fn live(&self) -> Option<LiveReport> {
        let guard = self.shared.lock();
        let (buffer, now) = (&guard.0, self.shared.begin.elapsed());
        Some(LiveReport {
            faults: buffer.active_faults(now),
            dropped_frames: buffer.count(FaultKind::Overload) + buffer.count(FaultKind::WithoutImu),
            clock_shift_ns: buffer.clock_shift_ns(),
            best_effort: buffer.best_effort().to_vec(),
        })
    }

    fn stereo_pairs(&self) -> Option<PairCounts> {
        self.shared.lock().0.pairs()
    }

    fn tap_imu(&self) -> Option<Receiver<ImuSample>> {
        let (tap, readings) = sync_channel(TAP);
        self.shared.lock().0.set_tap(tap);
        Some(readings)
    }
}
