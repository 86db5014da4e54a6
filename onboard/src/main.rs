//! The robot program: plays live sensors or a recording through the estimator, and localizes it in the map of a map server.
#![cfg_attr(test, allow(clippy::unwrap_used))]

use anyhow::{Context as _, Result, bail};
use client::session::{Member, Role, close_session, open_session};
use client::{SessionOptions, without_secrets};
use estimator::MapMode;
use geometry::Camera;
use monitoring::{MonitoringServer, start_log};
use onboard::arguments::{DEFAULT_ROBOT, LiveArguments, Source};
use onboard::cli::Arguments;
use onboard::native::{NativeSensors, NativeStreams};
use onboard::outputs::{BaseMount, RosOutput};
use onboard::ros_camera_info::wait_for_cameras;
use onboard::ros_mount::find_base;
use onboard::ros_sensors::{RosSensors, RosTopics};
use onboard::stop::NetworkRuntime;
use onboard::{
    EndedLost, MapLink, OpeningLink, Outcome, RobotArguments, RobotLink, RobotMetrics, StopSignal, progress,
    run_robot_until, run_source_until, stdout,
};
use prometheus_client::registry::Registry;
use sensors::live::{LiveSettings, LiveSource};
use sensors::{
    CalibrationFiles, GnssIntake, Recording, SensorCalibration, WheelIntake, WheelReadings,
    read_rig_calibration, states_intrinsics,
};
use std::net::SocketAddr;
use std::path::Path;
use std::process::ExitCode;
use std::time::Duration;
use tracing_subscriber::EnvFilter;

/// Log filter: warnings, without Zenoh's about a network that is still being discovered, but with why it does not connect.
const QUIET: &str = "warn,client::session=info,zenoh=error,zenoh::net::runtime::orchestrator=warn";
/// Log filter in real time: changes of the state and a line a minute as well.
const REALTIME: &str =
    "warn,onboard=info,robot=info,client::session=info,zenoh=error,zenoh::net::runtime::orchestrator=warn";

/// A session that takes longer to open is reported, each time.
const SESSION_WARNING: Duration = Duration::from_secs(2);

fn main() -> ExitCode {
    stdout::end_quietly_when_closed();
    match localize() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {}", client::error_line(error.as_ref()));
            if error.is::<EndedLost>() { ExitCode::from(EndedLost::EXIT_CODE) } else { ExitCode::FAILURE }
        }
    }
}

fn localize() -> Result<()> {
    let Some(mut arguments) = Arguments::read()? else { return Ok(()) };
    let is_live = arguments.source != Source::Recording;
    if arguments.source != Source::Native && arguments.live.session().is_some() {
        bail!("--sensors-listen and --sensors-connect are for --source native")
    }
    let quiet = if arguments.robot.realtime || is_live { REALTIME } else { QUIET };
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(quiet));
    start_log(without_secrets(filter), arguments.log_format);
    if let Some(folder) = &arguments.session.secure {
        // Not given is what the default says.
        let given = Some(arguments.robot.robot.as_str()).filter(|name| *name != DEFAULT_ROBOT);
        arguments.robot.robot = Member::expect(folder, Role::Robot, ("--robot", given))?;
    }
    let stop = StopSignal::on_interrupt().context("signals cannot be handled")?;
    let runtime = NetworkRuntime::new()?;
    let monitoring = match arguments.monitoring {
        Some(address) => Some(runtime.block_on(start_monitoring(address, &arguments.robot.metrics))?),
        None => None,
    };
    let input = Input::open(&arguments, &stop, &runtime)?;
    let body = arguments
        .ros
        .body(arguments.robot.imu_in_base_link, input.base_mount(&arguments, &stop, &runtime)?)?;
    let map_expected = arguments.robot.map_mode()? != MapMode::Odometry;
    let robot = &arguments.robot;
    let settings = arguments.ros.settings(&body, &robot.robot, map_expected, !is_live, &robot.initial_poses);
    let ros = settings.map(|settings| RosOutput::start(settings, runtime.handle())).transpose();
    let (topics, ros_task) = ros.context("--ros2")?.unzip();
    arguments.robot.ros = topics;
    arguments.robot.body = body;
    let outcome = match input {
        Input::Recording(recording) => play_recording(&stop, *recording, &arguments, &runtime)?,
        Input::Native => play_native(&stop, &arguments, &runtime)?,
        Input::Ros2(input) => play_ros2(&stop, *input, &arguments, &runtime)?,
    };
    arguments.robot.ros = None;
    if let Some(task) = ros_task {
        runtime.block_on(task.finish());
    }
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&outcome.summary)?);
    } else {
        print!("{}", progress::report(&outcome.summary));
        println!("written to {}", arguments.robot.out.display());
    }
    if let Some(monitoring) = monitoring {
        runtime.block_on(monitoring.stop());
    }
    if let Some(reason) = &outcome.summary.ended_early {
        bail!("the run ended early: {reason}");
    }
    outcome.summary.check_end()?;
    Ok(())
}

/// The map's name; `None` with `--mode odometry`.
fn map_of(arguments: &Arguments) -> Result<Option<&str>> {
    match (&arguments.map, arguments.robot.map_mode()?) {
        (_, MapMode::Odometry) => Ok(None),
        (None, _) => {
            bail!("--map NAME is missing: give the name of the map on the server, or use --mode odometry")
        }
        (Some(map), _) => Ok(Some(map)),
    }
}

/// Where measurements come from.
enum Input {
    Recording(Box<Recording<'static>>),
    Native,
    Ros2(Box<RosInput>),
}

/// The topics of ROS 2, and the session that they come over.
struct RosInput {
    topics: RosTopics,
    session: zenoh::Session,
    /// Calibration and settings, where the files alone state them.
    from_files: Option<(SensorCalibration, LiveSettings)>,
}

impl Input {
    fn open(arguments: &Arguments, stop: &StopSignal, runtime: &NetworkRuntime) -> Result<Self> {
        Ok(match (arguments.source, &arguments.sequence) {
            (Source::Recording, Some(sequence)) => {
                arguments.live.warn_of_recording();
                let files = arguments.robot.recording_files(&arguments.calibration)?;
                Self::Recording(Box::new(Recording::open_with(sequence, &files)?))
            }
            (Source::Recording, None) => bail!("--sequence REC is missing"),
            (Source::Native, _) => Self::Native,
            (Source::Ros2, _) => {
                warn_of_recording(arguments, "ros2");
                Self::Ros2(Box::new(RosInput::open(arguments, stop, runtime)?))
            }
        })
    }

    /// Where the robot's frame is on the IMU, as transforms state it; not looked for where nobody needs it.
    fn base_mount(
        &self,
        arguments: &Arguments,
        stop: &StopSignal,
        runtime: &NetworkRuntime,
    ) -> Result<Option<BaseMount>> {
        let is_needed = arguments.ros.ros2 || arguments.robot.record.is_some();
        if !is_needed || arguments.robot.imu_in_base_link.is_some() {
            return Ok(None);
        }
        let base = &arguments.ros.frames.base_link;
        match self {
            Self::Recording(recording) => Ok(recording.imu_from_base(base).map(BaseMount::known)),
            Self::Native => Ok(None),
            Self::Ros2(input) => {
                let RosInput { topics, session, .. } = &**input;
                let node = arguments.ros.sensor_node();
                let found = find_base(session.clone(), node, &topics.imu, base, stop);
                Ok(Some(runtime.block_on(found)?))
            }
        }
    }
}

impl RosInput {
    fn open(arguments: &Arguments, stop: &StopSignal, runtime: &NetworkRuntime) -> Result<Self> {
        let mut topics = RosTopics::of(&arguments.calibration)?;
        let has_intrinsics = states_intrinsics(calibration_path(arguments)?)?;
        // Faults of the files are reported before the session is opened.
        let mut from_files =
            has_intrinsics.then(|| live_settings(arguments, &[], &topics.cameras)).transpose()?;
        if let Some((calibration, _)) = &mut from_files {
            topics.add_wheels_and_gnss(&arguments.robot, calibration)?;
        }
        let Some(session) = open_until(stop, &arguments.ros.session(), runtime)? else {
            bail!("interrupted before {} answered", arguments.ros.ros2_connect)
        };
        Ok(Self { topics, session, from_files })
    }
}

fn play_recording(
    stop: &StopSignal,
    recording: Recording<'_>,
    arguments: &Arguments,
    runtime: &NetworkRuntime,
) -> Result<Outcome> {
    let link = opening_link(arguments, runtime)?;
    let bar = progress::frame_bar(recording.contents().frames);
    let show = |frame| bar.set_position(frame as u64);
    let outcome = run_robot_until(stop, recording, &arguments.robot, link, show)?;
    bar.finish_and_clear();
    Ok(outcome)
}

/// The file or folder with the calibration of live sensors.
fn calibration_path(arguments: &Arguments) -> Result<&Path> {
    let path = arguments.calibration.calibration.as_deref();
    path.context(
        "--calibration is missing: live sensors need Kalibr's camchain-imucam.yaml, or a folder with the calibration",
    )
}

/// The calibration of live sensors, and how they are taken.
///
/// # Arguments
/// * `known`: projections of the cameras, where the calibration may leave them out.
/// * `topics`: of the cameras, where they are topics of ROS.
fn live_settings(
    arguments: &Arguments,
    known: &[Camera],
    topics: &[String],
) -> Result<(SensorCalibration, LiveSettings)> {
    let imu = arguments.calibration.imu_calibration.as_deref();
    let calibration = read_rig_calibration(calibration_path(arguments)?, imu, known, topics)?;
    let mut settings = arguments.live.settings(&calibration, &arguments.robot)?;
    settings.imu_units = arguments.calibration.imu_units();
    if let Some(tolerance_ns) = arguments.calibration.pair_tolerance_ns() {
        settings.pair_tolerance_ns = tolerance_ns;
    }
    Ok((calibration.sensors, settings))
}

/// Names the switches that concern other sources than Zenoh.
fn warn_of_topics(arguments: &Arguments) {
    let RobotArguments { wheels, gnss, .. } = &arguments.robot;
    let mut named = arguments.calibration.files();
    named.wheel_topic.clone_from(&wheels.wheel_topic);
    named.gnss_topic.clone_from(&gnss.gnss_topic);
    for topic in named.topics() {
        tracing::warn!(
            topic,
            "--source native has keys of its own, robot/NAME/sensors/...: this topic is not used"
        );
    }
    warn_of_recording(arguments, "native");
}

/// Says that a recording is not played where a source of live sensors is named, too.
fn warn_of_recording(arguments: &Arguments, source: &str) {
    if let Some(sequence) = &arguments.sequence {
        let sequence = sequence.display();
        tracing::warn!(%sequence, "--source {source} takes live sensors: this recording is not played");
    }
}

fn play_native(stop: &StopSignal, arguments: &Arguments, runtime: &NetworkRuntime) -> Result<Outcome> {
    let (calibration, mut settings) = live_settings(arguments, &[], &[])?;
    let RobotArguments { wheels, gnss, .. } = &arguments.robot;
    let (has_wheels, has_gnss) = arguments.robot.expected(&calibration)?;
    settings.wheels = has_wheels.then_some(WheelReadings::Speeds);
    settings.gnss = has_gnss;
    let mut files = CalibrationFiles::default();
    wheels.name_topic(&mut files)?;
    warn_of_topics(arguments);
    let wanted = NativeStreams {
        streams: LiveArguments::streams(&settings),
        wheels: WheelIntake::new(calibration.wheels.as_ref(), &files),
        gnss: GnssIntake::new(&gnss.live_sensor(calibration.gnss)?),
    };
    let map = map_of(arguments)?;
    let robot = &arguments.robot.robot;
    let (inputs, mut source) = LiveSource::new(format!("live sensors of {robot}"), calibration, &settings);
    let own = arguments.live.session();
    let options = own.clone().unwrap_or_else(|| arguments.session.connecting());
    let Some(session) = open_until(stop, &options, runtime)? else {
        let place = own.map_or_else(|| arguments.session.place(), |own| own.connect.join(", "));
        bail!("interrupted before {place} answered")
    };
    let sensors = NativeSensors::subscribe(&session, runtime.handle(), robot, &wanted, &inputs)?;
    let (of_link, handle) = (session.clone(), runtime.handle().clone());
    let link = match map {
        // The sensors need no map server.
        Some(_) if own.is_some() => opening_link(arguments, runtime)?,
        Some(map) => {
            Some(RobotLink::Open(MapLink { session: of_link, runtime: handle, map: map.to_owned() }))
        }
        None => Some(RobotLink::Network { session: of_link, runtime: handle }),
    };
    let outcome = run_source_until(stop, &mut source, &arguments.robot, link, |_| {});
    drop(sensors);
    runtime.block_on(close_session(&session));
    outcome
}

fn play_ros2(
    stop: &StopSignal,
    input: RosInput,
    arguments: &Arguments,
    runtime: &NetworkRuntime,
) -> Result<Outcome> {
    let RosInput { mut topics, session, from_files } = input;
    let (calibration, mut settings) = if let Some(settings) = from_files {
        settings
    } else {
        let cameras = wait_for_cameras(session.clone(), arguments.ros.sensor_node(), &topics.cameras, stop);
        let mut read = live_settings(arguments, &runtime.block_on(cameras)?, &topics.cameras)?;
        topics.add_wheels_and_gnss(&arguments.robot, &mut read.0)?;
        read
    };
    topics.adapt(&mut settings)?;
    let (inputs, mut source) = LiveSource::new("ROS 2 topics", calibration, &settings);
    let subscribed = RosSensors::start(session.clone(), arguments.ros.sensor_node(), &topics, &inputs);
    let sensors = runtime.block_on(subscribed).context("the topics of the sensors")?;
    let link = opening_link(arguments, runtime)?;
    let outcome = run_source_until(stop, &mut source, &arguments.robot, link, |_| {});
    drop(sensors);
    runtime.block_on(close_session(&session));
    outcome
}

/// The robot's link to its map, which opens while the robot runs; `None` with `--mode odometry`.
fn opening_link(arguments: &Arguments, runtime: &NetworkRuntime) -> Result<Option<RobotLink>> {
    let open = |map| OpeningLink::open(arguments.session.connecting(), runtime.handle().clone(), map);
    let link = map_of(arguments)?.map(open).transpose().context("the Zenoh session cannot be opened")?;
    Ok(link.map(RobotLink::Opening))
}

/// Opens the session that the sensors come over; `None` where the program is told to stop before.
fn open_until(
    stop: &StopSignal,
    options: &SessionOptions,
    runtime: &NetworkRuntime,
) -> Result<Option<zenoh::Session>> {
    let opened = async {
        let opening = open_session(options);
        tokio::pin!(opening);
        loop {
            if let Ok(session) = tokio::time::timeout(SESSION_WARNING, &mut opening).await {
                return session.context("the Zenoh session cannot be opened");
            }
            tracing::warn!(connect = options.connect.join(", "), "no router and no peer answers yet");
        }
    };
    runtime.block_on(stop.until(opened)).transpose()
}

/// Serves the metrics of a run.
async fn start_monitoring(address: SocketAddr, metrics: &RobotMetrics) -> Result<MonitoringServer> {
    let mut registry = Registry::with_prefix("driftless");
    metrics.register(&mut registry);
    let health = metrics.clone();
    MonitoringServer::start(address, registry, move || health.health()).await.context("--monitoring")
}
