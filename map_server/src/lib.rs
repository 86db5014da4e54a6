//! The map server: Zenoh queryables around [`recognition::LoadedMap`]s.
//!
//! | key (below the session's namespace) | query | answer |
//! |---|---|---|
//! | `map/{map}/match` | [`protocol::MatchRequest`] | [`protocol::MatchReply`]s, the last of them `Done` |
//! | `map/{map}/localize` | [`protocol::LocalizeRequest`] | [`protocol::LocalizeReply`] |
//! | `map/{map}/info` | no payload | [`protocol::MapInfoReply`] |
//! | `map/{map}/keyframes/{id}` | no payload | [`protocol::KeyframeReply`]; `*` for all, one per reply |
//! | `map/{map}/sessions/{robot}` | [`protocol::SessionPart`] | [`protocol::SessionPartReply`]; of a server with an inbox |
//! | `map/{map}/changes` | | publishes [`protocol::MapChangeNotice`] when a map is replaced |
//! | `map_server/{server}` | | liveliness token, declared after all queryables |
//!
//! Replies are bincode, or JSON if the query says `?format=json` or has a JSON payload. Errors are
//! [`protocol::ErrorReply`]s, sent as Zenoh error replies.
//!
//! | module | what |
//! |---|---|
//! | [`server`] | [`MapServer`]: start, replace a map, stop |
//! | [`options`] | [`ServerOptions`] |
//! | [`arguments`], [`map_argument`], [`byte_size`] | the command line of the program |
//! | [`cells`] | maps that several servers serve together, by cells |
//! | [`routing`] | a query about such a map, from its receipt to the answer of one cell |
//! | [`served_map`] | [`ServedMap`]: a map and its name |
//! | `queue`, `fair_queue` | queries between the network and the workers: bounded, counted, fair to clients |
//! | `workers` | the threads that answer queries |
//! | `senders` | which sessions are connected, and whose certificates they have |
//! | `handlers` | decodes a query, answers it, encodes the reply |
//! | `names` | no two servers of one name |
//! | `reports` | tells what became of each query |
//! | `durations` | how long queries take, as counts in buckets |
//! | [`show`], [`images`] | the live map in the browser, and images that people give to it |
//! | [`inbox`] | takes sessions that robots hand in |
//! | `change` | differences between two versions of a map |
//! | [`state`] | what a server keeps from one run to the next: which version it serves |
//!
//! # Requirements on clients
//! `driftless-client` meets them:
//! * A match answer has several replies on one key: query with `ConsolidationMode::None`, or Zenoh keeps one of them.
//! * Zenoh 1.10 sends replies with the congestion control *of the query* (`Block` by default). Query with `Block`, or
//!   large replies may be dropped.
//! * No reply at all is a failure to be retried, never "no match".
//!
//! # Unknown maps
//! The queryables of a served map are complete. In addition the server declares incomplete ones on `map/*/match`,
//! `map/*/localize`, `map/*/info` and `map/*/keyframes/*`. Zenoh's default target (`BestMatching`) prefers a complete
//! queryable anywhere in the network and uses the incomplete ones only if there is none: a map of another server is
//! never shadowed, and a query about a map that no server has is answered with
//! [`protocol::ErrorCode::UnknownMap`] and a list of the maps served. While a client is still connecting, the server
//! that has the map may not be visible yet.

#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod arguments;
pub mod byte_size;
pub mod cells;
mod change;
mod durations;
pub mod error;
mod fair_queue;
mod handlers;
mod host;
pub mod images;
pub mod inbox;
mod kind;
pub mod map_argument;
mod metrics;
mod names;
pub mod options;
mod queue;
mod reports;
pub mod routing;
mod senders;
pub mod served_map;
pub mod server;
pub mod show;
mod show_cells;
mod show_releases;
mod show_statistics;
pub mod state;
mod workers;

pub use cells::{CellChoice, CellService, CellServiceOptions};
pub use durations::DurationCounts;
pub use error::ServeError;
pub use images::ImageLocalizer;
pub use inbox::InboxService;
pub use metrics::ServerStatistics;
pub use options::ServerOptions;
pub use reports::{AnsweredQuery, QueryReport};
pub use served_map::ServedMap;
pub use server::{MapServer, Replacement};
pub use show::Show;
pub use state::ServerState;
