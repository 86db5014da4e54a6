//! Settings of a server.

use std::sync::Arc;

use recognition::RecognitionOptions;

use crate::state::ServerState;

/// Settings of a server.
///
/// ```
/// let mut options = map_server::ServerOptions::default();
/// options.name = Some("north".into());
/// options.workers = 4;
/// ```
#[derive(Clone)]
#[non_exhaustive]
pub struct ServerOptions {
    /// Name of the server in its liveliness key. `None`: the id of its Zenoh session.
    pub name: Option<String>,
    /// Settings of recognition for all maps.
    pub recognition: RecognitionOptions,
    /// Queries answered at the same time.
    pub workers: usize,
    /// Queries that may wait; any more are answered with [`protocol::ErrorCode::Busy`].
    pub queue_length: usize,
    /// Limit on the sum of the payloads of waiting queries, bytes.
    pub queue_bytes: usize,
    /// Bytes that loaded cells of maps that are served by cells may take; `None` without a bound. Further cells are on disk, in
    /// the cache of their map, until they are asked for.
    pub cell_memory: Option<usize>,
    /// Whether maps that are served by cells are drawn by [`Show`](crate::Show); what is drawn takes at most some 60 MB a map.
    pub draws_cells: bool,
    /// Where the server notes which version of each map it serves; `None`: nowhere.
    pub state: Option<Arc<ServerState>>,
}

impl Default for ServerOptions {
    /// One worker per processor; 64 waiting queries of 64 MiB together; all cells in memory, none drawn; no state.
    fn default() -> ServerOptions {
        ServerOptions {
            name: None,
            recognition: RecognitionOptions::default(),
            workers: std::thread::available_parallelism().map_or(2, std::num::NonZero::get),
            queue_length: 64,
            queue_bytes: 64 << 20,
            cell_memory: None,
            draws_cells: false,
            state: None,
        }
    }
}
