//! A robot in a program: images and readings of the IMU, the map of a server, the filter, and what comes out.
//!
//! ```text
//! map_server --map hall=hall.db --listen tcp/127.0.0.1:7447
//! cargo run --release -p driftless-robot --example own_robot -- RECORDING MAP [ENDPOINT]
//! ```
//! A recording stands for the robot's sensors here: a driver implements `SensorSource`, or hands its measurements to a
//! `sensors::live::LiveSource`.

use client::{DEFAULT_ENDPOINT, SessionOptions};
use estimator::Localization;
use robot::stop::{NetworkRuntime, StopSignal};
use robot::{Estimate, OpeningLink, Output, Robot, RobotSettings, StatusReport, estimator_config};
use sensors::{Recording, SensorSource as _};
use std::error::Error;
use vision::features::{DEFAULT_EXTRACTOR, open};

const USAGE: &str = "usage: own_robot RECORDING MAP [ENDPOINT]";
/// Features of an image that the map is searched for.
const MAX_FEATURES: usize = 1000;

/// Prints where the robot is and how it is; a real one steers by it.
#[derive(Default)]
struct Print {
    last: Option<Localization>,
}

impl Output for Print {
    fn estimate(&mut self, estimate: &Estimate) {
        let (frame, pose) = match estimate.trusted() {
            Some(global) => ("map", global.global_from_imu),
            None => ("odometry", estimate.motion.local_from_imu()),
        };
        let position = pose.pose.translation;
        // Of the error [δθ, δp]: rad, then metres.
        let sigma = pose.covariance.diagonal().map(f64::sqrt);
        println!(
            "{} ns: {:.3} {:.3} {:.3} m in {frame}, sigma {:.3} {:.3} {:.3} m and {:.2} deg of heading",
            estimate.motion.stamp_ns,
            position.x,
            position.y,
            position.z,
            sigma[3],
            sigma[4],
            sigma[5],
            sigma[2].to_degrees()
        );
    }

    fn status(&mut self, report: &StatusReport) {
        let now = report.status.localization;
        if self.last.replace(now) != Some(now) {
            println!("{now:?}: {}", report.status.reason);
        }
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let (recording, map) = arguments.next().zip(arguments.next()).ok_or(USAGE)?;
    let connect = vec![arguments.next().unwrap_or_else(|| DEFAULT_ENDPOINT.to_owned())];

    let recording = Recording::open(recording.as_ref())?;
    let mut source = recording.source()?;
    let estimator = estimator_config(source.calibration()).ok_or("the calibration has no IMU")?;
    let mut settings = RobotSettings::new(estimator);
    settings.name = String::from("cart7");
    settings.realtime = true;
    settings.stop = StopSignal::on_interrupt()?;

    // Where no server answers yet, this goes on in the background, and the robot starts with odometry.
    let runtime = NetworkRuntime::new()?;
    let session = SessionOptions { connect, ..SessionOptions::default() };
    let link = OpeningLink::open(session, runtime.handle().clone(), &map)?;

    let mut robot = Robot::new(&mut source, settings)?;
    robot.add_output(Print::default());
    robot.connect(link)?;
    robot.extract_features(open(DEFAULT_EXTRACTOR, None)?, MAX_FEATURES, Vec::new())?;
    let report = robot.run(|_frame| {});
    let queries = report.queries;
    println!("{} images; {} of {} queries corrected the pose", report.frames, queries.accepted, queries.sent);
    report.ended_early.map_or(Ok(()), |reason| Err(reason.into()))
}
