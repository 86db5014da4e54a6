//! In place of recordings, in a build without bags.

use super::recording_settings::RecordingSettings;
use robot::Output;
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
}

impl Output for MessageRecording {
    fn begin(&mut self, _: i64) {
        match self.0 {}
    }
}
