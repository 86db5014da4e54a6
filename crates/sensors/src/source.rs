//! Where a robot's measurements come from: [`SensorSource`].

use super::live::LiveReport;
use super::{Frame, GnssReading, ImuSample, PairCounts, SensorCalibration, SensorError, WheelReading};
use std::sync::mpsc::Receiver;

/// A stream of IMU readings and camera frames in order of time, with the calibration of the sensors.
///
/// A robot plays any source: a recording on disk or in memory ([`Recording::source`](crate::Recording::source)), a bag,
/// a driver. Ground truth is not part of it: it serves evaluation, and belongs to the recording.
///
/// # Order
/// Events come in order of their `stamp_ns`. A reading and a frame of the same time come in this order: once a frame
/// was returned, every reading up to and including its time was returned before, of the IMU, of wheels and of GNSS. Readings are strictly increasing in
/// time, and so are frames. The clocks of IMU and cameras are compared as they are: an offset between them is the
/// consumer's to handle, who reads ahead as far as it needs (for a frame at time t: to the first reading at or after t
/// plus the offset, so that the motion is known up to t).
///
/// A source whose data arrive late, in bursts or out of order has to sort them before it returns them. A live source
/// does not hold readings back for frames that are still on their way: a frame may come after later readings.
///
/// # Example
/// A source that computes its measurements:
/// ```
/// use sensors::ImuSample;
/// use nalgebra::Vector3;
/// use sensors::{Contents, SensorCalibration, SensorError, SensorEvent, SensorSource};
///
/// /// An IMU at rest, 200 readings a second, for one second.
/// struct AtRest {
///     calibration: SensorCalibration,
///     readings: i64,
/// }
///
/// impl SensorSource for AtRest {
///     fn name(&self) -> &str {
///         "an IMU at rest"
///     }
///
///     fn calibration(&self) -> &SensorCalibration {
///         &self.calibration
///     }
///
///     fn contents(&self) -> Contents {
///         Contents::default()
///     }
///
///     fn next(&mut self) -> Result<Option<SensorEvent>, SensorError> {
///         let stamp_ns = self.readings * 5_000_000;
///         self.readings += 1;
///         let (gyroscope, accelerometer) = (Vector3::zeros(), Vector3::new(0.0, 0.0, 9.81));
///         let reading = ImuSample { stamp_ns, gyroscope, accelerometer };
///         Ok((stamp_ns < 1_000_000_000).then_some(SensorEvent::Imu(reading)))
///     }
/// }
///
/// let mut source = AtRest { calibration: SensorCalibration::default(), readings: 0 };
/// let mut readings = 0;
/// while let Some(event) = source.next()? {
///     readings += usize::from(matches!(event, SensorEvent::Imu(_)));
/// }
/// assert_eq!(readings, 200);
/// # Ok::<(), SensorError>(())
/// ```
pub trait SensorSource {
    /// What is read, for messages: a folder, a file, a topic.
    fn name(&self) -> &str;

    /// Calibration of the sensors. It does not change while the source is read.
    fn calibration(&self) -> &SensorCalibration;

    /// What the frames carry. A robot decides by it, before the first event, whether it needs a front end.
    fn contents(&self) -> Contents;

    /// The next event; `None` at the end, and again whenever it is called after the end.
    ///
    /// A live source waits here for the next measurement.
    ///
    /// # Errors
    /// [`SensorError`]: nothing can be read any more. Damage that later events survive (one undecodable message) is
    /// to be logged and left out instead.
    fn next(&mut self) -> Result<Option<SensorEvent>, SensorError>;

    /// What a live source says of itself; `None` for a recording, which can wait for its reader.
    fn live(&self) -> Option<LiveReport> {
        None
    }

    /// Stereo pairs and images without a partner, of a live source those so far; `None` without a stereo pair.
    fn stereo_pairs(&self) -> Option<PairCounts> {
        None
    }

    /// Readings of the IMU in order of time as soon as they are there, before [`Self::next`] returns them, for whoever predicts
    /// poses from them; `None` for a recording.
    ///
    /// A receiver that is two seconds behind misses readings. There is one; a further call replaces it.
    fn tap_imu(&self) -> Option<Receiver<ImuSample>> {
        None
    }
}

/// One measurement.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum SensorEvent {
    /// A reading of the IMU.
    Imu(ImuSample),
    /// A reading of the wheels.
    Wheels(WheelReading),
    /// A position of GNSS.
    Gnss(GnssReading),
    /// What the cameras gave at one instant.
    Frame(Frame),
    /// Nothing: a live source without frames returns it a few times a second, so that its reader can look at
    /// [`SensorSource::live`] and whether to stop.
    Tick,
}

impl SensorEvent {
    /// Time of the measurement on its sensor's clock, nanoseconds; none of a tick.
    pub fn stamp_ns(&self) -> Option<i64> {
        match self {
            Self::Imu(sample) => Some(sample.stamp_ns),
            Self::Wheels(reading) => Some(reading.stamp_ns),
            Self::Gnss(reading) => Some(reading.stamp_ns),
            Self::Frame(frame) => Some(frame.stamp_ns),
            Self::Tick => None,
        }
    }
}

/// What a source has beside the IMU.
#[expect(clippy::struct_excessive_bools, reason = "each is there or not, independently of the others")]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Contents {
    /// Number of frames, where it is known beforehand; for a progress display.
    pub frames: Option<usize>,
    /// Whether there are images.
    pub images: bool,
    /// Whether there are tracks. Without them a front end tracks points in the images.
    pub tracks: bool,
    /// Whether there are features for place recognition. Without them they are extracted from the images.
    pub features: bool,
    /// The readings of wheels, if there are any. They are used where the calibration states the geometry.
    pub wheels: Option<WheelReadings>,
    /// Whether there are positions of GNSS.
    pub gnss: bool,
}

/// What the readings of wheels are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WheelReadings {
    /// Angular speeds of the wheels.
    Speeds,
    /// Velocities of the base, as speeds of the wheels that [`WheelSensor::of_base_velocity`](crate::WheelSensor::of_base_velocity) states.
    BaseVelocities,
}

impl Contents {
    /// Counts a frame.
    pub(crate) fn add(&mut self, frame: &Frame) {
        *self.frames.get_or_insert_default() += 1;
        self.images |= !frame.images.is_empty();
        self.tracks |= !frame.tracks.is_empty();
        self.features |= !frame.features.is_empty();
    }
}

impl<S: SensorSource + ?Sized> SensorSource for Box<S> {
    fn name(&self) -> &str {
        (**self).name()
    }

    fn calibration(&self) -> &SensorCalibration {
        (**self).calibration()
    }

    fn contents(&self) -> Contents {
        (**self).contents()
    }

    fn next(&mut self) -> Result<Option<SensorEvent>, SensorError> {
        (**self).next()
    }

    fn live(&self) -> Option<LiveReport> {
        (**self).live()
    }

    fn stereo_pairs(&self) -> Option<PairCounts> {
        (**self).stereo_pairs()
    }

    fn tap_imu(&self) -> Option<Receiver<ImuSample>> {
        (**self).tap_imu()
    }
}
