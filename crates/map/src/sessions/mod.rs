//! The ledger of a map: which recorded sessions it was made of, so that none is counted twice.
//!
//! The ledger is part of [`MapMetadata`](crate::MapMetadata). A session has the keyframes of a range of ids, and the ranges of two
//! sessions are disjoint: so every keyframe has one session. A session of which an edit removed all keyframes stays in the
//! ledger, because the poses of the others still say what was learned from it.
//!
//! | module | what |
//! |---|---|
//! | `session` | [`Session`], [`SessionId`] |
//! | `recorded` | [`RecordedDigest`]: what of a recording identifies it |
//! | `overlap` | [`SessionOverlap`]: two sessions with the same readings |
//! | `budget` | how many samples of readings are kept |
//! | `counting` | what each session has in a map |
//! | `pixel_noise` | the noise of the map's pixels, by that of its sessions |
//! | `audit` | [`LedgerProblem`]: whether the ledger agrees with the map |
//! | `difference` | [`SessionDifference`]: sessions that came and went |

mod audit;
mod budget;
mod counting;
mod difference;
mod overlap;
mod pixel_noise;
mod recorded;
mod session;
mod utc_time;

pub use audit::LedgerProblem;
pub(crate) use audit::check_ledger;
pub use difference::{NamedSession, SessionDifference};
pub use overlap::{KnownSession, SessionOverlap, SharedReadings};
pub use recorded::{MAX_SAMPLES, ReadingSamples, Recorded, RecordedDigest};
pub use session::{MAX_TEXT_BYTES, Session, SessionId};
pub use utc_time::utc_time;
