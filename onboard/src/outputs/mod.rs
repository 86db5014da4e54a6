//! What a run puts out: files, the summary, messages.

mod event;
mod files;
mod name_watch;
mod publisher;
mod recorder;
mod summary;

pub use event::Event;
pub use files::{EVENTS, OutputError, STATES};
pub use publisher::{Publisher, PublisherError, QueryCounts};
pub use recorder::Recorder;
pub use summary::{
    DivergenceSummary, EndedLost, ImuGapSummary, MapChangeSummary, MillisecondsPerFrame, QuerySummary,
    StartSummary, Summary, Timings, TrackSummary, Traffic,
};
