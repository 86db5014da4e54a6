//! Store, index, match and serve keyframe maps.
//!
//! | module | idea |
//! |---|---|
//! | [`model`] | what a map is made of |
//! | [`contents`] | a whole map in memory and the laws it keeps |
//! | [`store`] | maps at rest: a sled database behind the [`MapStore`] trait |
//! | [`recognition`] | which keyframes does an image show? |
//! | [`serve`] | maps on the network |

#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod contents;
pub mod model;
pub mod recognition;
pub mod serve;
pub mod store;

pub use contents::{ContentsError, MapContents};
pub use model::{CrossCovariance, Keyframe, Landmark, MapInfo, Observation};
pub use protocol::session;
pub use recognition::{LoadError, LoadedMap, QueryError, RecognitionOptions};
pub use serve::{MapServer, ServeError, ServedMap, ServerOptions, ServerStatistics};
pub use store::{Batch, Change, MapStore, STORE_SCHEMA, SledStore, StoreCounts, StoreError};
