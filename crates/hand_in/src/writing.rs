//! Writes session files, block by block.

use std::fs::File;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use crate::MAGIC;
use crate::block::{self, kind};
use crate::chunk::{self, Chunk, ChunkFormat};
use crate::error::HandInError;
use crate::header::{self, Header};
use crate::schema::Schema;

/// A session file that is being written. Each block is on the disk before the next is begun: whatever stops the program, what was
/// written as a whole is read.
#[derive(Debug)]
pub struct SessionWriter {
    path: PathBuf,
    file: File,
    format: ChunkFormat,
    bytes: u64,
}

impl SessionWriter {
    /// Creates a file, which must not exist.
    ///
    /// # Errors
    /// [`HandInError::Io`], a full disk among them.
    pub fn create(path: &Path, header: &Header) -> Result<Self, HandInError> {
        let encoded =
            header::encode(header).map_err(|source| HandInError::Header { path: path.to_owned(), source })?;
        let file = File::options().write(true).create_new(true).open(path);
        let file = file.map_err(|source| HandInError::Io { path: path.to_owned(), source })?;
        let schema = Schema::of_cameras(&header.cameras);
        let format = ChunkFormat { schema, steps: header.steps(), cameras: header.cameras.len() };
        let mut writer = Self { path: path.to_owned(), file, format, bytes: 0 };
        let mut begin = MAGIC.to_vec();
        begin.extend(schema.number().to_le_bytes());
        writer.write(&begin)?;
        writer.block(kind::HEADER, &encoded)?;
        Ok(writer)
    }

    /// Appends some seconds. Of a robot with one stereo pair or single camera, candidates and answers of camera 0 are written.
    ///
    /// # Errors
    /// As [`SessionWriter::create`]. What was written before stays readable.
    pub fn append(&mut self, chunk: &Chunk) -> Result<(), HandInError> {
        let payload = chunk::encode(chunk, self.format);
        self.block(kind::CHUNK, &payload)
    }

    /// Ends the session.
    ///
    /// # Errors
    /// As [`SessionWriter::create`].
    pub fn finish(mut self) -> Result<PathBuf, HandInError> {
        self.block(kind::END, &[])?;
        Ok(self.path)
    }

    /// Bytes so far.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    fn block(&mut self, kind: u8, payload: &[u8]) -> Result<(), HandInError> {
        let too_large = || std::io::Error::other("a chunk is larger than 16 MiB");
        let bytes = block::encode(kind, payload).ok_or_else(too_large);
        let bytes = bytes.map_err(|source| HandInError::Io { path: self.path.clone(), source })?;
        self.write(&bytes)
    }

    fn write(&mut self, bytes: &[u8]) -> Result<(), HandInError> {
        let written = self.file.write_all(bytes).and_then(|()| self.file.sync_data());
        self.bytes += bytes.len() as u64;
        written.map_err(|source| HandInError::Io { path: self.path.clone(), source })
    }
}
