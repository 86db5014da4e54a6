//! What tests of maps share: scenarios, sessions over one place, queries, and the errors of maps.

pub mod map_errors;
pub mod requests;
pub mod scenario;
pub mod sessions;
