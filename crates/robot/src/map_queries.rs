//! Map queries of a run: sends images' features, applies the answers and the changes of the map.
//!
//! An answer belongs to the filter that sent the query: answers to images from before the newest initialization are
//! not applied.

use super::counts::Traffic;
use super::estimate::Estimate;
use super::event::Event;
use super::extraction::{Extracted, ExtractionThread};
use super::map_conversion::{identity_number, map_answer, map_revision};
use super::query_cameras::QueryImage;
use super::run::Robot;
use super::stop::NOTICE;
use client::{MapChangeSubscriber, MatchAnswer, QueryResult, QueryTasks};
use estimator::{CloneId, EstimatorError, MapMode, MapReport, Rejection, RevisionEffect};
use nalgebra::Vector2;
use protocol::{FeatureSet, MatchOutcome, MatchRequest, PosePrior};
use sensors::Frame;
use std::time::{Duration, Instant};

/// Frames that may be pending at once, each with a query for every camera that is asked about. Each keeps its clone in the filter: with a
/// server that hangs, the window must not fill with them.
const MAX_PENDING_FRAMES: usize = 4;

impl Robot<'_> {
    /// Queries the map with the features of a frame, or begins to extract them.
    pub(crate) fn query_frame(&mut self, clone: CloneId, frame: &Frame) {
        if self.map.queries.is_none() || self.supervisor.config().mode == MapMode::Odometry {
            return;
        }
        if self.query_cameras.has_features(frame) {
            self.query_recorded_features(clone, frame);
            return;
        }
        let Some(extraction) = &mut self.extraction else { return };
        let due = self
            .last_extraction_ns
            .is_none_or(|last_ns| frame.stamp_ns - last_ns >= self.settings.query_interval_ns);
        let Some(estimator) = self.supervisor.estimator_mut() else { return };
        if !due || !extraction.is_idle() {
            return;
        }
        for camera in self.query_cameras.next(frame, self.settings.query_cameras) {
            let Some(image) = frame.images.get(&camera) else { continue };
            estimator.pin(clone);
            extraction.submit(QueryImage { clone, camera }, frame.stamp_ns, image.clone());
            self.query_cameras.note_query(camera, frame.stamp_ns);
            self.last_extraction_ns = Some(frame.stamp_ns);
        }
    }

    /// Queries the map with the features that a recording has of a frame.
    fn query_recorded_features(&mut self, clone: CloneId, frame: &Frame) {
        for camera in self.query_cameras.next(frame, self.settings.query_cameras) {
            let Some(features) = frame.features.get(&camera) else { continue };
            if let Some(estimator) = self.supervisor.estimator_mut() {
                estimator.pin(clone);
            }
            self.query_cameras.note_query(camera, frame.stamp_ns);
            self.send_query(QueryImage { clone, camera }, frame.stamp_ns, features.clone());
        }
    }

    /// Takes in the pose that an operator set.
    pub(crate) fn update_initial_pose(&mut self) {
        let has_map = self.map.has_map() && self.supervisor.config().mode != MapMode::Odometry;
        self.initial_pose.update(self.supervisor.estimator_mut(), has_map);
    }

    /// Queries the map about an image whose clone is pinned for it; where that is not possible, it is not any more.
    fn send_query(&mut self, image: QueryImage, stamp_ns: i64, mut features: FeatureSet) {
        let QueryImage { clone, camera } = image;
        self.outputs.each(|output| output.features(stamp_ns, camera, &features));
        let mode = self.supervisor.config().mode;
        let Some(estimator) = self.supervisor.estimator_since(stamp_ns) else { return };
        let (Some(queries), Some(projection)) = (&mut self.map.queries, self.query_cameras.camera(camera))
        else {
            estimator.unpin(clone);
            return;
        };
        if queries.pending() >= MAX_PENDING_FRAMES * self.settings.query_cameras.max(1) {
            self.report.queries.skipped += 1;
            estimator.unpin(clone);
            return;
        }
        for pixel in &mut features.pixels {
            let seen = estimator.still_pixel(clone, camera, &Vector2::from(pixel.map(f64::from)));
            *pixel = [seen.x as f32, seen.y as f32];
        }
        let max_keyframes = if mode == MapMode::Single { 1 } else { self.settings.max_keyframes.max(1) };
        let request = MatchRequest {
            robot: self.settings.name.clone(),
            stamp_ns,
            camera: projection.clone(),
            features,
            prior: self
                .initial_pose
                .prior(estimator, image)
                .or_else(|| estimator.global_from_camera(clone, camera))
                .map(|global_from_camera| PosePrior { global_from_camera }),
            gravity_in_camera: estimator.gravity_in_camera(clone, camera).map(Into::into),
            held: estimator.held_keyframes(),
            map_version_held: estimator.map_version(),
            max_keyframes,
        };
        self.report.queries.sent += 1;
        queries.submit(image, request);
    }

    /// Applies the answers that have come; as fast as possible (not in real time), waits for all pending ones.
    ///
    /// # Returns
    /// The time spent waiting.
    pub(crate) fn apply_answers(&mut self) -> Result<Duration, EstimatorError> {
        let mut waited = Duration::ZERO;
        loop {
            let begin = Instant::now();
            let extracted = self.extraction.as_mut().and_then(|extraction| {
                if self.settings.realtime { extraction.poll() } else { extraction.wait() }
            });
            waited += begin.elapsed();
            let Some(extracted) = extracted else { break };
            self.query_extracted(extracted);
        }
        self.apply_map_changes();
        loop {
            let begin = Instant::now();
            let result = if self.settings.realtime {
                self.map.queries.as_mut().and_then(QueryTasks::poll)
            } else {
                self.next_answer()
            };
            waited += begin.elapsed();
            let Some(result) = result else { break };
            // Changes that came in the meantime concern this answer.
            self.apply_map_changes();
            self.apply_result(&result)?;
        }
        Ok(waited)
    }

    /// Applies the changes of the map that were received.
    fn apply_map_changes(&mut self) {
        while let Some(notice) = self.map.changes.as_mut().and_then(MapChangeSubscriber::poll) {
            let Some(estimator) = self.supervisor.estimator_mut() else { continue };
            if estimator.map_identity().is_some_and(|held| held != identity_number(notice.identity)) {
                tracing::warn!(identity = %notice.identity, "ignored a change of another map of the same name");
                continue;
            }
            let revision = map_revision(notice);
            let (from, version) = (revision.from_version, revision.version);
            let before = estimator.local_from_imu();
            let effect = estimator.map_changed(&revision);
            let after = estimator.local_from_imu();
            if before != after {
                self.outputs.each(|output| output.correct(&before, &after));
            }
            match effect {
                RevisionEffect::CarriedOver => {
                    self.report.map_changes.carried_over += 1;
                    let size = revision.size;
                    tracing::info!(
                        from,
                        version,
                        ?size,
                        "the map changed; the pose in it is carried over to the new version"
                    );
                }
                RevisionEffect::Reinitialized => {
                    self.report.map_changes.found_anew += 1;
                    tracing::warn!(
                        from,
                        version,
                        "the map changed by an unknown amount since the version in use; the pose in it is initialized again"
                    );
                }
                RevisionEffect::None => {}
            }
        }
    }

    /// Queries the map with the features of an image, now that they are extracted.
    fn query_extracted(&mut self, extracted: Extracted) {
        // A camera that is covered or dark gives nothing to ask about.
        if extracted.features.as_ref().is_ok_and(protocol::FeatureSet::is_empty) {
            self.query_cameras.note_answer(extracted.image.camera, false);
        }
        let Some(estimator) = self.supervisor.estimator_since(extracted.stamp_ns) else { return };
        match extracted.features {
            Ok(features) if !features.is_empty() => {
                self.send_query(extracted.image, extracted.stamp_ns, features);
            }
            Ok(_) => estimator.unpin(extracted.image.clone),
            Err(reason) => {
                tracing::warn!(%reason, "no query for this image: its features were not extracted");
                estimator.unpin(extracted.image.clone);
            }
        }
    }

    fn apply_result(&mut self, result: &QueryResult<QueryImage>) -> Result<(), EstimatorError> {
        let failure = result.answer.as_ref().err().map(ToString::to_string);
        self.report.traffic.add(&Traffic { sent: result.bytes_sent, received: result.bytes_received });
        let (QueryImage { clone, camera }, request) = (result.token, &result.request);
        let matched = result.answer.as_ref().ok();
        let matched = matched.filter(|answer| answer.status.outcome == MatchOutcome::Matched);
        let matched = matched.map(|MatchAnswer { status, keyframes }| {
            map_answer(camera, &request.features, &request.held, status, keyframes.clone())
        });
        if let Some(answer) = &matched {
            self.report.keyframes_pulled += answer.keyframes.len();
        }
        let Some(estimator) = self.supervisor.estimator_since(request.stamp_ns) else {
            self.note_failure(failure);
            self.give_answer(result, None);
            let mut event = Event::new(result, request.stamp_ns);
            event.note_failure("the estimator was initialized again after this query was sent");
            self.note_event(&event);
            return Ok(());
        };
        let mut event = Event::new(result, estimator.stamp_ns());
        let (mut refusal, mut updated) = (None, None);
        match (&matched, &result.answer) {
            (Some(answer), _) => {
                let before = estimator.local_from_imu();
                let report = estimator.map_update(clone, answer)?;
                let after = estimator.local_from_imu();
                self.outputs.each(|output| output.correct(&before, &after));
                event.note_report(&report);
                self.report.note_map_initialization(&report);
                self.query_cameras.note_answer(camera, report.rejection.is_none());
                if report.rejection.is_none() {
                    self.initial_pose.answered(estimator, result.token, request.stamp_ns);
                }
                refusal = report.rejection.filter(|reason| matches!(reason, Rejection::OtherMap { .. }));
                updated = Some(report);
            }
            (None, Ok(answer)) => {
                self.query_cameras.note_answer(camera, false);
                event.note_no_match(answer.status.outcome);
            }
            (None, Err(error)) => event.note_failure(&error.to_string()),
        }
        estimator.unpin(clone);
        self.give_answer(result, updated.as_ref());
        self.note_event(&event);
        self.note_failure(
            failure.or_else(|| refusal.map(|reason| format!("its answer is refused: {reason}"))),
        );
        Ok(())
    }

    /// Gives out what the map answered, where it did.
    fn give_answer(&mut self, result: &QueryResult<QueryImage>, report: Option<&MapReport>) {
        if let Ok(answer) = &result.answer {
            let (stamp_ns, camera) = (result.request.stamp_ns, result.token.camera);
            self.outputs.each(|output| output.answer(stamp_ns, camera, answer, report));
        }
    }

    fn note_event(&mut self, event: &Event) {
        self.report.note_event(event);
        self.outputs.each(|output| output.query(event));
    }

    /// Keeps why the last query had no answer that can be used, and logs when that changes.
    fn note_failure(&mut self, failure: Option<String>) {
        match (&self.map.last_failure, &failure) {
            (None, Some(reason)) => {
                tracing::warn!(reason, "a map query had no usable answer; odometry continues");
            }
            (Some(_), None) => tracing::info!("map queries are answered again"),
            _ => {}
        }
        self.map.last_failure = failure;
    }

    /// Applies the pending answers before a frame that is much later, and replaces the recorded state.
    pub(crate) fn apply_answers_before_next_frame(&mut self) -> Result<(), EstimatorError> {
        let (extraction, queries) = (self.extraction.as_ref(), self.map.queries.as_ref());
        let none_pending = extraction.is_none_or(ExtractionThread::is_idle)
            && queries.is_none_or(|queries| queries.pending() == 0);
        if none_pending {
            return Ok(());
        }
        self.apply_answers()?;
        let status = self.status();
        if let Some(estimator) = self.supervisor.estimator() {
            self.report.note_state_again(estimator);
            let estimate = Estimate::of(estimator, &status, Duration::ZERO);
            self.outputs.each(|output| output.revise(&estimate));
        }
        Ok(())
    }

    /// Waits for the pending answers at the end of the source, and applies them.
    pub(crate) fn finish_queries(&mut self) -> Result<(), EstimatorError> {
        while let Some(extracted) = self.extraction.as_mut().and_then(ExtractionThread::wait) {
            self.query_extracted(extracted);
        }
        while let Some(result) = self.next_answer() {
            self.apply_map_changes();
            self.apply_result(&result)?;
        }
        Ok(())
    }

    /// Waits for the next answer; once the run is stopped, takes only those that are there.
    fn next_answer(&mut self) -> Option<QueryResult<QueryImage>> {
        let queries = self.map.queries.as_mut()?;
        while !self.settings.stop.is_stopped() && queries.pending() > 0 {
            let result = queries.wait_at_most(NOTICE);
            if result.is_some() {
                return result;
            }
        }
        queries.poll()
    }
}
