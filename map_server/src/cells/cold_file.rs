//! Cells on disk as they are in memory, for the process that wrote them.
//!
//! ```text
//! {folder}/{number}/lock          locked by the process whose folder it is
//! {folder}/{number}/{n}           one cell: for each block its length u32 LE, its CRC-32 u32 LE, its bytes; then four zeros
//! ```
//! What a process wrote is of no use to the next one, which begins with the segments: so the form of a cell in memory may change from one
//! program to the next. A folder whose process is gone is emptied by the next one that comes.

use std::fs::{self, File};
use std::io::{self, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use recognition::{FrozenError, LoadedMap};

/// Bytes of a block: they stay in the processor's cache from their check to where they belong.
const BLOCK: usize = 256 << 10;
/// Processes that share a cache: more are a mistake.
const MOST_PROCESSES: u32 = 64;

/// The folder of a process.
#[derive(Debug)]
pub(crate) struct ColdFolder {
    folder: PathBuf,
    next: AtomicU64,
    _lock: File,
}

impl ColdFolder {
    /// Takes the first folder that no process has, and empties it.
    pub(crate) fn open(parent: &Path) -> io::Result<Arc<ColdFolder>> {
        for number in 0..MOST_PROCESSES {
            let folder = parent.join(number.to_string());
            fs::create_dir_all(&folder)?;
            let lock = File::create(folder.join("lock"))?;
            match lock.try_lock() {
                Ok(()) => {}
                Err(fs::TryLockError::WouldBlock) => continue,
                Err(fs::TryLockError::Error(error)) => return Err(error),
            }
            for entry in fs::read_dir(&folder)? {
                let path = entry?.path();
                if !path.ends_with("lock") {
                    fs::remove_file(path)?;
                }
            }
            return Ok(Arc::new(ColdFolder { folder, next: AtomicU64::new(0), _lock: lock }));
        }
        Err(io::Error::new(io::ErrorKind::ResourceBusy, "too many servers have cells in this folder"))
    }
}

/// A cell on disk; removed when it is dropped.
#[derive(Debug)]
pub(crate) struct ColdFile {
    path: PathBuf,
    _folder: Arc<ColdFolder>,
}

/// Why a cell is not written, or not read back.
#[derive(Debug, thiserror::Error)]
#[error("{path}: {reason}")]
pub(crate) struct ColdFileError {
    path: PathBuf,
    reason: FrozenOrIo,
}

#[derive(Debug, thiserror::Error)]
enum FrozenOrIo {
    #[error(transparent)]
    Frozen(#[from] FrozenError),
    #[error(transparent)]
    Io(#[from] io::Error),
}

impl ColdFile {
    /// Writes a cell. Blocks.
    pub(crate) fn write(folder: &Arc<ColdFolder>, map: &LoadedMap) -> Result<ColdFile, ColdFileError> {
        let number = folder.next.fetch_add(1, Ordering::Relaxed);
        // What was begun goes with it.
        let file = ColdFile { path: folder.folder.join(number.to_string()), _folder: Arc::clone(folder) };
        let written = || -> Result<(), FrozenOrIo> {
            let mut writer =
                BlockWriter { inner: File::create(&file.path)?, block: Vec::with_capacity(BLOCK) };
            map.freeze(&mut writer)?;
            Ok(writer.finish()?)
        };
        match written() {
            Ok(()) => Ok(file),
            Err(reason) => Err(ColdFileError { path: file.path.clone(), reason }),
        }
    }

    /// Reads the cell. Blocks.
    pub(crate) fn read(&self) -> Result<LoadedMap, ColdFileError> {
        let read = || -> Result<LoadedMap, FrozenOrIo> {
            Ok(LoadedMap::thaw(BlockReader::new(File::open(&self.path)?))?)
        };
        read().map_err(|reason| ColdFileError { path: self.path.clone(), reason })
    }
}

impl Drop for ColdFile {
    fn drop(&mut self) {
        if let Err(error) = fs::remove_file(&self.path)
            && error.kind() != io::ErrorKind::NotFound
        {
            tracing::warn!(path = %self.path.display(), "this file is of no use any more and cannot be removed: {error}");
        }
    }
}

struct BlockWriter<W> {
    inner: W,
    block: Vec<u8>,
}

impl<W: Write> BlockWriter<W> {
    fn write_block(&mut self) -> io::Result<()> {
        if !self.block.is_empty() {
            self.inner.write_all(&(self.block.len() as u32).to_le_bytes())?;
            self.inner.write_all(&crc32fast::hash(&self.block).to_le_bytes())?;
            self.inner.write_all(&self.block)?;
            self.block.clear();
        }
        Ok(())
    }

    fn finish(mut self) -> io::Result<()> {
        self.write_block()?;
        self.inner.write_all(&[0; 4])
    }
}

impl<W: Write> Write for BlockWriter<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.block.len() == BLOCK {
            self.write_block()?;
        }
        let taken = bytes.len().min(BLOCK - self.block.len());
        self.block.extend_from_slice(&bytes[..taken]);
        Ok(taken)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Reads what [`BlockWriter`] wrote; no byte is passed on before its block was checked.
struct BlockReader<R> {
    inner: BufReader<R>,
    block: Vec<u8>,
    at: usize,
    is_at_end: bool,
}

impl<R: Read> BlockReader<R> {
    fn new(inner: R) -> Self {
        // Blocks are larger than its buffer and go past it.
        Self { inner: BufReader::with_capacity(4096, inner), block: Vec::new(), at: 0, is_at_end: false }
    }

    fn next_block(&mut self) -> io::Result<()> {
        let damaged = || io::Error::new(io::ErrorKind::InvalidData, "the file is damaged");
        let mut number = || -> io::Result<u32> {
            let mut bytes = [0; 4];
            self.inner.read_exact(&mut bytes)?;
            Ok(u32::from_le_bytes(bytes))
        };
        let length = number()? as usize;
        if length == 0 {
            self.is_at_end = true;
            return Ok(());
        }
        if length > BLOCK {
            return Err(damaged());
        }
        let stated = number()?;
        (self.at, self.block) = (0, std::mem::take(&mut self.block));
        self.block.resize(length, 0);
        self.inner.read_exact(&mut self.block)?;
        if crc32fast::hash(&self.block) == stated { Ok(()) } else { Err(damaged()) }
    }
}

impl<R: Read> Read for BlockReader<R> {
    #[inline]
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        while self.at == self.block.len() && !self.is_at_end {
            self.next_block()?;
        }
        let taken = bytes.len().min(self.block.len() - self.at);
        bytes[..taken].copy_from_slice(&self.block[self.at..self.at + taken]);
        self.at += taken;
        Ok(taken)
    }

    /// A cell is millions of numbers, almost none of which lies across two blocks.
    #[inline]
    fn read_exact(&mut self, bytes: &mut [u8]) -> io::Result<()> {
        if let Some(next) = self.block.get(self.at..self.at + bytes.len()) {
            bytes.copy_from_slice(next);
            self.at += bytes.len();
            return Ok(());
        }
        let mut filled = 0;
        while filled < bytes.len() {
            match self.read(&mut bytes[filled..])? {
                0 => return Err(io::ErrorKind::UnexpectedEof.into()),
                taken => filled += taken,
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use testing::{Place, PlaceOptions};

    fn written(bytes: &[u8]) -> Vec<u8> {
        let mut file = Vec::new();
        let mut writer = BlockWriter { inner: &mut file, block: Vec::new() };
        writer.write_all(bytes).unwrap();
        writer.finish().unwrap();
        file
    }

    fn read(file: &[u8]) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        BlockReader::new(file).read_to_end(&mut bytes)?;
        Ok(bytes)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn bytes_come_back_and_damage_is_an_error(
            length in 0..3 * BLOCK, cut in any::<usize>(), at in any::<usize>(), bit in 0..8_u8,
        ) {
            let bytes: Vec<u8> = (0..length).map(|at| (at * at / 7) as u8).collect();
            let file = written(&bytes);
            prop_assert_eq!(read(&file).unwrap(), bytes);
            prop_assert!(read(&file[..cut % file.len()]).is_err());
            let mut flipped = file.clone();
            flipped[at % file.len()] ^= 1 << bit;
            prop_assert!(read(&flipped).is_err());
        }
    }

    /// Prints what a cell takes to come into memory; run with `--ignored --nocapture`.
    #[test]
    #[ignore = "a measurement of a minute, not a test"]
    fn what_a_cold_cell_costs() {
        let keyframes = std::env::var("KEYFRAMES").map_or(5000, |text| text.parse().unwrap());
        let options = PlaceOptions { keyframes, landmarks: 50 * keyframes, ..PlaceOptions::default() };
        let contents = Place::new(&options).map;
        let observations = contents.observation_count();
        let begin = std::time::Instant::now();
        let map = LoadedMap::from_contents(contents).unwrap();
        println!("{keyframes} keyframes, {observations} observations, {} MB", map.bytes_in_memory() >> 20);
        println!("indexed in {:?}", begin.elapsed());
        let parent = tempfile::tempdir().unwrap();
        let folder = ColdFolder::open(parent.path()).unwrap();
        let begin = std::time::Instant::now();
        let file = ColdFile::write(&folder, &map).unwrap();
        println!("written in {:?}", begin.elapsed());
        drop(map);
        for _ in 0..5 {
            let begin = std::time::Instant::now();
            let map = file.read().unwrap();
            println!("read in {:?}", begin.elapsed());
            drop(map);
        }
    }

    #[test]
    fn a_cell_comes_back_and_its_file_goes_with_it() {
        let parent = tempfile::tempdir().unwrap();
        let [one, two] = [(); 2].map(|()| ColdFolder::open(parent.path()).unwrap());
        assert_ne!(one.folder, two.folder);
        let map = LoadedMap::from_contents(Place::new(&PlaceOptions::default()).map).unwrap();
        let file = ColdFile::write(&one, &map).unwrap();
        assert_eq!(file.read().unwrap().keyframe_count(), map.keyframe_count());
        let bytes = fs::read(&file.path).unwrap();
        fs::write(&file.path, &bytes[..bytes.len() - 9]).unwrap();
        let said = file.read().err().unwrap().to_string();
        assert!(said.contains(file.path.to_str().unwrap()), "{said}");
        let (path, folder) = (file.path.clone(), one.folder.clone());
        drop(file);
        assert!(!path.exists());

        // A process that was killed leaves its files; the next one takes its folder.
        fs::write(&path, "left behind").unwrap();
        drop(one);
        let next = ColdFolder::open(parent.path()).unwrap();
        assert_eq!(next.folder, folder);
        assert!(!path.exists());
        drop(two);
    }
}
