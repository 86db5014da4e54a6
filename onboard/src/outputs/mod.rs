//! What a run puts out: files, the summary, messages.

mod files;
mod hand_in;
mod metrics;
mod name_watch;
mod publisher;
mod publisher_error;
mod recorder;
#[cfg(feature = "bags")]
mod recording;
#[cfg(not(feature = "bags"))]
#[path = "no_recording.rs"]
mod recording;
#[cfg(feature = "bags")]
mod recording_queue;
mod recording_settings;
mod ros;
#[cfg(feature = "bags")]
mod sensor_topics;
mod status_line;
mod status_word;
mod summary;
mod zenoh_output;

pub use files::{EVENTS, OutputError, STATES};
pub(crate) use hand_in::{HandInOutput, HandInSettings};
pub use metrics::RobotMetrics;
pub use publisher::Publisher;
pub use publisher_error::PublisherError;
pub use recorder::Recorder;
pub(crate) use recording::MessageRecording;
pub(crate) use recording_settings::RecordingSettings;
#[cfg(feature = "ros")]
pub use ros::RosOutputTask;
pub use ros::{BaseMount, InitialPoseTopic, RosBody, RosFrames, RosOutput, RosSettings, SensorFrames};
pub use status_line::StatusLine;
pub(crate) use status_word::status_word;
pub use summary::{EndedLost, Summary};
pub use zenoh_output::ZenohOutput;
