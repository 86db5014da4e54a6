//! Everything that comes from outside is either a value that keeps its invariants or an error, never a panic.
//!
//! Each target takes arbitrary bytes. `cargo fuzz` drives them with libFuzzer (`just fuzz TARGET`); the test `short_run`
//! drives them on a stable toolchain with the seeds in `corpus/` and seeded mutations of them.

mod files;
mod messages;

pub use files::{csv_tables, sensor_yaml};
pub use messages::{protocol_bincode, protocol_json};

/// A fuzz target.
pub type Target = fn(&[u8]);

/// All targets with their names.
pub const TARGETS: [(&str, Target); 4] = [
    ("protocol_bincode", protocol_bincode),
    ("protocol_json", protocol_json),
    ("sensor_yaml", sensor_yaml),
    ("csv_tables", csv_tables),
];
