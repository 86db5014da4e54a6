//! From a query about a map that is served by cells to the answer of one of them.
//!
//! | module | what |
//! |---|---|
//! | [`directory`] | which cells an image could be of |
//! | `routed_map` | a query from its receipt to the answer of one cell |

pub mod directory;
mod routed_map;

pub use directory::{CellDirectory, CellSearch};
pub(crate) use routed_map::RoutedMap;
