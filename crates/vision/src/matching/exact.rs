//! Vectors that are read into memory of exactly their length.

use std::marker::PhantomData;

use serde::de::{Deserialize, Deserializer, SeqAccess, Visitor};

/// Reads a vector whose length comes first, without the room for more that a vector has that grew. For bytes that are trusted:
/// their length is believed. Use it as `#[serde(deserialize_with = "vision::exact")]`.
///
/// # Errors
/// Those of the deserializer.
pub fn exact<'de, D: Deserializer<'de>, T: Deserialize<'de>>(deserializer: D) -> Result<Vec<T>, D::Error> {
    deserializer.deserialize_seq(Exact(PhantomData))
}

struct Exact<T>(PhantomData<T>);

impl<'de, T: Deserialize<'de>> Visitor<'de> for Exact<T> {
    type Value = Vec<T>;

    fn expecting(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str("a sequence")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut sequence: A) -> Result<Vec<T>, A::Error> {
        let mut all = Vec::with_capacity(sequence.size_hint().unwrap_or(0));
        while let Some(next) = sequence.next_element()? {
            all.push(next);
        }
        Ok(all)
    }
}
