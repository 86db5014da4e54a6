//! How a run asks the map about its images, and takes in the answers.
//!
//! An answer belongs to the filter that asked: one to an image from before the newest start is left alone.

use super::event::Event;
use super::extraction::{Extracted, ExtractionThread};
use super::recorder::Recorder;
use super::run::RobotRun;
use super::summary::Traffic;
use client::map_change_subscriber::MapChangeSubscriber;
use client::query_client::{Outcome, QueryClient, QueryResult};
use estimator::{CloneId, EstimatorError, MapMode, RevisionEffect};
use protocol::{FeatureSet, MatchRequest, PosePrior};
use sensors::Frame;
use std::time::{Duration, Instant};

/// Queries that may be on their way at once.
const MAX_PENDING: usize = 4;

impl RobotRun<'_> {
    /// Asks the map about a frame, as soon as its features are there.
    pub(super) fn ask_about(&mut self, clone: CloneId, frame: &Frame, recorder: &mut Recorder) {
        if self.queries.is_none() || self.filter.config().mode == MapMode::Odometry {
            return;
        }
        if let Some(features) = frame.features.as_ref().filter(|features| !features.is_empty()) {
            self.ask(clone, frame.stamp_ns, features.clone(), recorder);
            return;
        }
        let (Some(extraction), Some(image)) = (&mut self.extraction, &frame.images[0]) else { return };
        let due =
            self.last_extraction_ns.is_none_or(|last_ns| frame.stamp_ns - last_ns >= self.query_interval_ns);
        let Some(estimator) = self.filter.estimator_mut() else { return };
        if due && extraction.is_idle() {
            estimator.pin(clone);
            extraction.submit(clone, frame.stamp_ns, image);
            self.last_extraction_ns = Some(frame.stamp_ns);
        }
    }

    fn ask(&mut self, clone: CloneId, stamp_ns: i64, features: FeatureSet, recorder: &mut Recorder) {
        let mode = self.filter.config().mode;
        let (Some(queries), Some(estimator)) = (&mut self.queries, self.filter.estimator_since(stamp_ns))
        else {
            return;
        };
        // Each holds its clone in the filter: with a server that hangs, the window must not fill with them.
        if queries.pending() >= MAX_PENDING {
            recorder.queries.skipped += 1;
            estimator.unpin(clone);
            return;
        }
        let max_keyframes = if mode == MapMode::Single { 1 } else { self.max_keyframes.max(1) };
        let request = MatchRequest {
            robot: self.robot.clone(),
            stamp_ns,
            camera: self.recording.cameras[0].camera.clone(),
            features,
            prior: estimator
                .global_from_camera(clone)
                .map(|global_from_camera| PosePrior { global_from_camera }),
            gravity_in_camera: estimator.gravity_in_first_camera(clone).map(Into::into),
            held: estimator.held_keyframes(),
            map_version_held: estimator.map_version(),
            max_keyframes,
        };
        estimator.pin(clone);
        recorder.queries.sent += 1;
        queries.ask(clone, request);
    }

    /// Takes in the features and answers that are here; as fast as possible, waits for all of them.
    pub(super) fn deliver(&mut self, recorder: &mut Recorder) -> Result<Duration, EstimatorError> {
        let begin = Instant::now();
        let extracted = self
            .extraction
            .as_mut()
            .and_then(|extraction| if self.realtime { extraction.poll() } else { extraction.wait() });
        let mut waited = begin.elapsed();
        if let Some(extracted) = extracted {
            self.ask_with(extracted, recorder);
        }
        self.hear_news(recorder);
        while let Some(queries) = &mut self.queries {
            let begin = Instant::now();
            let answered = if self.realtime { queries.poll() } else { queries.wait() };
            waited += begin.elapsed();
            let Some(answered) = answered else { break };
            // They may have come while this was waited for, and are about it.
            self.hear_news(recorder);
            self.take(&answered, recorder)?;
        }
        Ok(waited)
    }

    /// Takes in what the map says of its changes.
    fn hear_news(&mut self, recorder: &mut Recorder) {
        while let Some(revision) = self.news.as_ref().and_then(MapChangeSubscriber::poll) {
            let Some(estimator) = self.filter.estimator_mut() else { continue };
            let (from, version) = (revision.from_version, revision.version);
            match estimator.map_changed(&revision) {
                RevisionEffect::CarriedOver => {
                    recorder.map_changes.carried_over += 1;
                    let size = revision.size;
                    tracing::info!(from, version, ?size, "the map changed: the pose in it is carried over");
                }
                RevisionEffect::Reinitialized => {
                    recorder.map_changes.found_anew += 1;
                    tracing::warn!(
                        from,
                        version,
                        "the map changed, nobody says by how much since the version in use: the place in it is found anew"
                    );
                }
                RevisionEffect::None => {}
            }
        }
    }

    /// The features of an image are ready: the map is asked.
    fn ask_with(&mut self, extracted: Extracted, recorder: &mut Recorder) {
        let Some(estimator) = self.filter.estimator_since(extracted.stamp_ns) else { return };
        match extracted.features {
            Ok(features) if !features.is_empty() => {
                self.ask(extracted.clone, extracted.stamp_ns, features, recorder);
            }
            Ok(_) => estimator.unpin(extracted.clone),
            Err(reason) => {
                tracing::warn!(reason, "the map is not asked about this image");
                estimator.unpin(extracted.clone);
            }
        }
    }

    fn take(&mut self, answered: &QueryResult, recorder: &mut Recorder) -> Result<(), EstimatorError> {
        self.note_failure(&answered.outcome);
        recorder.traffic.add(&Traffic { sent: answered.bytes_sent, received: answered.bytes_received });
        let Some(estimator) = self.filter.estimator_since(answered.stamp_ns) else {
            let mut event = Event::new(answered, answered.stamp_ns);
            event.note_failure("the filter that asked was given up");
            recorder.note_event(&event);
            return Ok(());
        };
        let mut event = Event::new(answered, estimator.stamp_ns());
        match &answered.outcome {
            Outcome::Matched(answer) => {
                let report = estimator.map_update(answered.clone, answer)?;
                event.note_report(&report);
            }
            Outcome::NoMatch(outcome) => event.note_no_match(*outcome),
            Outcome::Failed(reason) => event.note_failure(reason),
        }
        estimator.unpin(answered.clone);
        recorder.note_event(&event);
        Ok(())
    }

    /// Remembers whether the map answers, and says so when that changes.
    fn note_failure(&mut self, outcome: &Outcome) {
        let failure = match outcome {
            Outcome::Failed(reason) => Some(reason.clone()),
            Outcome::Matched(_) | Outcome::NoMatch(_) => None,
        };
        match (&self.last_failure, &failure) {
            (None, Some(reason)) => tracing::warn!(reason, "the map does not answer"),
            (Some(_), None) => tracing::info!("the map answers again"),
            _ => {}
        }
        self.last_failure = failure;
    }

    /// Takes in what is still on its way at the end of the recording.
    pub(super) fn take_the_rest(&mut self, recorder: &mut Recorder) -> Result<(), EstimatorError> {
        if let Some(extracted) = self.extraction.as_mut().and_then(ExtractionThread::wait) {
            self.ask_with(extracted, recorder);
        }
        while let Some(answered) = self.queries.as_mut().and_then(QueryClient::wait) {
            self.hear_news(recorder);
            self.take(&answered, recorder)?;
        }
        Ok(())
    }
}
