//! Maps that are served by cells, by several servers together.
//!
//! Each server has some cells of the newest release, and of all cells what tells from afar which of them an image could be of. A robot
//! asks any server, by the keys of any map; that server asks the cells in question, here or at another server, and passes on the
//! answer of one ([`routing`](crate::routing)). Cells overlap by their borders and keep all correlations of their keyframes, so that the answer of one cell is
//! that of the whole map.
//!
//! | key (below the session's namespace) | what |
//! |---|---|
//! | `map/{map}/match`, `../localize`, `../info`, `../keyframes/{id}` | as of any map, at every server |
//! | `map/{map}/cell/{cell}/match`, `../localize`, `../keyframes/{id}` | one cell, at the servers that have it |
//! | `map/{map}/server/{server}` | liveliness: serves cells of the map |
//! | `map/{map}/cell/{cell}/server/{server}` | liveliness: has the cell |
//! | `map/{map}/version/{version}/server/{server}` | liveliness: has loaded the version, and changes over once all have |
//!
//! | module | what |
//! |---|---|
//! | `assignment` | which cells a server is to have |
//! | `cell_map` | the cells that a server has, declared and replaced |
//! | `memory` | how much memory cells may take, and which of them have it |
//! | `stored_cell` | one cell, in memory or on disk |
//! | `drawings` | what the live map draws of the cells that a server has |
//! | `cold_file` | the file of a cell that is not in memory |
//! | `tokens` | liveliness tokens of others |
//! | [`service`] | follows releases and the other servers |

mod assignment;
mod cell_map;
mod cold_file;
mod drawings;
mod memory;
pub mod service;
mod stored_cell;
mod tokens;

pub(crate) use drawings::{CellDrawings, DrawnMap};
pub(crate) use memory::CellMemory;
pub use service::{CellChoice, CellService, CellServiceOptions};
pub(crate) use stored_cell::{CellSlot, StoredCell};
