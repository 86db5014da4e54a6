//! Makes chunks of a session of what a robot sees.
//!
//! Images wait some seconds before it is decided what is recorded of them: until then their features are extracted, the map has
//! answered, and it is known which points are tracked on.

use super::budget::Budget;
use super::candidates::Candidates;
use super::identity::SessionIdentity;
use super::tracked_points::TrackedPoints;
use estimator::{ImuSample, TrackObservation};
use geometry::Pose;
use hand_in::{Answer, Candidate, Chunk, SessionFrame};
use protocol::FeatureSet;
use std::collections::{BTreeMap, VecDeque};

/// How long an image waits (ns): longer than extraction and the deadline of a query.
const WAIT_NS: i64 = 3_500_000_000;
/// Tracks are recorded of one image in so long (ns): five a second.
const FRAME_INTERVAL_NS: i64 = 195_000_000;
/// Length of a chunk (ns): what a killed robot loses at most, with the time that images wait.
const CHUNK_NS: i64 = 5_000_000_000;
/// Most images that wait.
const MOST_WAITING: usize = 1000;
/// Readings before the first image of a session that are recorded, to know the motion from there (ns).
const LEAD_NS: i64 = 100_000_000;

/// An image that waits.
#[derive(Debug, Default)]
struct Waiting {
    stamp_ns: i64,
    tracks: Vec<TrackObservation>,
    local_from_imu: Option<Pose>,
    /// Of its cameras that the map is asked about.
    features: BTreeMap<usize, FeatureSet>,
    /// By camera.
    answers: BTreeMap<usize, Answer>,
}

/// A session that is recorded.
#[derive(Debug)]
pub(super) struct SessionBuilder {
    budget: Budget,
    identity: SessionIdentity,
    candidates: Candidates,
    points: TrackedPoints,
    waiting: VecDeque<Waiting>,
    readings: Vec<ImuSample>,
    frames: Vec<SessionFrame>,
    answers: Vec<Answer>,
    last_frame_ns: Option<i64>,
    last_reading_ns: i64,
    chunk_begin_ns: Option<i64>,
    session_begin_ns: Option<i64>,
    /// Bytes of candidates in this chunk that the budget has.
    taken: usize,
}

impl SessionBuilder {
    pub(super) fn new(bytes_per_minute: f64) -> Self {
        Self {
            budget: Budget::new(bytes_per_minute),
            identity: SessionIdentity::default(),
            candidates: Candidates::default(),
            points: TrackedPoints::default(),
            waiting: VecDeque::new(),
            readings: Vec::new(),
            frames: Vec::new(),
            answers: Vec::new(),
            last_frame_ns: None,
            last_reading_ns: i64::MIN,
            chunk_begin_ns: None,
            session_begin_ns: None,
            taken: 0,
        }
    }

    /// A reading of the IMU. One that is not finite or out of order is left out.
    pub(super) fn reading(&mut self, reading: ImuSample) {
        if reading.is_finite() && reading.stamp_ns > self.last_reading_ns {
            self.last_reading_ns = reading.stamp_ns;
            self.identity.reading(&reading);
            self.readings.push(reading);
        }
    }

    /// An image has come.
    pub(super) fn image(&mut self, stamp_ns: i64) {
        if self.waiting.back().is_none_or(|last| last.stamp_ns < stamp_ns) {
            self.waiting.push_back(Waiting { stamp_ns, ..Waiting::default() });
        }
    }

    fn waiting_at(&mut self, stamp_ns: i64) -> Option<&mut Waiting> {
        let at = self.waiting.binary_search_by_key(&stamp_ns, |image| image.stamp_ns).ok()?;
        self.waiting.get_mut(at)
    }

    /// The tracked points of an image.
    pub(super) fn tracks(&mut self, stamp_ns: i64, tracks: Vec<TrackObservation>) {
        if let Some(image) = self.waiting_at(stamp_ns) {
            image.tracks = tracks;
        }
    }

    /// Where odometry says that the robot was. It selects, and is not recorded.
    pub(super) fn pose(&mut self, stamp_ns: i64, local_from_imu: Pose) {
        if let Some(image) = self.waiting_at(stamp_ns) {
            image.local_from_imu = Some(local_from_imu);
        }
    }

    /// The features of the image of a camera.
    pub(super) fn features(&mut self, stamp_ns: i64, camera: usize, features: FeatureSet) {
        if let Some(image) = self.waiting_at(stamp_ns).filter(|_| !features.is_empty()) {
            image.features.insert(camera, features);
        }
    }

    /// What the map answered about it.
    pub(super) fn answer(&mut self, answer: Answer) {
        if let Some(image) = self.waiting_at(answer.stamp_ns) {
            image.answers.insert(answer.camera, answer);
        }
    }

    /// Odometry has begun anew, in another frame.
    pub(super) fn restart(&mut self) {
        self.candidates.forget_pose();
        self.waiting.iter_mut().for_each(|image| image.local_from_imu = None);
    }

    /// The clock was set, after [`SessionBuilder::end_session`]: what is left for the next session is of the new clock, too.
    ///
    /// # Arguments
    /// * `by_ns`: what the new clock is ahead, nanoseconds.
    pub(super) fn shift_clock(&mut self, by_ns: i64) {
        self.readings
            .iter_mut()
            .for_each(|reading| reading.stamp_ns = reading.stamp_ns.saturating_add(by_ns));
        self.last_reading_ns = self.last_reading_ns.saturating_add(by_ns);
        self.identity.shift_clock(by_ns);
        self.budget.shift_clock(by_ns);
    }

    /// How long the session is so far, by the images that were decided about, nanoseconds.
    pub(super) fn length_ns(&self) -> i64 {
        let ends = self.session_begin_ns.zip(self.last_frame_ns);
        ends.map_or(0, |(begin, end)| end - begin)
    }

    /// Decides about the images that have waited long enough.
    ///
    /// # Returns
    /// A chunk that is full.
    pub(super) fn next_chunk(&mut self) -> Option<Chunk> {
        while let Some((first, last)) = self.waiting.front().zip(self.waiting.back()) {
            if last.stamp_ns - first.stamp_ns < WAIT_NS && self.waiting.len() <= MOST_WAITING {
                return None;
            }
            self.decide();
            let begin_ns = self.chunk_begin_ns.zip(self.last_frame_ns);
            if begin_ns.is_some_and(|(begin, end)| end - begin >= CHUNK_NS) {
                return self.take_chunk();
            }
        }
        None
    }

    /// Decides about all images that wait, and begins the next session.
    ///
    /// # Returns
    /// The last chunk of this one.
    pub(super) fn end_session(&mut self) -> Option<Chunk> {
        while !self.waiting.is_empty() {
            self.decide();
        }
        let lead: Vec<ImuSample> = {
            let from_ns = self.last_reading_ns.saturating_sub(LEAD_NS);
            self.readings.iter().filter(|reading| reading.stamp_ns >= from_ns).copied().collect()
        };
        let chunk = self.take_chunk();
        self.identity.begin_next();
        self.candidates.clear();
        self.points.clear();
        self.readings = lead;
        (self.last_frame_ns, self.session_begin_ns) = (None, None);
        chunk
    }

    /// Decides about the image that waits longest.
    fn decide(&mut self) {
        let Some(image) = self.waiting.pop_front() else { return };
        let Waiting { stamp_ns, tracks, local_from_imu, features, mut answers } = image;
        self.identity.image(stamp_ns);
        self.budget.advance(stamp_ns);
        let images = features.into_iter().map(|(camera, features)| {
            let answer = answers.remove(&camera);
            (camera, (features, answer))
        });
        let budget = &mut self.budget;
        let taken = self.candidates.consider(stamp_ns, local_from_imu, images.collect(), budget);
        let is_due = self.last_frame_ns.is_none_or(|last_ns| stamp_ns - last_ns >= FRAME_INTERVAL_NS);
        if taken.is_empty() && !is_due {
            return;
        }
        let later = self.waiting.iter().find(|later| later.stamp_ns - stamp_ns >= FRAME_INTERVAL_NS);
        let tracks = self.points.choose(&tracks, later.map(|later| &*later.tracks));
        let mut candidates = Vec::with_capacity(taken.len());
        for (camera, (features, answer)) in taken {
            self.taken += features.descriptors.bytes.len();
            self.answers.extend(answer);
            candidates.push(Candidate { camera, features });
        }
        self.frames.push(SessionFrame { stamp_ns, tracks, candidates });
        self.last_frame_ns = Some(stamp_ns);
        self.chunk_begin_ns.get_or_insert(stamp_ns);
        self.session_begin_ns.get_or_insert(stamp_ns);
    }

    fn take_chunk(&mut self) -> Option<Chunk> {
        self.chunk_begin_ns = None;
        if self.frames.is_empty() {
            return None;
        }
        Some(Chunk {
            recorded: self.identity.so_far(),
            readings: std::mem::take(&mut self.readings),
            frames: std::mem::take(&mut self.frames),
            answers: std::mem::take(&mut self.answers),
        })
    }

    /// A chunk was written: what of it is not a candidate is taken from the budget.
    pub(super) fn wrote(&mut self, bytes: u64) {
        let of_candidates = std::mem::take(&mut self.taken);
        self.budget.take((bytes as f64 - of_candidates as f64).max(0.0));
    }
}
