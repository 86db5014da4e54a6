//! Files of a recording that are compressed as a whole, as `ros2 bag record --compression-mode file` writes them: they are
//! unpacked into a folder of their own, which exists as long as the recording is open.

use crate::BagError;
use crate::packed_message::ZSTD_MAGIC;
use files::TemporaryFolder;
use std::ffi::OsString;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// How the names of packed files end; the first is that of rosbag2.
const EXTENSIONS: [&str; 2] = ["zstd", "zst"];

/// A file in a folder that is removed with this value.
#[derive(Debug)]
pub(crate) struct TemporaryFile {
    pub(crate) path: PathBuf,
    _folder: TemporaryFolder,
}

impl TemporaryFile {
    /// Makes a folder for the copy of a file, under its name.
    pub(crate) fn named_as(original: &Path) -> Result<Self, BagError> {
        let io = |source| BagError::io(&std::env::temp_dir(), source);
        let folder = TemporaryFolder::new().map_err(io)?;
        let path = folder.path().join(original.file_name().unwrap_or_default());
        Ok(Self { path, _folder: folder })
    }
}

/// Whether a file begins as a packed one.
pub(crate) fn is_packed(path: &Path) -> bool {
    let mut start = [0; ZSTD_MAGIC.len()];
    files::open(path).and_then(|mut file| file.read_exact(&mut start)).is_ok() && start == ZSTD_MAGIC
}

/// The first bytes of a packed file's contents.
pub(crate) fn start_of(path: &Path, count: u64) -> std::io::Result<Vec<u8>> {
    let mut start = Vec::new();
    let read = zstd::stream::Decoder::new(files::open(path)?)?.take(count).read_to_end(&mut start);
    read.map(|_| start)
}

/// Unpacks a file, as far as it goes.
///
/// # Returns
/// The unpacked file, and notes for the user: where it is, and whether it is truncated.
pub(crate) fn unpack(path: &Path) -> Result<(TemporaryFile, Vec<String>), BagError> {
    let unpacked = TemporaryFile::named_as(&unpacked_name(path))?;
    let mut notes = vec![format!(
        "{}: the file is compressed as a whole; it was unpacked to {} for now (TMPDIR chooses the place)",
        path.display(),
        unpacked.path.display()
    )];
    let packed = files::open(path).map_err(|source| BagError::io(path, source))?;
    let mut file = File::create(&unpacked.path).map_err(|source| BagError::io(&unpacked.path, source))?;
    let mut reader = zstd::stream::Decoder::new(packed).map_err(|source| BagError::io(path, source))?;
    let mut buffer = vec![0; 1 << 20];
    loop {
        match reader.read(&mut buffer) {
            Ok(0) => break,
            Ok(count) => std::io::Write::write_all(&mut file, &buffer[..count])
                .map_err(|source| BagError::io(&unpacked.path, source))?,
            // What is cut off is read up to there.
            Err(error) => {
                notes.push(format!("{}: it cannot be unpacked to its end: {error}", path.display()));
                break;
            }
        }
    }
    Ok((unpacked, notes))
}

/// The name of a file when it is packed.
pub(crate) fn packed_name(path: &Path) -> PathBuf {
    let mut name = OsString::from(path);
    name.push(".");
    name.push(EXTENSIONS[0]);
    name.into()
}

/// The name of a file when it is unpacked.
pub(crate) fn unpacked_name(path: &Path) -> PathBuf {
    let is_packed =
        path.extension().is_some_and(|extension| EXTENSIONS.iter().any(|packed| extension == *packed));
    if is_packed { path.with_extension("") } else { path.to_path_buf() }
}
