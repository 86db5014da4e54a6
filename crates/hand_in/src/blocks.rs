//! The blocks of a whole file, before anything of them is decoded.

use std::path::Path;

use crate::MAGIC;
use crate::block::{self, Block, kind};
use crate::error::HandInError;
use crate::schema::Schema;

/// The blocks behind the header, up to the first that is not whole or to the signature.
pub(crate) struct Blocks<'a> {
    bytes: &'a [u8],
    schema: Schema,
    /// Where the next block begins: so many bytes are whole.
    at: usize,
    is_ended: bool,
}

impl<'a> Blocks<'a> {
    /// The header of a file, and the blocks behind it.
    ///
    /// # Arguments
    /// * `path`: what the file is called in errors.
    ///
    /// # Errors
    /// [`HandInError::OtherFormat`], [`HandInError::Schema`], [`HandInError::NoHeader`].
    pub(crate) fn of_file(path: &Path, bytes: &'a [u8]) -> Result<(Block<'a>, Self), HandInError> {
        let own = || path.to_owned();
        let after_magic =
            bytes.strip_prefix(MAGIC).ok_or_else(|| HandInError::OtherFormat { path: own() })?;
        let (schema, rest) =
            after_magic.split_first_chunk::<2>().ok_or_else(|| HandInError::NoHeader { path: own() })?;
        let found = u16::from_le_bytes(*schema);
        let expected = Schema::NEWEST.number();
        let schema =
            Schema::of_number(found).ok_or_else(|| HandInError::Schema { path: own(), found, expected })?;
        let header = block::first(rest).filter(|block| block.kind == kind::HEADER);
        let header = header.ok_or_else(|| HandInError::NoHeader { path: own() })?;
        let at = bytes.len() - rest.len() + header.size;
        Ok((header, Self { bytes, schema, at, is_ended: false }))
    }

    /// The version of the file's format.
    pub(crate) fn schema(&self) -> Schema {
        self.schema
    }

    /// How many bytes of the file are whole: those up to the end of the block that came last.
    pub(crate) fn whole_bytes(&self) -> usize {
        self.at
    }
}

impl<'a> Iterator for Blocks<'a> {
    /// Where a block begins, and the block.
    type Item = (usize, Block<'a>);

    fn next(&mut self) -> Option<Self::Item> {
        let rest = self.bytes.get(self.at..).filter(|_| !self.is_ended)?;
        let block = block::first(rest)?;
        let begin = self.at;
        self.at += block.size;
        self.is_ended = block.kind == kind::SIGNATURE;
        Some((begin, block))
    }
}
