//! A file of chunks: reads ranges of the file and of its unpacked chunks.

use crate::BagError;
use crate::storage::{MAX_MESSAGE, NO_CHUNK};
use std::collections::VecDeque;
use std::fmt;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// Larger chunks are not unpacked, bytes. Writers use 1 to 8 MB.
const MAX_CHUNK: u64 = 1 << 28;
/// Unpacked chunks are kept up to this size together, and at least two of them, bytes.
const CACHE_BYTES: usize = 1 << 25;

/// Compression of a chunk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Packing {
    None,
    Lz4,
    Zstd,
    Bzip2,
}

impl Packing {
    /// The compression by its name in MCAP and rosbag1.
    pub(crate) fn of(name: &[u8]) -> Option<Self> {
        match name {
            b"" | b"none" => Some(Self::None),
            b"lz4" => Some(Self::Lz4),
            b"zstd" => Some(Self::Zstd),
            b"bz2" => Some(Self::Bzip2),
            _ => None,
        }
    }
}

/// Where a chunk is.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Chunk {
    pub(crate) packing: Packing,
    /// First byte of its contents in the file.
    pub(crate) start: u64,
    /// Bytes in the file.
    pub(crate) packed: u64,
    /// Bytes when unpacked, as the file says.
    pub(crate) unpacked: u64,
    /// CRC32 of the unpacked bytes, where the file states it.
    pub(crate) crc: Option<u32>,
}

/// What was unpacked of a chunk.
pub(crate) struct Unpacked {
    pub(crate) bytes: Vec<u8>,
    /// Why these are not all bytes of the chunk, or not the right ones.
    pub(crate) problem: Option<String>,
}

/// An open file and its chunks.
pub(crate) struct ChunkedFile {
    path: PathBuf,
    length: u64,
    file: Mutex<File>,
    pub(crate) chunks: Vec<Chunk>,
    /// The chunks that were used last, the newest at the end.
    cache: Mutex<VecDeque<(u32, Arc<Vec<u8>>)>>,
}

impl fmt::Debug for ChunkedFile {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{} with {} chunks", self.path.display(), self.chunks.len())
    }
}

impl ChunkedFile {
    pub(crate) fn open(path: &Path) -> Result<Self, BagError> {
        let file = files::open(path).map_err(|source| BagError::io(path, source))?;
        let length = file.metadata().map_err(|source| BagError::io(path, source))?.len();
        Ok(Self {
            path: path.to_path_buf(),
            length,
            file: Mutex::new(file),
            chunks: Vec::new(),
            cache: Mutex::default(),
        })
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Bytes of the file.
    pub(crate) fn length(&self) -> u64 {
        self.length
    }

    /// The bytes of the file from `offset` on: `count`, or as many as there are.
    pub(crate) fn range(&self, offset: u64, count: u64) -> Result<Vec<u8>, BagError> {
        let count = count.min(self.length.saturating_sub(offset));
        if count > MAX_MESSAGE {
            return Err(BagError::message(&self.path, offset, format!("it has {count} bytes")));
        }
        let mut bytes = Vec::with_capacity(count as usize);
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        let read =
            file.seek(SeekFrom::Start(offset)).and_then(|_| (&*file).take(count).read_to_end(&mut bytes));
        read.map_err(|source| BagError::io(&self.path, source))?;
        Ok(bytes)
    }

    /// The bytes of an unpacked chunk, or of the file for [`NO_CHUNK`]: `count`, or as many as there are.
    pub(crate) fn bytes(&self, chunk: u32, offset: u64, count: u64) -> Result<Vec<u8>, BagError> {
        if chunk == NO_CHUNK {
            return self.range(offset, count);
        }
        let unpacked = self.cached(chunk)?;
        let start = (offset as usize).min(unpacked.len());
        let end = start.saturating_add(count as usize).min(unpacked.len());
        Ok(unpacked[start..end].to_vec())
    }

    /// A chunk from the cache, or unpacked; one that is cut off or damaged up to there.
    fn cached(&self, number: u32) -> Result<Arc<Vec<u8>>, BagError> {
        let mut cache = self.cache.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(at) = cache.iter().position(|(cached, _)| *cached == number)
            && let Some(found) = cache.remove(at)
        {
            let bytes = Arc::clone(&found.1);
            cache.push_back(found);
            return Ok(bytes);
        }
        let bytes = Arc::new(self.unpack(self.chunks[number as usize])?.bytes);
        cache.push_back((number, Arc::clone(&bytes)));
        while cache.len() > 2 && cache.iter().map(|(_, bytes)| bytes.len()).sum::<usize>() > CACHE_BYTES {
            cache.pop_front();
        }
        Ok(bytes)
    }

    /// Unpacks a chunk as far as it goes.
    pub(crate) fn unpack(&self, chunk: Chunk) -> Result<Unpacked, BagError> {
        if chunk.unpacked.max(chunk.packed) > MAX_CHUNK {
            let problem = format!("the chunk at byte {} has more than {MAX_CHUNK} bytes", chunk.start);
            return Ok(Unpacked { bytes: Vec::new(), problem: Some(problem) });
        }
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        file.seek(SeekFrom::Start(chunk.start)).map_err(|source| BagError::io(&self.path, source))?;
        let packed = BufReader::new((&*file).take(chunk.packed));
        let mut bytes = Vec::new();
        let read = match chunk.packing {
            Packing::None => fill(packed, chunk.unpacked, &mut bytes),
            Packing::Lz4 => {
                lz4::Decoder::new(packed).and_then(|reader| fill(reader, chunk.unpacked, &mut bytes))
            }
            Packing::Zstd => zstd::stream::Decoder::with_buffer(packed)
                .and_then(|reader| fill(reader, chunk.unpacked, &mut bytes)),
            Packing::Bzip2 => fill(bzip2::bufread::BzDecoder::new(packed), chunk.unpacked, &mut bytes),
        };
        let problem = match read {
            Err(error) => Some(error.to_string()),
            Ok(()) if bytes.len() as u64 != chunk.unpacked => {
                Some(format!("it has {} bytes instead of {}", bytes.len(), chunk.unpacked))
            }
            Ok(()) if chunk.crc.is_some_and(|crc| crc != crc32fast::hash(&bytes)) => {
                bytes.clear();
                Some("its checksum is wrong".to_owned())
            }
            Ok(()) => None,
        };
        let problem = problem.map(|problem| format!("the chunk at byte {}: {problem}", chunk.start));
        Ok(Unpacked { bytes, problem })
    }
}

/// Reads to the end, but no more than a chunk may have.
fn fill(reader: impl Read, expected: u64, bytes: &mut Vec<u8>) -> std::io::Result<()> {
    reader.take(expected).read_to_end(bytes).map(drop)
}
