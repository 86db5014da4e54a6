//! In place of the commands of stages, in a build without releases.

pub use super::left_out::Args as PromoteArgs;
pub use super::left_out::Args as RejectArgs;

pub use super::releases::refuse as promote;
pub use super::releases::refuse as reject;
