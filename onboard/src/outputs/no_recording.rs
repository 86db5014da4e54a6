//! In place of recordings, in a build without bags.

use super::event::Event;
use super::publisher::QueryCounts;
use super::recording_settings::RecordingSettings;
use super::ros::Estimate;
use estimator::{ImuSample, Status};
use geometry::PoseWithCovariance;
use sensors::Frame;
use sensors::live::Stream;
use std::convert::Infallible;
use std::path::Path;

/// There are none.
#[derive(Debug)]
pub(crate) struct MessageRecording(Infallible);

/// Why there is no recording.
#[derive(Debug, thiserror::Error)]
#[error("this build writes no recordings: build with the feature bags")]
pub(crate) struct NoRecording;

impl MessageRecording {
    pub(crate) fn start(_: &Path, _: RecordingSettings) -> Result<Self, NoRecording> {
        Err(NoRecording)
    }

    pub(crate) fn set_clock_shift(&mut self, _: i64) {
        match self.0 {}
    }

    pub(crate) fn restart(&mut self) {
        match self.0 {}
    }

    pub(crate) fn correct(&mut self, _: &PoseWithCovariance, _: &PoseWithCovariance) {
        match self.0 {}
    }

    pub(crate) fn estimate(&mut self, _: &Estimate) {
        match self.0 {}
    }

    pub(crate) fn status(&mut self, _: i64, _: &Status, _: QueryCounts) {
        match self.0 {}
    }

    pub(crate) fn first_status(&mut self, _: &Status, _: QueryCounts) {
        match self.0 {}
    }

    pub(crate) fn begin(&mut self, _: i64) {
        match self.0 {}
    }

    pub(crate) fn event(&mut self, _: &Event) {
        match self.0 {}
    }

    pub(crate) fn set_best_effort(&mut self, _: &[Stream]) {
        match self.0 {}
    }

    pub(crate) fn reading(&mut self, _: &ImuSample) {
        match self.0 {}
    }

    pub(crate) fn frame(&mut self, _: &Frame) {
        match self.0 {}
    }
}
