//! Descriptors of features: their kind, their format, and a list of them.

use crate::bounded;
use crate::features::MAX_FEATURES;
use crate::hexadecimal;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Data type of descriptors, which decides how they are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DescriptorKind {
    /// Bits, compared by Hamming distance.
    Binary,
    /// `f32` numbers in little-endian bytes, compared by L2 or cosine distance.
    Float,
    /// Signed bytes, compared by cosine distance.
    Int8,
}

impl DescriptorKind {
    /// Its name in files and JSON.
    pub fn label(self) -> &'static str {
        match self {
            Self::Binary => "binary",
            Self::Float => "float",
            Self::Int8 => "int8",
        }
    }

    /// The kind with that name.
    ///
    /// ```
    /// use types::DescriptorKind;
    /// assert_eq!(DescriptorKind::from_label("int8"), Some(DescriptorKind::Int8));
    /// assert_eq!(DescriptorKind::from_label("hex"), None);
    /// ```
    pub fn from_label(label: &str) -> Option<Self> {
        [Self::Binary, Self::Float, Self::Int8].into_iter().find(|kind| kind.label() == label)
    }
}

/// Kind and size of the descriptors of an image or of a whole map; only descriptors of equal format can be matched.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct DescriptorFormat {
    /// How they are compared.
    pub kind: DescriptorKind,
    /// Bytes per descriptor.
    pub width: u16,
}

/// A list of descriptors of one kind and width, stored contiguously.
///
/// In JSON: `{"kind": "binary", "width": 32, "hex": ["76f9e9..", ..]}`, one string per descriptor, as in
/// `features.csv`. In bincode: kind, width and all bytes as one string.
///
/// ```
/// use types::{DescriptorKind, Descriptors};
/// let descriptors = Descriptors { kind: DescriptorKind::Binary, width: 2, bytes: vec![1, 2, 3, 4] };
/// assert_eq!(descriptors.len(), 2);
/// assert_eq!(descriptors.get(1), Some(&[3, 4][..]));
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Descriptors {
    /// How they are compared.
    pub kind: DescriptorKind,
    /// Bytes per descriptor.
    pub width: u16,
    /// All descriptors one after the other: `len() * width` bytes.
    pub bytes: Vec<u8>,
}

impl Descriptors {
    /// No descriptors, of the given format.
    pub fn empty(format: DescriptorFormat) -> Self {
        Self { kind: format.kind, width: format.width, bytes: Vec::new() }
    }

    /// Kind and width.
    pub fn format(&self) -> DescriptorFormat {
        DescriptorFormat { kind: self.kind, width: self.width }
    }

    /// Number of descriptors (complete ones, if the bytes were not validated).
    pub fn len(&self) -> usize {
        self.bytes.len().checked_div(usize::from(self.width)).unwrap_or(0)
    }

    /// Whether the list is empty.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The bytes of descriptor `index`, `None` beyond the last.
    pub fn get(&self, index: usize) -> Option<&[u8]> {
        let width = usize::from(self.width);
        let start = index.checked_mul(width)?;
        if width == 0 { None } else { self.bytes.get(start..start.checked_add(width)?) }
    }

    /// Every descriptor in order.
    pub fn iter(&self) -> std::slice::ChunksExact<'_, u8> {
        self.bytes.chunks_exact(usize::from(self.width).max(1))
    }
}

impl<'a> IntoIterator for &'a Descriptors {
    type Item = &'a [u8];
    type IntoIter = std::slice::ChunksExact<'a, u8>;
    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

#[derive(Serialize, Deserialize)]
struct JsonForm {
    kind: DescriptorKind,
    width: u16,
    #[serde(deserialize_with = "bounded::list::<_, _, MAX_FEATURES>")]
    hex: Vec<String>,
}

#[derive(Serialize, Deserialize)]
struct BinaryForm<'a> {
    kind: DescriptorKind,
    width: u16,
    #[serde(borrow)]
    bytes: std::borrow::Cow<'a, serde_bytes::Bytes>,
}

impl Serialize for Descriptors {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if serializer.is_human_readable() {
            let hex = self.iter().map(hexadecimal::encode).collect();
            JsonForm { kind: self.kind, width: self.width, hex }.serialize(serializer)
        } else {
            let bytes = std::borrow::Cow::Borrowed(serde_bytes::Bytes::new(&self.bytes));
            BinaryForm { kind: self.kind, width: self.width, bytes }.serialize(serializer)
        }
    }
}

impl<'de> Deserialize<'de> for Descriptors {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        if !deserializer.is_human_readable() {
            let form = BinaryForm::deserialize(deserializer)?;
            return Ok(Self {
                kind: form.kind,
                width: form.width,
                bytes: form.bytes.into_owned().into_vec(),
            });
        }
        let form = JsonForm::deserialize(deserializer)?;
        let mut bytes = Vec::new();
        for (index, text) in form.hex.iter().enumerate() {
            append_hex(text, usize::from(form.width), &mut bytes)
                .map_err(|error| serde::de::Error::custom(format!("hex[{index}] {error}")))?;
        }
        Ok(Self { kind: form.kind, width: form.width, bytes })
    }
}

/// Why a text is no descriptor.
#[derive(Debug, thiserror::Error)]
enum HexError {
    #[error("has {characters} characters, not the {} digits of {width} bytes", 2 * width)]
    Length { characters: usize, width: usize },
    #[error("is not hexadecimal")]
    Digit,
}

/// Appends the `width` bytes written as `2 * width` hexadecimal digits.
fn append_hex(text: &str, width: usize, bytes: &mut Vec<u8>) -> Result<(), HexError> {
    if text.len() != 2 * width {
        return Err(HexError::Length { characters: text.len(), width });
    }
    bytes.extend(hexadecimal::decode(text).ok_or(HexError::Digit)?);
    Ok(())
}
