//! Strategies for every message.
#![allow(dead_code)] // each test file uses its part

mod maps;
mod matching;
mod robots;
mod values;

pub use maps::*;
pub use matching::*;
pub use robots::*;
pub use values::*;

use proptest::strategy::Strategy;
use protocol::SCHEMA_VERSION;

/// One value of a strategy, the same every time.
pub fn example<T: std::fmt::Debug>(strategy: impl Strategy<Value = T>) -> T {
    let mut runner = proptest::test_runner::TestRunner::deterministic();
    proptest::strategy::ValueTree::current(&strategy.new_tree(&mut runner).unwrap())
}

/// Makes length and checksum right again: what a hostile sender, rather than a bad line, would send.
pub fn resealed(payload: &[u8], tag: u16) -> Vec<u8> {
    sealed_as(SCHEMA_VERSION, payload, tag)
}

/// The envelope of any schema around a payload.
pub fn sealed_as(schema: u16, payload: &[u8], tag: u16) -> Vec<u8> {
    let mut bytes = b"DRFT".to_vec();
    bytes.extend(schema.to_le_bytes());
    bytes.extend(tag.to_le_bytes());
    bytes.extend((payload.len() as u32).to_le_bytes());
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&bytes[4..12]);
    hasher.update(payload);
    bytes.extend(hasher.finalize().to_le_bytes());
    bytes.extend(payload);
    bytes
}
