//! Frames from what arrives: images of the two cameras of a pair joined by their stamps, or tracks.

use super::fault::{FaultKind, FaultLog};
use super::image::LiveImage;
use super::reorder::Reorder;
use super::stream::Stream;
use crate::{PairCounts, TrackObservation};
use protocol::FeatureSet;
use std::time::Duration;

/// A frame whose images are not decoded yet.
#[derive(Debug, Default, PartialEq)]
pub(super) struct PendingFrame {
    pub(super) images: [Option<LiveImage>; 2],
    pub(super) tracks: Vec<TrackObservation>,
    pub(super) features: Option<FeatureSet>,
}

/// Joins images and sorts frames.
#[derive(Debug)]
pub(super) struct Assembly {
    frames: Reorder<PendingFrame>,
    cameras: usize,
    tolerance_ns: i64,
    pairs: PairCounts,
}

impl Assembly {
    pub(super) fn new(cameras: usize, tolerance_ns: i64) -> Self {
        Self { frames: Reorder::new(), cameras, tolerance_ns, pairs: PairCounts::default() }
    }

    /// Adds an image; the frame has the stamp of camera 0.
    pub(super) fn image(
        &mut self,
        camera: usize,
        (stamp_ns, image): (i64, LiveImage),
        now: Duration,
        faults: &mut FaultLog,
    ) {
        let lacks_it = |frame: &PendingFrame| frame.images[camera].is_none();
        let partner = self.frames.nearest(stamp_ns, self.tolerance_ns, lacks_it);
        if let Some(at_ns) = partner {
            let largest_ns = &mut self.pairs.largest_difference_ns;
            *largest_ns = (*largest_ns).max(at_ns.saturating_sub(stamp_ns).saturating_abs());
        }
        let (arrival, mut frame) = partner
            .and_then(|at_ns| self.frames.remove(at_ns))
            .unwrap_or_else(|| (now, PendingFrame::default()));
        frame.images[camera] = Some(image);
        let of_first = if camera == 0 { stamp_ns } else { partner.unwrap_or(stamp_ns) };
        self.push(Stream::Camera(camera), (of_first, frame), (arrival, now), faults);
    }

    /// Adds tracks and features.
    pub(super) fn tracks(&mut self, frame: (i64, PendingFrame), now: Duration, faults: &mut FaultLog) {
        self.push(Stream::Tracks, frame, (now, now), faults);
    }

    /// Pairs and lone images so far; `None` for one camera.
    pub(super) fn pairs(&self) -> Option<PairCounts> {
        (self.cameras > 1).then_some(self.pairs)
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
        is_alive: [bool; 2],
        faults: &mut FaultLog,
    ) -> Option<(i64, PendingFrame)> {
        loop {
            let cameras = self.cameras;
            let is_complete = |frame: &PendingFrame| {
                (0..cameras).all(|camera| frame.images[camera].is_some() || !is_alive[camera])
            };
            let (stamp_ns, frame) = self.frames.pop(now, period_ns, is_complete)?;
            if cameras > 1 && frame.images.iter().any(Option::is_none) {
                let lone = usize::from(frame.images[0].is_none());
                let fate = ["used as those of one camera", "dropped"][lone];
                let tolerance_ms = self.tolerance_ns as f64 * 1e-6;
                let problem = format!(
                    "images without one of cam{} within {tolerance_ms:.1} ms are {fate}; check the cameras' trigger",
                    1 - lone
                );
                faults.note(Stream::Camera(lone), FaultKind::Unpaired, now, problem);
                if lone == 1 {
                    self.pairs.lone_second += 1;
                    continue;
                }
                self.pairs.lone_first += 1;
            } else {
                self.pairs.pairs += 1;
            }
            return Some((stamp_ns, frame));
        }
    }
}
