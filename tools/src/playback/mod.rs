//! Publishes a recording as live sensors would.

mod native;
#[cfg(feature = "ros")]
mod ros;
mod side_readings;

pub use native::NativeTopics;
#[cfg(feature = "ros")]
pub use ros::RosTopics;

use anyhow::Result;
use onboard::StopSignal;
use protocol::sensors::{GnssMessage, WheelMessage};
use sensors::{CameraSensor, Frame, ImuSample, SensorEvent, SensorSource};
use side_readings::SideReadings;
use std::time::{Duration, Instant};

/// How often the player checks whether a robot listens, and how often it reports that none does.
const LOOK: Duration = Duration::from_millis(50);
const LOOKS_A_WARNING: u32 = 40;

/// What was published.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Published {
    /// Readings of the IMU.
    pub readings: usize,
    /// Frames: images or pairs of images, or tracks.
    pub frames: usize,
    /// Readings of the wheels.
    pub wheels: usize,
    /// Positions of GNSS.
    pub positions: usize,
}

/// The topics of a robot's sensors.
pub trait SensorTopics {
    /// Whether somebody listens to the IMU and to the frames.
    ///
    /// # Errors
    /// The session is closed.
    fn are_heard(&self) -> Result<bool>;

    /// Publishes what a robot needs before it listens to the sensors.
    ///
    /// # Errors
    /// The session is closed.
    fn prepare(&self) -> Result<()> {
        Ok(())
    }

    /// Why nobody listens.
    ///
    /// # Errors
    /// The session is closed.
    fn why_unheard(&self) -> Result<String>;

    /// Publishes a reading.
    ///
    /// # Errors
    /// The session is closed.
    fn reading(&self, reading: &ImuSample) -> Result<()>;

    /// Publishes a frame.
    ///
    /// # Errors
    /// An image that cannot be read, a session that is closed.
    fn frame(&self, frame: &Frame) -> Result<()>;

    /// Publishes a reading of the wheels.
    ///
    /// # Returns
    /// Whether there is a topic for it.
    ///
    /// # Errors
    /// The session is closed.
    fn wheels(&self, message: &WheelMessage) -> Result<bool> {
        let _ = message;
        Ok(false)
    }

    /// Publishes a position of GNSS.
    ///
    /// # Returns
    /// Whether there is a topic for it.
    ///
    /// # Errors
    /// The session is closed.
    fn gnss(&self, message: &GnssMessage) -> Result<bool> {
        let _ = message;
        Ok(false)
    }
}

/// Waits until a robot listens, or until `stop` is raised.
///
/// # Errors
/// The session is closed.
pub fn wait_for_robot(topics: &dyn SensorTopics, stop: &StopSignal) -> Result<()> {
    let mut looks = 0;
    while !stop.is_stopped() && !topics.are_heard()? {
        topics.prepare()?;
        looks += 1;
        if looks % LOOKS_A_WARNING == 0 {
            tracing::warn!("no robot listens yet: {}", topics.why_unheard()?);
        }
        std::thread::sleep(LOOK);
    }
    // What it subscribes to after these.
    std::thread::sleep(LOOK);
    Ok(())
}

/// Plays a source until its end, or until `stop` is raised.
///
/// # Arguments
/// * `rate`: 1 for the speed of the recording.
/// * `time_offset_ns`: subtracted from the stamps of frames: a calibrated offset, which the robot adds.
///
/// # Errors
/// A recording that cannot be read, a session that is closed.
pub fn play(
    topics: &dyn SensorTopics,
    source: &mut dyn SensorSource,
    rate: f64,
    time_offset_ns: i64,
    stop: &StopSignal,
) -> Result<Published> {
    let shifts_ns: Vec<i64> = source.calibration().cameras.iter().map(CameraSensor::stamp_shift_ns).collect();
    let mut side = SideReadings::new(source.calibration(), source.contents());
    let (mut published, begin, mut first_ns) = (Published::default(), Instant::now(), None);
    while let Some(event) = source.next()? {
        let Some(stamp_ns) = event.stamp_ns() else { continue };
        let since_ns = (stamp_ns - *first_ns.get_or_insert(stamp_ns)).max(0);
        stop.sleep_until(begin + Duration::from_secs_f64(since_ns as f64 * 1e-9 / rate));
        if stop.is_stopped() {
            break;
        }
        match event {
            SensorEvent::Imu(reading) => {
                topics.reading(&reading)?;
                published.readings += 1;
            }
            SensorEvent::Frame(frame) => {
                for part in as_stamped(frame, &shifts_ns) {
                    topics.frame(&Frame { stamp_ns: part.stamp_ns - time_offset_ns, ..part })?;
                }
                published.frames += 1;
            }
            SensorEvent::Wheels(reading) => published.wheels += usize::from(side.wheels(topics, &reading)?),
            SensorEvent::Gnss(reading) => published.positions += usize::from(side.gnss(topics, &reading)?),
            _ => {}
        }
    }
    Ok(published)
}

/// A frame in parts whose images have the stamps that their cameras gave them: each robot adds the calibrated shifts itself.
///
/// # Arguments
/// * `shifts_ns`: what was added to the stamps of each camera, nanoseconds.
fn as_stamped(mut frame: Frame, shifts_ns: &[i64]) -> Vec<Frame> {
    let mut parts = Vec::new();
    for (camera, &shift_ns) in shifts_ns.iter().enumerate().filter(|(_, shift_ns)| **shift_ns != 0) {
        if let Some(image) = frame.images.remove(&camera) {
            let images = [(camera, image)].into();
            parts.push(Frame { stamp_ns: frame.stamp_ns - shift_ns, images, ..Frame::default() });
        }
    }
    if parts.is_empty() || !frame.images.is_empty() || !frame.tracks.is_empty() {
        parts.push(frame);
    }
    parts
}
