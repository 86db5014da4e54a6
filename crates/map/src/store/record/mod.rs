//! The bytes of a record in a database, whichever database that is.

mod envelope;
mod error;
mod layout;

pub(super) use envelope::{seal, unseal, unseal_info};
pub use error::RecordError;
pub(super) use layout::{CrossCovarianceRecord, InfoRecord, KeyframeRecord, LandmarkRecord};
