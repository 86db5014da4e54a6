//! All that a live source does, without threads and clocks of its own: messages in, events in order of time out.

use super::assembly::{Assembly, PendingFrame};
use super::fault::{FaultKind, FaultLog, LiveFault};
use super::image::LiveImage;
use super::lane::{Jump, Lane};
use super::reorder::Reorder;
use super::repetition::{Compared, Repetition};
use super::settings::{LiveFrames, LiveSettings};
use super::side_stream::SideStream;
use super::stream::{Stream, check_stamp};
use crate::imu_intake::ImuIntake;
use crate::{
    CameraSensor, GnssReading, ImuSample, PairCounts, SensorCalibration, TrackObservation, WheelReading,
    camera_groups, push_newest,
};
use protocol::FeatureSet;
use std::collections::{BTreeMap, VecDeque};
use std::sync::mpsc::SyncSender;
use std::time::Duration;

/// Frames that wait for readings of the IMU: two seconds at 20 Hz.
const MAX_WAITING_FOR_IMU: usize = 40;
/// Readings that wait for the estimator: 80 minutes at 200 Hz, 60 MB. Beyond, the reader is taken to be gone.
const MAX_READINGS: usize = 1 << 20;

/// What is ready.
#[derive(Debug, PartialEq)]
pub(super) enum Ready {
    Imu(ImuSample),
    Wheels(WheelReading),
    Gnss(GnssReading),
    Frame(i64, PendingFrame),
}

/// Messages on their way to the estimator.
#[derive(Debug)]
pub(super) struct LiveBuffer {
    max_waiting_frames: usize,
    camera_offset_ns: i64,
    /// Added besides to those of each camera, nanoseconds.
    stamp_shifts_ns: Vec<i64>,
    imu_intake: ImuIntake,
    imu: Lane<ImuSample>,
    cameras: Vec<Lane<LiveImage>>,
    tracks: Option<Lane<PendingFrame>>,
    wheels: Option<SideStream<WheelReading>>,
    gnss: Option<SideStream<GnssReading>>,
    /// Of each camera.
    repetitions: Vec<Repetition>,
    newest_jump: Option<Jump>,
    reorder: Reorder<ImuSample>,
    assembly: Assembly,
    /// In order of time, not returned yet.
    readings: VecDeque<ImuSample>,
    frames: VecDeque<(i64, PendingFrame)>,
    /// Time of the newest reading in order.
    imu_until_ns: i64,
    faults: FaultLog,
    /// Gets every reading in order as soon as it is there.
    tap: Option<SyncSender<ImuSample>>,
    /// Streams whose publishers offer best effort.
    best_effort: Vec<Stream>,
}

impl LiveBuffer {
    pub(super) fn new(calibration: &SensorCalibration, settings: &LiveSettings) -> Self {
        let (cameras, tracks): (Vec<_>, _) = match settings.frames {
            LiveFrames::Images => {
                let sensors = calibration.cameras.iter().take(settings.cameras).enumerate();
                let lane = |(index, sensor): (usize, &crate::CameraSensor)| {
                    let stated_hz = Some(sensor.rate_hz).filter(|_| settings.camera_rate_is_stated);
                    Lane::new(Stream::Camera(index), stated_hz)
                };
                (sensors.map(lane).collect(), None)
            }
            LiveFrames::Tracks { .. } => (Vec::new(), Some(Lane::new(Stream::Tracks, None))),
        };
        let groups = camera_groups(&calibration.cameras[..cameras.len()]);
        Self {
            max_waiting_frames: settings.max_waiting_frames.max(1),
            camera_offset_ns: settings.camera_offset_ns,
            stamp_shifts_ns: calibration.cameras.iter().map(CameraSensor::stamp_shift_ns).collect(),
            imu_intake: ImuIntake::new(settings.imu_units, calibration.imu.as_ref()),
            imu: Lane::new(Stream::Imu, calibration.imu.as_ref().map(|imu| imu.rate_hz)),
            repetitions: cameras.iter().map(|_| Repetition::default()).collect(),
            cameras,
            tracks,
            wheels: settings.wheels.map(|_| SideStream::new(Stream::Wheels)),
            gnss: settings.gnss.then(|| SideStream::new(Stream::Gnss)),
            newest_jump: None,
            reorder: Reorder::new(),
            assembly: Assembly::new(groups, settings.pair_tolerance_ns),
            readings: VecDeque::new(),
            frames: VecDeque::new(),
            imu_until_ns: i64::MIN,
            faults: FaultLog::default(),
            tap: None,
            best_effort: Vec::new(),
        }
    }

    /// Every reading goes to `tap` as soon as those before it are there; one that does not fit is left out there.
    pub(super) fn set_tap(&mut self, tap: SyncSender<ImuSample>) {
        self.tap = Some(tap);
    }

    pub(super) fn set_best_effort(&mut self, stream: Stream) {
        if !self.best_effort.contains(&stream) {
            self.best_effort.push(stream);
        }
    }

    pub(super) fn best_effort(&self) -> &[Stream] {
        &self.best_effort
    }

    pub(super) fn imu(&mut self, reading: ImuSample, now: Duration) {
        self.imu.arrived(now);
        let reading = self.imu_intake.take(reading);
        if !reading.gyroscope.iter().chain(&reading.accelerometer).all(|value| value.is_finite()) {
            let problem = "readings are not finite, and are not used; check the sensor".to_owned();
            return self.faults.note(Stream::Imu, FaultKind::NotFinite, now, problem);
        }
        if !check_stamp(Stream::Imu, reading.stamp_ns, now, &mut self.faults) {
            return;
        }
        let message = (reading.stamp_ns, reading);
        for (stamp_ns, reading) in self.imu.admit(message, now, &mut self.newest_jump, &mut self.faults) {
            if !self.reorder.push(stamp_ns, now, ImuSample { stamp_ns, ..reading }) {
                let problem = "readings come after later ones were used, and cannot be sorted in".to_owned();
                self.faults.note(Stream::Imu, FaultKind::Late, now, problem);
            }
        }
        self.sort_readings(now);
    }

    /// Takes a reading of the wheels.
    pub(super) fn wheels(&mut self, reading: WheelReading, now: Duration) {
        if let Some(wheels) = &mut self.wheels {
            wheels.take(reading, now, &mut self.newest_jump, &mut self.faults);
        }
    }

    /// Takes a position of GNSS.
    pub(super) fn gnss(&mut self, reading: GnssReading, now: Duration) {
        if let Some(gnss) = &mut self.gnss {
            gnss.take(reading, now, &mut self.newest_jump, &mut self.faults);
        }
    }

    pub(super) fn image(&mut self, camera: usize, stamp_ns: i64, image: LiveImage, now: Duration) {
        let stream = Stream::Camera(camera);
        // Images of a camera that is not used are dropped.
        let Some(lane) = self.cameras.get_mut(camera) else { return };
        let stamp_ns = stamp_ns.saturating_add(self.camera_offset_ns + self.stamp_shifts_ns[camera]);
        lane.arrived(now);
        if !check_stamp(stream, stamp_ns, now, &mut self.faults) {
            return;
        }
        let Some(lane) = self.cameras.get_mut(camera) else { return };
        let messages = lane.admit((stamp_ns, image), now, &mut self.newest_jump, &mut self.faults);
        for (stamp_ns, image) in messages {
            match self.repetitions[camera].check(stamp_ns, &image) {
                Compared::New => self.assembly.image(camera, (stamp_ns, image), now, &mut self.faults),
                Compared::Same => {}
                Compared::Frozen(seconds) => {
                    let problem = format!(
                        "the same image again and again for {seconds:.1} s, not used: the camera is frozen; restart its driver"
                    );
                    self.faults.note(stream, FaultKind::Frozen, now, problem);
                }
            }
        }
        self.sort_frames(now);
    }

    pub(super) fn tracks(
        &mut self,
        stamp_ns: i64,
        tracks: Vec<TrackObservation>,
        features: Option<FeatureSet>,
        now: Duration,
    ) {
        let stamp_ns = stamp_ns.saturating_add(self.camera_offset_ns);
        let Some(lane) = &mut self.tracks else { return };
        lane.arrived(now);
        if !check_stamp(Stream::Tracks, stamp_ns, now, &mut self.faults) {
            return;
        }
        let Some(lane) = &mut self.tracks else { return };
        let frame = PendingFrame { tracks, features, ..PendingFrame::default() };
        for message in lane.admit((stamp_ns, frame), now, &mut self.newest_jump, &mut self.faults) {
            self.assembly.tracks(message, now, &mut self.faults);
        }
        self.sort_frames(now);
    }

    /// Notes a message that cannot be read.
    pub(super) fn refuse(&mut self, stream: Stream, problem: String, now: Duration) {
        if self.arrived(stream, now) {
            self.faults.note(stream, FaultKind::Unreadable, now, problem);
        }
    }

    /// Notes that a message has arrived which measures nothing; `false` of a stream that is not expected.
    pub(super) fn arrived(&mut self, stream: Stream, now: Duration) -> bool {
        match stream {
            Stream::Imu => self.imu.arrived(now),
            Stream::Camera(camera) => {
                let Some(lane) = self.cameras.get_mut(camera) else { return false };
                lane.arrived(now);
            }
            Stream::Tracks => {
                let Some(lane) = &mut self.tracks else { return false };
                lane.arrived(now);
            }
            Stream::Wheels => {
                let Some(wheels) = &mut self.wheels else { return false };
                wheels.arrived(now);
            }
            Stream::Gnss => {
                let Some(gnss) = &mut self.gnss else { return false };
                gnss.arrived(now);
            }
        }
        true
    }

    fn sort_readings(&mut self, now: Duration) {
        while let Some((stamp_ns, reading)) = self.reorder.pop(now, self.imu.period_ns(), |_, _| true) {
            self.imu_until_ns = stamp_ns;
            if let Some(tap) = &self.tap {
                let _ = tap.try_send(reading);
            }
            push_newest(&mut self.readings, reading, MAX_READINGS);
        }
    }

    fn sort_frames(&mut self, now: Duration) {
        let cameras = &self.cameras;
        let is_alive = |camera: usize| cameras.get(camera).is_some_and(|lane| lane.is_alive(now));
        let period_ns = match &self.tracks {
            Some(lane) => lane.period_ns(),
            None => self.cameras.first().and_then(Lane::period_ns),
        };
        while let Some(frame) = self.assembly.pop(now, period_ns, is_alive, &mut self.faults) {
            self.frames.push_back(frame);
        }
        let stream = if self.tracks.is_some() { Stream::Tracks } else { Stream::Camera(0) };
        let noun = stream.noun();
        let mut due = self.frames.partition_point(|(stamp_ns, _)| *stamp_ns <= self.imu_until_ns);
        while self.most_waiting(due) > self.max_waiting_frames {
            self.frames.pop_front();
            due -= 1;
            let problem = format!(
                "{noun} are dropped, the oldest first: the processor does not keep up; send fewer or smaller images"
            );
            self.faults.note(stream, FaultKind::Overload, now, problem);
        }
        while self.frames.len() - due > MAX_WAITING_FOR_IMU {
            self.frames.remove(due);
            let problem = format!(
                "{noun} are dropped because there are no readings of the IMU for them; check its driver and the clocks of both"
            );
            self.faults.note(stream, FaultKind::WithoutImu, now, problem);
        }
    }

    /// How many of the first frames are of one camera, at most: cameras that are triggered apart give frames of their own.
    fn most_waiting(&self, due: usize) -> usize {
        let mut counts: BTreeMap<Option<usize>, usize> = BTreeMap::new();
        for (_, frame) in self.frames.range(..due) {
            *counts.entry(frame.images.keys().next().copied()).or_default() += 1;
        }
        counts.into_values().max().unwrap_or_default()
    }

    /// The next event, if there is one.
    pub(super) fn poll(&mut self, now: Duration) -> Option<Ready> {
        self.sort_readings(now);
        self.sort_frames(now);
        if let Some(reading) = self.wheels.as_mut().and_then(SideStream::pop) {
            return Some(Ready::Wheels(reading));
        }
        if let Some(reading) = self.gnss.as_mut().and_then(SideStream::pop) {
            return Some(Ready::Gnss(reading));
        }
        let frame_ns = self.frames.front().map(|(stamp_ns, _)| *stamp_ns);
        let reading_ns = self.readings.front().map(|reading| reading.stamp_ns);
        let reading_is_next = reading_ns.is_some_and(|ns| frame_ns.is_none_or(|frame_ns| ns <= frame_ns));
        if reading_is_next {
            return self.readings.pop_front().map(Ready::Imu);
        }
        // A frame waits until the motion up to it is known.
        if frame_ns.is_some_and(|frame_ns| frame_ns <= self.imu_until_ns) {
            return self.frames.pop_front().map(|(stamp_ns, frame)| Ready::Frame(stamp_ns, frame));
        }
        None
    }

    /// What is wrong at present.
    pub(super) fn active_faults(&self, now: Duration) -> Vec<LiveFault> {
        let states = std::iter::once(self.imu.state(now))
            .chain(self.cameras.iter().map(|lane| lane.state(now)))
            .chain(self.tracks.iter().map(|lane| lane.state(now)))
            .chain(self.wheels.iter().map(|wheels| wheels.state(now)))
            .chain(self.gnss.iter().map(|gnss| gnss.state(now)));
        states.flatten().chain(self.faults.active(now)).collect()
    }

    /// Stereo pairs and lone images so far; `None` without a stereo pair.
    pub(super) fn pairs(&self) -> Option<PairCounts> {
        self.assembly.pairs()
    }

    /// How often a kind of fault happened.
    pub(super) fn count(&self, kind: FaultKind) -> u64 {
        self.faults.total(kind)
    }

    /// How often a kind of fault happened on one stream.
    #[cfg(test)]
    pub(super) fn count_of(&self, stream: Stream, kind: FaultKind) -> u64 {
        self.faults.count(stream, kind)
    }

    /// What is subtracted from the stamps of frames since the clocks jumped, nanoseconds.
    pub(super) fn clock_shift_ns(&self) -> i64 {
        match (&self.tracks, self.cameras.first()) {
            (Some(lane), _) => lane.jumped_ns(),
            (None, Some(lane)) => lane.jumped_ns(),
            (None, None) => self.imu.jumped_ns(),
        }
    }
}
