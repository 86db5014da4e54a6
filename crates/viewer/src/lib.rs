//! The live map in the browser: what `map_server --http` and `driftless view` serve.
//!
//! The page, its scripts and three.js are part of the program, so that it works where there is no internet, and asks no
//! other host for anything. Whoever serves it gives a [`Viewer`] the maps, and follows robots with [`follow_robots`].
//!
//! | path | answer |
//! |---|---|
//! | `/` and the names of [`assets`] | the page |
//! | `/api/maps` | the maps: name, identity, version, counts, extent, direction of gravity |
//! | `/api/maps/{map}/keyframes` | poses with the covariance of the position, metres, in the map's frame G |
//! | `/api/maps/{map}/keyframes/{id}/image` | the image of a keyframe, JPEG, where the map keeps it |
//! | `/api/maps/{map}/landmarks?limit=N` | positions in G as little-endian `f32` triples, metres; an even sample of N |
//! | `/api/maps/{map}/changes` | keyframes that moved, appeared or are gone, since the release before and in an open candidate |
//! | `/api/maps/{map}/cameras` | the different cameras of the keyframes |
//! | POST `/api/maps/{map}/localize?camera=N` | where an image was taken, where there is a [`LocalizeImage`] |
//! | `/api/run` | the tracks of a recorded run, or 404 |
//! | `/api/queries?robot=NAME&after=N&limit=N` | the last queries: candidates, inliers, reasons; newest first |
//! | `/api/history?from=MS&to=MS&map=NAME` | poses and states of robots in the last hour |
//! | `/api/statistics` | how busy the map server was in the last hour |
//! | `/api/live` | WebSocket: robots as they publish, at most 20 times a second |
//!
//! Beside images only GET is answered. Requests with the name of another host are refused, and those of pages of other
//! origins. What is kept is limited, whatever robots publish: [`MAX_QUERIES`] queries, [`MAX_SAMPLES`] samples of the
//! history, an hour of statistics. Connections are limited in number ([`MAX_CONNECTIONS`], [`MAX_VIEWERS`]), in time without
//! progress and in slowness, and answers that wait for slow readers in their bytes ([`MAX_UNSENT_BYTES`]).
//!
//! # Example
//! ```
//! use map::{MapContents, MapMetadata};
//! use protocol::DescriptorKind;
//! use viewer::{ViewedMap, Viewer, ViewerServer};
//!
//! # #[tokio::main(flavor = "current_thread")]
//! # async fn main() -> Result<(), viewer::ViewerError> {
//! let contents = MapContents::empty(MapMetadata::new("hall", "example", DescriptorKind::Binary, 32));
//! let viewer = Viewer::new();
//! viewer.set_map(ViewedMap::of_contents("hall", &contents));
//! let server = ViewerServer::start(([127, 0, 0, 1], 0).into(), viewer).await?;
//! println!("http://{}", server.address());
//! server.stop().await;
//! # Ok(())
//! # }
//! ```
#![cfg_attr(test, allow(clippy::unwrap_used))]

mod access;
mod api;
pub mod assets;
mod cameras;
mod changes;
mod clock;
mod error;
mod fair_log;
mod history;
mod images;
mod keyframe_images;
mod live;
mod outbox;
mod parameters;
mod queries;
pub mod run;
mod server;
mod statistics;
mod upload;
mod viewed_map;
mod viewed_part;

pub use changes::{ViewedChange, ViewedChanges};
pub use error::ViewerError;
pub use history::MAX_SAMPLES;
pub use images::{GivenImage, ImageCamera, ImageError, LocalizeImage, MAX_IMAGE_BYTES};
pub use keyframe_images::KeyframeImages;
pub use live::{MAX_VIEWERS, RobotFollower, follow_robots};
pub use monitoring::MAX_CONNECTIONS;
pub use outbox::MAX_UNSENT_BYTES;
pub use queries::{
    CandidateVerdict, MAX_QUERIES, ViewedAnswer, ViewedCandidate, ViewedFix, ViewedQuery, ViewedResult,
};
pub use run::{RunTracks, TrackPoint};
pub use server::{Viewer, ViewerServer};
pub use statistics::{STATISTICS_PERIOD, ServerSample};
pub use viewed_map::{MAX_LANDMARKS, ViewedKeyframe, ViewedMap};
pub use viewed_part::{DrawnShare, MAX_KEYFRAMES, ViewedPart};
