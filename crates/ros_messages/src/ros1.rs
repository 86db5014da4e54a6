//! ROS 1 messages as the same structs, decoded with serde.
//!
//! ROS 1 writes numbers in little-endian order without padding, and strings and arrays behind their length in 32 bits. Its
//! `Header` begins with a sequence number, which ROS 2 has not, and which is skipped.

use crate::message::RosMessage;
use serde::de::{self, DeserializeSeed, SeqAccess, Visitor};
use std::fmt;

/// The struct in front of whose fields ROS 1 has a sequence number.
const HEADER: &str = "Header";

/// Why bytes are not the message.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{type_name}: {problem}")]
pub struct Ros1Error {
    /// The expected type.
    pub type_name: &'static str,
    /// What is wrong.
    pub problem: Ros1Problem,
}

/// What is wrong with the bytes of a message.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Ros1Problem {
    /// The bytes end too early.
    #[error("{0} bytes are too few: the message is truncated or of another type")]
    CutOff(usize),
    /// More bytes than the message has.
    #[error("{0} bytes are left after the message: is the topic of another type?")]
    TrailingBytes(usize),
    /// A string is not UTF-8.
    #[error("a string is not UTF-8: is the topic of another type?")]
    NotUtf8,
    /// The struct asks for a type that ROS 1 messages have not.
    #[error("the type {0} is not part of ROS 1 messages")]
    Unsupported(&'static str),
    /// A value that the struct does not take.
    #[error("{0}")]
    Value(String),
}

impl de::Error for Ros1Problem {
    fn custom<T: fmt::Display>(message: T) -> Self {
        Self::Value(message.to_string())
    }
}

/// Reads a message as ROS 1 writes it.
///
/// Lengths in the bytes are checked against what is there before anything is allocated for them.
///
/// # Errors
/// [`Ros1Error`]: the bytes are truncated, or of another type.
pub fn decode<M: RosMessage>(bytes: &[u8]) -> Result<M, Ros1Error> {
    let wrong = |problem| Ros1Error { type_name: M::TYPE_NAME, problem };
    let mut reader = Reader { all: bytes.len(), left: bytes };
    let message = M::deserialize(&mut reader).map_err(wrong)?;
    match reader.left.len() {
        0 => Ok(message),
        count => Err(wrong(Ros1Problem::TrailingBytes(count))),
    }
}

struct Reader<'a> {
    all: usize,
    left: &'a [u8],
}

impl<'a> Reader<'a> {
    fn bytes(&mut self, count: usize) -> Result<&'a [u8], Ros1Problem> {
        let (taken, left) = self.left.split_at_checked(count).ok_or(Ros1Problem::CutOff(self.all))?;
        self.left = left;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], Ros1Problem> {
        let all = self.all;
        self.bytes(N)?.try_into().map_err(|_| Ros1Problem::CutOff(all))
    }

    /// A length in front of a string or an array.
    fn length(&mut self) -> Result<usize, Ros1Problem> {
        Ok(u32::from_le_bytes(self.array()?) as usize)
    }

    fn text(&mut self) -> Result<&'a str, Ros1Problem> {
        let length = self.length()?;
        std::str::from_utf8(self.bytes(length)?).map_err(|_| Ros1Problem::NotUtf8)
    }
}

macro_rules! numbers {
    ($($method:ident $visit:ident $number:ty),*) => {$(
        fn $method<V: Visitor<'a>>(self, visitor: V) -> Result<V::Value, Ros1Problem> {
            visitor.$visit(<$number>::from_le_bytes(self.array()?))
        }
    )*};
}

macro_rules! unsupported {
    ($($method:ident $name:literal),*) => {$(
        fn $method<V: Visitor<'a>>(self, _: V) -> Result<V::Value, Ros1Problem> {
            Err(Ros1Problem::Unsupported($name))
        }
    )*};
}

impl<'a> de::Deserializer<'a> for &mut Reader<'a> {
    type Error = Ros1Problem;

    numbers!(
        deserialize_u8 visit_u8 u8, deserialize_u16 visit_u16 u16, deserialize_u32 visit_u32 u32,
        deserialize_u64 visit_u64 u64, deserialize_i8 visit_i8 i8, deserialize_i16 visit_i16 i16,
        deserialize_i32 visit_i32 i32, deserialize_i64 visit_i64 i64, deserialize_f32 visit_f32 f32,
        deserialize_f64 visit_f64 f64
    );

    unsupported!(
        deserialize_any "any", deserialize_char "char", deserialize_option "option", deserialize_map "map",
        deserialize_identifier "identifier", deserialize_ignored_any "any"
    );

    fn deserialize_bool<V: Visitor<'a>>(self, visitor: V) -> Result<V::Value, Ros1Problem> {
        let [byte] = self.array()?;
        visitor.visit_bool(byte != 0)
    }

    fn deserialize_str<V: Visitor<'a>>(self, visitor: V) -> Result<V::Value, Ros1Problem> {
        visitor.visit_borrowed_str(self.text()?)
    }

    fn deserialize_string<V: Visitor<'a>>(self, visitor: V) -> Result<V::Value, Ros1Problem> {
        self.deserialize_str(visitor)
    }

    fn deserialize_bytes<V: Visitor<'a>>(self, visitor: V) -> Result<V::Value, Ros1Problem> {
        let length = self.length()?;
        visitor.visit_borrowed_bytes(self.bytes(length)?)
    }

    fn deserialize_byte_buf<V: Visitor<'a>>(self, visitor: V) -> Result<V::Value, Ros1Problem> {
        self.deserialize_bytes(visitor)
    }

    fn deserialize_unit<V: Visitor<'a>>(self, visitor: V) -> Result<V::Value, Ros1Problem> {
        visitor.visit_unit()
    }

    fn deserialize_unit_struct<V: Visitor<'a>>(
        self,
        _: &'static str,
        visitor: V,
    ) -> Result<V::Value, Ros1Problem> {
        visitor.visit_unit()
    }

    fn deserialize_newtype_struct<V: Visitor<'a>>(
        self,
        _: &'static str,
        visitor: V,
    ) -> Result<V::Value, Ros1Problem> {
        visitor.visit_newtype_struct(self)
    }

    fn deserialize_seq<V: Visitor<'a>>(self, visitor: V) -> Result<V::Value, Ros1Problem> {
        let count = self.length()?;
        visitor.visit_seq(Elements { reader: self, left: count })
    }

    fn deserialize_tuple<V: Visitor<'a>>(self, count: usize, visitor: V) -> Result<V::Value, Ros1Problem> {
        visitor.visit_seq(Elements { reader: self, left: count })
    }

    fn deserialize_tuple_struct<V: Visitor<'a>>(
        self,
        _: &'static str,
        count: usize,
        visitor: V,
    ) -> Result<V::Value, Ros1Problem> {
        self.deserialize_tuple(count, visitor)
    }

    fn deserialize_struct<V: Visitor<'a>>(
        self,
        name: &'static str,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Ros1Problem> {
        if name == HEADER {
            self.bytes(4)?;
        }
        self.deserialize_tuple(fields.len(), visitor)
    }

    fn deserialize_enum<V: Visitor<'a>>(
        self,
        _: &'static str,
        _: &'static [&'static str],
        _: V,
    ) -> Result<V::Value, Ros1Problem> {
        Err(Ros1Problem::Unsupported("enum"))
    }

    fn is_human_readable(&self) -> bool {
        false
    }
}

/// Elements of an array, or fields of a struct.
struct Elements<'r, 'a> {
    reader: &'r mut Reader<'a>,
    left: usize,
}

impl<'a> SeqAccess<'a> for Elements<'_, 'a> {
    type Error = Ros1Problem;

    fn next_element_seed<T: DeserializeSeed<'a>>(
        &mut self,
        seed: T,
    ) -> Result<Option<T::Value>, Ros1Problem> {
        if self.left == 0 {
            return Ok(None);
        }
        self.left -= 1;
        seed.deserialize(&mut *self.reader).map(Some)
    }

    /// No more than there are bytes, so that a wrong length allocates nothing.
    fn size_hint(&self) -> Option<usize> {
        Some(self.left.min(self.reader.left.len()))
    }
}
