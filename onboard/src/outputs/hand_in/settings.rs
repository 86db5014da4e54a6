//! Where sessions go, and how much.

use hand_in::Header;
use signing::SecretKey;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

/// What a robot records for its map.
#[derive(Clone, Debug)]
pub(crate) struct HandInSettings {
    /// The folder of the sessions.
    pub(crate) folder: PathBuf,
    /// Who records, with which sensors; the time and the name are those of each session.
    pub(crate) header: Header,
    /// Signs the sessions.
    pub(crate) key: Option<Arc<SecretKey>>,
    /// Bytes that a minute may take.
    pub(crate) bytes_per_minute: f64,
    /// A session ends after so long, and the next begins.
    pub(crate) session_length: Duration,
    /// Bytes of the sessions in the folder from which on no session is begun.
    pub(crate) most_bytes: u64,
    /// Whether events are dropped where the disk is too slow.
    pub(crate) realtime: bool,
}
