//! Lists that are refused at the first element too many, before the rest is read.

use serde::de::{Error, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};
use std::fmt;
use std::marker::PhantomData;

/// Longest list for which memory is reserved as announced.
const MOST_RESERVED: usize = 1024;

/// Reads a list of at most `MOST` elements:
/// `#[serde(deserialize_with = "bounded::list::<_, _, MOST>")]`
/// # Errors
/// Those of the deserializer, and a list of more than `MOST` elements.
pub fn list<'de, D: Deserializer<'de>, T: Deserialize<'de>, const MOST: usize>(
    deserializer: D,
) -> Result<Vec<T>, D::Error> {
    deserializer.deserialize_seq(ListVisitor::<T, MOST>(PhantomData))
}

struct ListVisitor<T, const MOST: usize>(PhantomData<T>);

impl<'de, T: Deserialize<'de>, const MOST: usize> Visitor<'de> for ListVisitor<T, MOST> {
    type Value = Vec<T>;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "a list of at most {MOST}")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut sequence: A) -> Result<Vec<T>, A::Error> {
        let too_long = || A::Error::custom(format!("a list has more than {MOST} elements"));
        let announced = sequence.size_hint().unwrap_or_default();
        if announced > MOST {
            return Err(too_long());
        }
        let mut items = Vec::with_capacity(announced.min(MOST_RESERVED));
        while let Some(item) = sequence.next_element()? {
            if items.len() == MOST {
                return Err(too_long());
            }
            items.push(item);
        }
        Ok(items)
    }
}
