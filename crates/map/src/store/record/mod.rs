//! The bytes of a record in a database, whichever database that is.

mod envelope;
mod error;
mod layout;

pub(crate) use envelope::payload;
pub use envelope::{decode, open, seal, unseal};
pub use error::RecordError;
pub use layout::{
    AliasesRecord, CommonErrorRecord, CrossCovarianceRecord, InfoRecord, KeyframeRecord, LandmarkObservers,
    LandmarkRecord,
};
