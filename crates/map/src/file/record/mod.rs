//! The bytes of a record: one element of a map.

mod element;
mod envelope;
mod error;
mod layout;
mod table;

pub use element::{Element, key_bytes};
pub(crate) use envelope::{HEADER_BYTES, payload};
pub use envelope::{decode, open, seal, unseal};
pub use error::RecordError;
pub(crate) use layout::{LandmarkObservers, kind_to_byte};
pub use table::Table;
