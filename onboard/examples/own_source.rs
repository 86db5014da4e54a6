//! A robot on a custom sensor source: here a device at rest that delivers an IMU reading every 5 ms and tracks of no
//! points every 100 ms, for five seconds.
//!
//! ```text
//! cargo run -p driftless-onboard --example own_source -- OUT
//! ```

use nalgebra::Vector3;
use onboard::arguments::Mode;
use onboard::{RobotArguments, StopSignal, run_source_until};
use sensors::{Contents, Frame, ImuSample, SensorCalibration, SensorError, SensorEvent, SensorSource};
use simulation::{SimulationOptions, simulate};

const READING_NS: i64 = 5_000_000;
const READINGS_A_FRAME: i64 = 20;
const END_NS: i64 = 5_000_000_000;

struct Device {
    calibration: SensorCalibration,
    now_ns: i64,
    /// A frame is due at this time.
    frame_is_due: bool,
}

impl SensorSource for Device {
    fn name(&self) -> &'static str {
        "device"
    }

    fn calibration(&self) -> &SensorCalibration {
        &self.calibration
    }

    /// With `images: true` the robot tracks points and extracts features itself.
    fn contents(&self) -> Contents {
        Contents { tracks: true, ..Contents::default() }
    }

    /// A driver waits here for the next measurement; readings and frames come in the order of time.
    fn next(&mut self) -> Result<Option<SensorEvent>, SensorError> {
        if std::mem::take(&mut self.frame_is_due) {
            return Ok(Some(SensorEvent::Frame(Frame { stamp_ns: self.now_ns, ..Frame::default() })));
        }
        self.now_ns += READING_NS;
        self.frame_is_due = self.now_ns % (READINGS_A_FRAME * READING_NS) == 0;
        let reading = ImuSample {
            stamp_ns: self.now_ns,
            gyroscope: Vector3::zeros(),
            accelerometer: Vector3::new(0.0, 0.0, 9.81),
        };
        Ok((self.now_ns <= END_NS).then_some(SensorEvent::Imu(reading)))
    }
}

fn main() -> anyhow::Result<()> {
    let out = std::env::args().nth(1).unwrap_or_else(|| "own_source".to_owned());
    // A calibration as `sensors::Recording` reads it from sensor.yaml or Kalibr's files; here the simulation's.
    let simulated = simulate(&SimulationOptions { duration_s: Some(1.0), ..SimulationOptions::default() })?;
    let mut device = Device { calibration: simulated.live.calibration(), now_ns: 0, frame_is_due: false };
    let mut arguments = RobotArguments::with_defaults(out.as_ref())?;
    arguments.mode = Some(Mode::Odometry);
    // Raised by another thread with `stop.stop()`; `StopSignal::on_interrupt` is raised by Ctrl-C.
    let stop = StopSignal::default();
    let outcome = run_source_until(&stop, &mut device, &arguments, None, |_frame| {})?;
    println!("{}", onboard::progress::report(&outcome.summary));
    Ok(())
}
