//! Releases of maps in an object store: a folder, Amazon S3, Google Cloud Storage or Azure (feature `cloud`).
//!
//! ```text
//! releases/00000000000000000007.json    what release 7 is: the map's identity and version, and the segments of its cells
//! candidates/00000000000000000003.json  what is proposed to be release 8
//! decisions/00000000000000000003.json   whether candidate 3 was promoted or rejected
//! signatures/{SHA-256}                  of the file of a release, a candidate or a decision, where it is signed
//! segments/{SHA-256}                    the keyframes, landmarks and cross-covariances of a cell, of its border, its coarse landmarks
//! ```
//! A segment has the bytes that [`map::file`] describes: a release is a map cut into cells.
//!
//! Nothing is ever overwritten: segments are named by their content, and a release is put under the next number only if that
//! number is free. Of two that publish at once, one is told that the other was first. A segment that did not change is not sent
//! again. An upload that was stopped leaves segments that no release names; [`clean`](fn@clean) removes them after some time.
//!
//! | module | what |
//! |---|---|
//! | [`partition`] | cells: a k-d tree over the ground plane, which later releases keep |
//! | `cells` | a map cut into cells with their borders, and put together again without loss |
//! | [`coarse`] | what tells from afar of which cells an image could be |
//! | [`change`] | what changed from one release to the next |
//! | [`release`] | what a release is |
//! | [`stage`] | what is live and what is proposed; who did it and why |
//! | [`candidates`] | promoting and rejecting what is proposed |
//! | [`place`] | which release of which store, in one word |
//! | [`store`] | the object store |
//! | [`publish`](mod@publish) | publishing a map, going back to a former release |
//! | [`fetch`](mod@fetch) | the map of a release or single cells of it, every byte verified |
//! | [`source`] | a store with its cache, as a server has them |
//! | [`cache`] | segments and the newest release, kept on disk |
//! | [`clean`](mod@clean) | removing what no release needs |
//!
//! What is signed (crate `signing`) are the bytes of a release's file, which names the SHA-256 of every segment, its own number and
//! its stage: who can write to the store but has no key can take releases away, and cannot make or change one, nor make a candidate
//! live. Whoever promotes or rolls back with a key signs only what was signed with it before. A decision about a
//! candidate is signed too, and names the digest of its map.
//!
//! # Example
//! ```
//! use map::{MapContents, MapMetadata};
//! use protocol::DescriptorKind;
//! use releases::{PublishOptions, ReleaseStore, fetch, publish};
//!
//! # #[tokio::main]
//! # async fn main() -> Result<(), Box<dyn std::error::Error>> {
//! # let folder = tempfile::tempdir()?;
//! # let place = folder.path().display().to_string();
//! let store = ReleaseStore::open(&place)?; // or s3://bucket/city
//! let map = MapContents::empty(MapMetadata::new("city", "example", DescriptorKind::Binary, 32));
//! publish(&store, map, &PublishOptions::default(), |_| {}).await?;
//!
//! let newest = store.newest().await?.ok_or("nothing was published")?;
//! assert_eq!(newest.number, 1);
//! assert_eq!(fetch(&store, &newest, None).await?.keyframes.len(), 0);
//! # Ok(())
//! # }
//! ```
#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod cache;
pub mod candidates;
mod cells;
pub mod change;
pub mod clean;
mod cleaning;
pub mod coarse;
mod damage;
mod error;
pub mod fetch;
pub mod partition;
pub mod place;
pub mod publish;
pub mod release;
pub mod source;
pub mod stage;
pub mod store;

pub use cache::ReleaseCache;
pub use candidates::{candidate_state, promote, reject};
pub use change::{ReleasedChange, difference, keyframe_difference};
pub use clean::{CleanOptions, Cleaned, clean};
pub use coarse::{CoarseCell, CoarseLandmark};
pub use damage::Damage;
pub use error::ReleaseError;
pub use fetch::{Cell, fetch, fetch_cell, fetch_coarse, fetch_without_images};
pub use map::file::{SegmentError, SegmentName};
pub use partition::{CellId, Partition, PartitionError};
pub use place::{ReleaseChoice, ReleaseChoiceError, ReleasePlace};
pub use publish::{Outcome, Progress, PublishOptions, Published, publish, roll_back};
pub use release::{Release, ReleaseDifference, ReleasedCell, ServedCell};
#[cfg(feature = "signing")]
pub use signing::{KeyError, SecretKey as SigningKey};
pub use signing::{PublicKey as ReleaseKey, PublicKeyError as ReleaseKeyError, SignatureError};
pub use source::ReleaseSource;
pub use stage::{CandidateState, Decision, Note, Stage, Verdict};
pub use store::ReleaseStore;
