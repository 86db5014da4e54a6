//! What comes from outside is either a value that keeps its invariants or an error, never a panic.
//!
//! | target | what |
//! |---|---|
//! | `protocol_bincode`, `protocol_json` | messages of Zenoh |
//! | `sensor_messages`, `ros_messages` | messages of live sensors and of bags |
//! | `sensor_yaml`, `csv_tables`, `images` | files of recordings |
//! | `sqlite_bags`, `mcap_bags`, `rosbag1_bags` | bags |
//! | `colmap_models` | models of COLMAP |
//! | `store_records`, `session_files`, `weights` | files of maps, of sessions that robots hand in, of extractors |
//! | `http_heads` | requests of HTTP |
//!
//! Maps in plain text, settings and what a broker of MQTT sends have no target.
//!
//! Each target takes arbitrary bytes. `cargo fuzz` drives them with libFuzzer (`just fuzz TARGET`); the test `short_run`
//! drives them on a stable toolchain with the seeds in `corpus/` and seeded mutations of them, each for a second (`FUZZ_SECONDS`).

mod bags;
mod colmap;
mod files;
mod http;
mod images;
mod messages;
mod records;
mod sensor_messages;
mod sessions;
mod weights;

pub use bags::{mcap_bags, rosbag1_bags, sqlite_bags};
pub use colmap::{colmap_files, colmap_models};
pub use files::{csv_tables, sensor_yaml};
pub use http::http_heads;
pub use images::images;
pub use messages::{bincode_payloads, protocol_bincode, protocol_json};
pub use records::store_records;
pub use sensor_messages::{ros_messages, sensor_messages};
pub use sessions::session_files;
pub use weights::weights;

/// A fuzz target.
pub type Target = fn(&[u8]);

/// All targets with their names.
pub const TARGETS: &[(&str, Target)] = &[
    ("protocol_bincode", protocol_bincode),
    ("protocol_json", protocol_json),
    ("sensor_yaml", sensor_yaml),
    ("csv_tables", csv_tables),
    ("images", images),
    ("sqlite_bags", sqlite_bags),
    ("mcap_bags", mcap_bags),
    ("rosbag1_bags", rosbag1_bags),
    ("colmap_models", colmap_models),
    ("http_heads", http_heads),
    ("store_records", store_records),
    ("sensor_messages", sensor_messages),
    ("ros_messages", ros_messages),
    ("session_files", session_files),
    ("weights", weights),
];
