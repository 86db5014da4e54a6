//! Vectors of numbers that are written and read piece by piece, not number by number.

use std::fmt;
use std::marker::PhantomData;

use nalgebra::Vector3;
use serde::de::{DeserializeSeed, Deserializer, Error as _, SeqAccess, Visitor};
use serde::ser::{SerializeSeq as _, Serializer};
use serde_bytes::Bytes;

/// Bytes of a piece: it stays in the processor's cache on its way.
const PIECE: usize = 32 << 10;

/// A value that takes the same number of bytes whatever it is.
pub trait Packed: Sized {
    /// How many, at most some hundreds.
    const BYTES: usize;

    /// Appends the bytes of the value, little-endian.
    fn pack(&self, bytes: &mut Vec<u8>);

    /// The value of [`Packed::BYTES`] bytes.
    fn unpack(bytes: &[u8]) -> Self;
}

macro_rules! packed_numbers {
    ($($number:ty),*) => {$(
        impl Packed for $number {
            const BYTES: usize = size_of::<$number>();

            #[inline]
            fn pack(&self, bytes: &mut Vec<u8>) {
                bytes.extend_from_slice(&self.to_le_bytes());
            }

            #[inline]
            fn unpack(bytes: &[u8]) -> Self {
                let mut own = [0; size_of::<$number>()];
                own.copy_from_slice(bytes);
                Self::from_le_bytes(own)
            }
        }
    )*};
}

packed_numbers!(u8, u32, u64, f32, f64);

impl<T: Packed, const N: usize> Packed for [T; N] {
    const BYTES: usize = N * T::BYTES;

    #[inline]
    fn pack(&self, bytes: &mut Vec<u8>) {
        for number in self {
            number.pack(bytes);
        }
    }

    #[inline]
    fn unpack(bytes: &[u8]) -> Self {
        std::array::from_fn(|at| T::unpack(&bytes[at * T::BYTES..(at + 1) * T::BYTES]))
    }
}

impl Packed for Vector3<f64> {
    const BYTES: usize = <[f64; 3]>::BYTES;

    #[inline]
    fn pack(&self, bytes: &mut Vec<u8>) {
        <[f64; 3]>::from(*self).pack(bytes);
    }

    #[inline]
    fn unpack(bytes: &[u8]) -> Self {
        <[f64; 3]>::unpack(bytes).into()
    }
}

/// Writes a vector: its length, then its bytes in pieces. Use it as `#[serde(with = "vision::packed")]`.
///
/// # Errors
/// Those of the serializer.
pub fn serialize<S: Serializer, T: Packed>(values: &[T], serializer: S) -> Result<S::Ok, S::Error> {
    let pieces = values.chunks(PIECE / T::BYTES);
    let mut sequence = serializer.serialize_seq(Some(1 + pieces.len()))?;
    sequence.serialize_element(&(values.len() as u64))?;
    let mut bytes = Vec::with_capacity(PIECE);
    for piece in pieces {
        bytes.clear();
        for value in piece {
            value.pack(&mut bytes);
        }
        sequence.serialize_element(Bytes::new(&bytes))?;
    }
    sequence.end()
}

/// Reads a vector into memory of exactly its length. For bytes that are trusted: the length is believed.
///
/// # Errors
/// Those of the deserializer, and pieces that are not as long together as the vector.
pub fn deserialize<'de, D: Deserializer<'de>, T: Packed>(deserializer: D) -> Result<Vec<T>, D::Error> {
    deserializer.deserialize_seq(Pieces(PhantomData))
}

struct Pieces<T>(PhantomData<T>);

impl<'de, T: Packed> Visitor<'de> for Pieces<T> {
    type Value = Vec<T>;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("the length of a vector, and its bytes in pieces")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut sequence: A) -> Result<Vec<T>, A::Error> {
        let length = sequence.next_element::<u64>()?.ok_or_else(|| A::Error::invalid_length(0, &self))?;
        let mut values = Vec::with_capacity(length as usize);
        while sequence.next_element_seed(Piece(&mut values))?.is_some() {}
        if values.len() as u64 == length {
            Ok(values)
        } else {
            Err(A::Error::invalid_length(values.len(), &self))
        }
    }
}

/// Appends the values of a piece.
struct Piece<'a, T>(&'a mut Vec<T>);

impl<'de, T: Packed> DeserializeSeed<'de> for Piece<'_, T> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_bytes(self)
    }
}

impl<T: Packed> Visitor<'_> for Piece<'_, T> {
    type Value = ();

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "values of {} bytes", T::BYTES)
    }

    fn visit_bytes<E: serde::de::Error>(self, bytes: &[u8]) -> Result<(), E> {
        let values = bytes.chunks_exact(T::BYTES);
        if !values.remainder().is_empty() {
            return Err(E::invalid_length(bytes.len(), &self));
        }
        self.0.extend(values.map(T::unpack));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use serde::{Deserialize, Serialize};

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct Vectors {
        #[serde(with = "super")]
        bytes: Vec<u8>,
        #[serde(with = "super")]
        numbers: Vec<u32>,
        #[serde(with = "super")]
        pixels: Vec<[f32; 2]>,
        #[serde(with = "super")]
        points: Vec<Vector3<f64>>,
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn vectors_come_back_and_what_is_cut_off_is_an_error(
            lengths in proptest::array::uniform4(0..3 * PIECE / 4), cut in any::<usize>(),
        ) {
            let values = |length: usize| (0..length).map(|at| at as f64 - 0.37 * (at * at) as f64);
            let vectors = Vectors {
                bytes: values(lengths[0]).map(|value| value as i64 as u8).collect(),
                numbers: values(lengths[1]).map(|value| value as i64 as u32).collect(),
                pixels: values(lengths[2]).map(|value| [value as f32, -value as f32]).collect(),
                points: values(lengths[3]).map(|value| Vector3::new(value, 1.0, -value)).collect(),
            };
            let written = bincode::serialize(&vectors).unwrap();
            let read: Vectors = bincode::deserialize_from(written.as_slice()).unwrap();
            prop_assert_eq!(read.numbers.capacity(), read.numbers.len());
            prop_assert_eq!(read, vectors);
            prop_assert!(bincode::deserialize_from::<_, Vectors>(&written[..cut % written.len()]).is_err());
        }
    }
}
