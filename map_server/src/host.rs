//! What a server shares with the maps that it serves by cells.

use std::sync::Arc;

use recognition::RecognitionOptions;
use zenoh::Session;

use crate::cells::{CellDrawings, CellMemory};
use crate::metrics::ServerMetrics;
use crate::queue::Queue;
use crate::state::ServerState;

/// What a map that is served by cells needs of its server.
#[derive(Clone)]
pub(crate) struct Host {
    pub(crate) session: Session,
    /// Name of the server.
    pub(crate) server: String,
    pub(crate) queue: Arc<Queue>,
    pub(crate) metrics: Arc<ServerMetrics>,
    pub(crate) options: RecognitionOptions,
    pub(crate) memory: Arc<CellMemory>,
    /// Where a page draws them.
    pub(crate) drawings: Option<Arc<CellDrawings>>,
    pub(crate) state: Option<Arc<ServerState>>,
}
