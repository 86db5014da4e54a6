//! What a robot gives out, and to whom: [`Output`].

use super::estimate::{Estimate, StatusReport};
use super::event::Event;
use super::report::RunReport;
use client::MatchAnswer;
use estimator::{MapReport, Motion, TrackObservation};
use geometry::PoseWithCovariance;
use protocol::FeatureSet;
use sensors::live::Stream;
use sensors::{Frame, GnssReading, ImuSample, WheelReading};
use std::error::Error;
use tokio::runtime::Handle;

/// Hands on a motion that is predicted at the rate of the IMU, without waiting. Called on the prediction's own thread.
pub type PublishMotion = Box<dyn Fn(&Motion) + Send>;

/// The connection of a robot to its network, once it is open.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct Connection<'a> {
    /// The session, which stays open until the outputs have ended.
    pub session: &'a zenoh::Session,
    /// The runtime that the session lives on.
    pub runtime: &'a Handle,
    /// Name of the robot.
    pub robot: &'a str,
    /// Name of the map; `None` for a robot without one.
    pub map: Option<&'a str>,
}

impl<'a> Connection<'a> {
    pub(crate) fn new(
        session: &'a zenoh::Session,
        runtime: &'a Handle,
        robot: &'a str,
        map: Option<&'a str>,
    ) -> Self {
        Self { session, runtime, robot, map }
    }
}

/// Takes what a robot gives out: a publisher, a recorder, a display, the controller of the program that embeds it.
///
/// A run calls all its outputs on the thread of its estimator, in the order in which they were added. A method that waits
/// (for a network, a disk, a lock) delays the next image. Each does nothing unless it is implemented.
///
/// # Order
/// [`begin`](Output::begin) comes with the first image. Of an image come [`frame`](Output::frame), [`tracks`](Output::tracks), then
/// [`correct`](Output::correct) where GNSS or a change of the map corrected the pose, then
/// [`features`](Output::features), [`correct`](Output::correct), [`answer`](Output::answer) and [`query`](Output::query) for each answer of the map, then
/// [`estimate`](Output::estimate), then [`status`](Output::status). [`end`](Output::end) is the last.
///
/// # Times
/// All are nanoseconds on the clock of the estimator, which never jumps. To obtain those of the sensors, add the newest
/// [`clock shift`](Output::set_clock_shift).
///
/// # Example
/// ```
/// use robot::{Estimate, Output, StatusReport};
///
/// /// Drives only while the robot knows where it is.
/// #[derive(Default)]
/// struct Brake {
///     is_released: bool,
/// }
///
/// impl Output for Brake {
///     fn status(&mut self, report: &StatusReport) {
///         self.is_released = report.status.localization.is_usable();
///     }
/// }
/// ```
pub trait Output {
    /// The robot is connected, now or from the start. Called once at most, and never for a robot without a network.
    ///
    /// # Errors
    /// This output cannot use the connection. The robot then runs without a map.
    fn connect(&mut self, connection: &Connection<'_>) -> Result<(), Box<dyn Error + Send + Sync>> {
        let _ = connection;
        Ok(())
    }

    /// The first image has come: its time, nanoseconds.
    fn begin(&mut self, stamp_ns: i64) {
        let _ = stamp_ns;
    }

    /// A reading of the IMU was read, good or bad.
    fn reading(&mut self, reading: &ImuSample) {
        let _ = reading;
    }

    /// A reading of the wheels goes to the estimator.
    fn wheels(&mut self, reading: &WheelReading) {
        let _ = reading;
    }

    /// A position of GNSS goes to the estimator.
    fn gnss(&mut self, reading: &GnssReading) {
        let _ = reading;
    }

    /// An image is about to be processed.
    fn frame(&mut self, frame: &Frame) {
        let _ = frame;
    }

    /// The tracked points of an image, as they go to the estimator, whether it is initialized or not.
    ///
    /// # Arguments
    /// * `stamp_ns`: time of the image, nanoseconds.
    fn tracks(&mut self, stamp_ns: i64, tracks: &[TrackObservation]) {
        let _ = (stamp_ns, tracks);
    }

    /// The features of an image that the map is to be asked about, when they are extracted: some images later.
    ///
    /// # Arguments
    /// * `stamp_ns`: time of the image, nanoseconds.
    /// * `camera`: which camera took it.
    fn features(&mut self, stamp_ns: i64, camera: usize, features: &FeatureSet) {
        let _ = (stamp_ns, camera, features);
    }

    /// The map answered about an image: what comes before [`query`](Output::query) where there is an answer.
    ///
    /// # Arguments
    /// * `stamp_ns`: time of the image, nanoseconds.
    /// * `camera`: which camera took it.
    /// * `report`: of the update of the estimator; `None` without a match, or where the estimator was initialized again meanwhile.
    fn answer(&mut self, stamp_ns: i64, camera: usize, answer: &MatchAnswer, report: Option<&MapReport>) {
        let _ = (stamp_ns, camera, answer, report);
    }

    /// Where the robot is, at every image from the initialization on.
    fn estimate(&mut self, estimate: &Estimate) {
        let _ = estimate;
    }

    /// The map corrected the last estimate before the next image came: this one replaces it. Only where a recording is played
    /// as fast as possible.
    fn revise(&mut self, estimate: &Estimate) {
        let _ = estimate;
    }

    /// How the robot is: at every image, while there is no estimate as well, and a few times a second where a live source
    /// has no images: once the newest estimate is older than a second, the robot is lost until the next one.
    fn status(&mut self, report: &StatusReport) {
        let _ = report;
    }

    /// Where odometry at the rate of the IMU goes until the next estimate; `None` where it is of no use. Called after every
    /// estimate of a live source.
    fn predicted(&self) -> Option<PublishMotion> {
        None
    }

    /// The map, a change of it or GNSS corrected the pose of the IMU in L, at one time: the robot has not moved, only its pose in L
    /// jumps.
    ///
    /// # Arguments
    /// * `before`, `after`: `local_from_imu`, with covariances `[δθ, δp]` in L (rad, metres).
    fn correct(&mut self, before: &PoseWithCovariance, after: &PoseWithCovariance) {
        let _ = (before, after);
    }

    /// The estimator diverged and starts again: poses that follow are in another odometry frame L.
    fn restart(&mut self) {}

    /// A query to the map has ended, with an answer or without.
    fn query(&mut self, event: &Event) {
        let _ = event;
    }

    /// The clocks of the sensors jumped: add this to all times from now on, nanoseconds, to obtain those of the sensors. It is
    /// zero until this is called.
    fn set_clock_shift(&mut self, shift_ns: i64) {
        let _ = shift_ns;
    }

    /// These streams of a live source come with best effort: messages may be missing.
    fn set_best_effort(&mut self, streams: &[Stream]) {
        let _ = streams;
    }

    /// What is wrong with this output while the run continues: an alarm, and part of the status. `None` where nothing is.
    fn fault(&self) -> Option<&str> {
        None
    }

    /// The run is over. The session is closed once all outputs have ended.
    fn end(&mut self, report: &RunReport) {
        let _ = report;
    }
}

/// Whoever lends an output to a robot has it back after the run.
impl<O: Output + ?Sized> Output for &mut O {
    fn connect(&mut self, connection: &Connection<'_>) -> Result<(), Box<dyn Error + Send + Sync>> {
        (**self).connect(connection)
    }

    fn begin(&mut self, stamp_ns: i64) {
        (**self).begin(stamp_ns);
    }

    fn reading(&mut self, reading: &ImuSample) {
        (**self).reading(reading);
    }

    fn wheels(&mut self, reading: &WheelReading) {
        (**self).wheels(reading);
    }

    fn gnss(&mut self, reading: &GnssReading) {
        (**self).gnss(reading);
    }

    fn frame(&mut self, frame: &Frame) {
        (**self).frame(frame);
    }

    fn tracks(&mut self, stamp_ns: i64, tracks: &[TrackObservation]) {
        (**self).tracks(stamp_ns, tracks);
    }

    fn features(&mut self, stamp_ns: i64, camera: usize, features: &FeatureSet) {
        (**self).features(stamp_ns, camera, features);
    }

    fn answer(&mut self, stamp_ns: i64, camera: usize, answer: &MatchAnswer, report: Option<&MapReport>) {
        (**self).answer(stamp_ns, camera, answer, report);
    }

    fn estimate(&mut self, estimate: &Estimate) {
        (**self).estimate(estimate);
    }

    fn revise(&mut self, estimate: &Estimate) {
        (**self).revise(estimate);
    }

    fn status(&mut self, report: &StatusReport) {
        (**self).status(report);
    }

    fn predicted(&self) -> Option<PublishMotion> {
        (**self).predicted()
    }

    fn correct(&mut self, before: &PoseWithCovariance, after: &PoseWithCovariance) {
        (**self).correct(before, after);
    }

    fn restart(&mut self) {
        (**self).restart();
    }

    fn query(&mut self, event: &Event) {
        (**self).query(event);
    }

    fn set_clock_shift(&mut self, shift_ns: i64) {
        (**self).set_clock_shift(shift_ns);
    }

    fn set_best_effort(&mut self, streams: &[Stream]) {
        (**self).set_best_effort(streams);
    }

    fn fault(&self) -> Option<&str> {
        (**self).fault()
    }

    fn end(&mut self, report: &RunReport) {
        (**self).end(report);
    }
}

/// The outputs of a run.
#[derive(Default)]
pub(crate) struct Outputs<'a>(Vec<Box<dyn Output + 'a>>);

impl<'a> Outputs<'a> {
    pub(crate) fn add(&mut self, output: impl Output + 'a) {
        self.0.push(Box::new(output));
    }

    /// Calls all of them.
    pub(crate) fn each(&mut self, mut call: impl FnMut(&mut dyn Output)) {
        for output in &mut self.0 {
            call(output.as_mut());
        }
    }

    /// Connects all of them.
    ///
    /// # Errors
    /// That of the first which cannot use the connection; those after it are not connected.
    pub(crate) fn connect(
        &mut self,
        connection: &Connection<'_>,
    ) -> Result<(), Box<dyn Error + Send + Sync>> {
        self.0.iter_mut().try_for_each(|output| output.connect(connection))
    }

    /// Where predicted motions go.
    pub(crate) fn predicted(&self) -> Vec<PublishMotion> {
        self.0.iter().filter_map(|output| output.predicted()).collect()
    }

    /// What is wrong with some of them, with their number.
    pub(crate) fn faults(&self) -> impl Iterator<Item = (usize, &str)> {
        self.0.iter().enumerate().filter_map(|(at, output)| Some((at, output.fault()?)))
    }

    /// Ends and drops one after the other.
    pub(crate) fn end(&mut self, report: &RunReport) {
        for mut output in self.0.drain(..) {
            output.end(report);
        }
    }
}
