//! Frames from what arrives: images of the cameras joined by their stamps, or tracks.

use super::fault::{FaultKind, FaultLog};
use super::image::LiveImage;
use super::reorder::Reorder;
use super::stream::Stream;
use crate::{CameraGroup, PairCounts, TrackObservation};
use protocol::FeatureSet;
use std::collections::BTreeMap;
use std::time::Duration;

/// A frame whose images are not decoded yet.
#[derive(Debug, Default, PartialEq)]
pub(super) struct PendingFrame {
    /// By camera.
    pub(super) images: BTreeMap<usize, LiveImage>,
    pub(super) tracks: Vec<TrackObservation>,
    /// Of camera 0.
    pub(super) features: Option<FeatureSet>,
}

/// Joins images and sorts frames.
#[derive(Debug)]
pub(super) struct Assembly {
    frames: Reorder<PendingFrame>,
    groups: Vec<CameraGroup>,
    /// Stamp of the newest image of each camera.
    newest_ns: BTreeMap<usize, i64>,
    tolerance_ns: i64,
    pairs: PairCounts,
}

impl Assembly {
    /// # Arguments
    /// * `groups`: of the cameras whose images come; none where tracks come.
    pub(super) fn new(groups: Vec<CameraGroup>, tolerance_ns: i64) -> Self {
        let (frames, newest_ns) = (Reorder::new(), BTreeMap::new());
        Self { frames, groups, newest_ns, tolerance_ns, pairs: PairCounts::default() }
    }

    /// Adds an image; the frame has the stamp of its first camera.
    pub(super) fn image(
        &mut self,
        camera: usize,
        (stamp_ns, image): (i64, LiveImage),
        now: Duration,
        faults: &mut FaultLog,
    ) {
        let lacks_it = |frame: &PendingFrame| !frame.images.contains_key(&camera);
        let partner = self.frames.nearest(stamp_ns, self.tolerance_ns, lacks_it);
        if let Some(at_ns) = partner {
            let largest_ns = &mut self.pairs.largest_difference_ns;
            *largest_ns = (*largest_ns).max(at_ns.saturating_sub(stamp_ns).saturating_abs());
        }
        let (arrival, mut frame) = partner
            .and_then(|at_ns| self.frames.remove(at_ns))
            .unwrap_or_else(|| (now, PendingFrame::default()));
        let is_first = frame.images.keys().all(|other| camera < *other);
        frame.images.insert(camera, image);
        let newest_ns = self.newest_ns.entry(camera).or_insert(stamp_ns);
        *newest_ns = stamp_ns.max(*newest_ns);
        let of_first = if is_first { stamp_ns } else { partner.unwrap_or(stamp_ns) };
        self.push(Stream::Camera(camera), (of_first, frame), (arrival, now), faults);
    }

    /// Adds tracks and features.
    pub(super) fn tracks(&mut self, frame: (i64, PendingFrame), now: Duration, faults: &mut FaultLog) {
        self.push(Stream::Tracks, frame, (now, now), faults);
    }

    /// Pairs and lone images so far; `None` without a stereo pair.
    pub(super) fn pairs(&self) -> Option<PairCounts> {
        self.groups.iter().any(|group| group.second.is_some()).then_some(self.pairs)
    }

    fn push(
        &mut self,
        stream: Stream,
        (stamp_ns, frame): (i64, PendingFrame),
        (arrival, now): (Duration, Duration),
        faults: &mut FaultLog,
    ) {
        if !self.frames.push(stamp_ns, arrival, frame) {
            let problem = format!("{} come after later ones were used, and are dropped", stream.noun());
            faults.note(stream, FaultKind::Late, now, problem);
        }
    }

    /// The next frame, if it need not wait any longer.
    ///
    /// # Arguments
    /// * `is_alive`: whether a camera is worth waiting for.
    pub(super) fn pop(
        &mut self,
        now: Duration,
        period_ns: Option<i64>,
        is_alive: impl Fn(usize) -> bool,
        faults: &mut FaultLog,
    ) -> Option<(i64, PendingFrame)> {
        loop {
            let Self { frames, groups, newest_ns, tolerance_ns, .. } = self;
            // The images of a group that is triggered at other times are not waited for: later ones show that there is none.
            let is_past = |group: &CameraGroup, frame: &PendingFrame, stamp_ns: i64| {
                let newest_ns = newest_ns.get(&group.first);
                let is_later = |ns: &i64| *ns > stamp_ns.saturating_add(*tolerance_ns);
                newest_ns.is_some_and(is_later)
                    && group.cameras().all(|camera| !frame.images.contains_key(&camera))
            };
            let is_complete = |stamp_ns: i64, frame: &PendingFrame| {
                let is_there = |camera| frame.images.contains_key(&camera) || !is_alive(camera);
                groups.iter().all(|group| group.cameras().all(is_there) || is_past(group, frame, stamp_ns))
            };
            let (stamp_ns, mut frame) = frames.pop(now, period_ns, is_complete)?;
            let is_of_images = !frame.images.is_empty();
            self.count_pairs(&mut frame, now, faults);
            if is_of_images && frame.images.is_empty() {
                continue;
            }
            return Some((stamp_ns, frame));
        }
    }

    /// Counts the stereo pairs of a frame, and drops images of second cameras without a partner.
    fn count_pairs(&mut self, frame: &mut PendingFrame, now: Duration, faults: &mut FaultLog) {
        for group in &self.groups {
            let Some(second) = group.second else { continue };
            let is_there = |camera| frame.images.contains_key(&camera);
            let (lone, missing, fate) = match (is_there(group.first), is_there(second)) {
                (true, true) => {
                    self.pairs.pairs += 1;
                    continue;
                }
                (false, false) => continue,
                (true, false) => (group.first, second, "used as those of one camera"),
                (false, true) => (second, group.first, "dropped"),
            };
            let tolerance_ms = self.tolerance_ns as f64 * 1e-6;
            let problem = format!(
                "images without one of cam{missing} within {tolerance_ms:.1} ms are {fate}; check the cameras' trigger"
            );
            faults.note(Stream::Camera(lone), FaultKind::Unpaired, now, problem);
            if lone == second {
                self.pairs.lone_second += 1;
                frame.images.remove(&second);
            } else {
                self.pairs.lone_first += 1;
            }
        }
    }
}
