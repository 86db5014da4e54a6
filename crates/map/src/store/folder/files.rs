//! The files below a folder: listing, checksums, verified copies.

use std::fmt::Write as _;
use std::fs::File;
use std::io::{Read as _, Write};
use std::path::{Path, PathBuf};

use sha2::{Digest as _, Sha256};

use super::manifest::{FileSum, sync_folder};

/// Bytes that are read at once.
const CHUNK_BYTES: usize = 1 << 20;

/// All files below a folder, by path relative to it with `/`, in alphabetical order.
pub(in crate::store) fn list(folder: &Path) -> std::io::Result<Vec<String>> {
    let mut files = Vec::new();
    let mut folders = vec![String::new()];
    while let Some(inside) = folders.pop() {
        for entry in std::fs::read_dir(folder.join(&inside))? {
            let entry = entry?;
            let name = format!("{inside}{}", entry.file_name().to_string_lossy());
            if entry.file_type()?.is_dir() {
                folders.push(format!("{name}/"));
            } else {
                files.push(name);
            }
        }
    }
    files.sort_unstable();
    Ok(files)
}

/// Checksums of all files below a folder; when this returns, they are on the disk.
pub(in crate::store) fn sums(folder: &Path) -> std::io::Result<Vec<FileSum>> {
    let sum_of = |path: String| {
        let file = folder.join(&path);
        let (bytes, sha256) = copy_and_sum(&file, &mut std::io::sink()).map_err(CopyError::into_inner)?;
        File::open(&file)?.sync_all()?;
        Ok(FileSum { path, bytes, sha256 })
    };
    let sums = list(folder)?.into_iter().map(sum_of).collect::<std::io::Result<_>>()?;
    for inside in folders_below(folder)? {
        sync_folder(&inside)?;
    }
    Ok(sums)
}

/// Which side of a copy failed.
pub(in crate::store) enum CopyError {
    Read(std::io::Error),
    Write(std::io::Error),
}

impl CopyError {
    fn into_inner(self) -> std::io::Error {
        match self {
            CopyError::Read(error) | CopyError::Write(error) => error,
        }
    }
}

/// Copies a file into a folder, under a path relative to it.
///
/// # Returns
/// Its bytes and its SHA-256, hexadecimal.
pub(in crate::store) fn copy(from: &Path, folder: &Path, path: &str) -> Result<(u64, String), CopyError> {
    let to = folder.join(path);
    if let Some(inside) = to.parent() {
        std::fs::create_dir_all(inside).map_err(CopyError::Write)?;
    }
    let mut target = File::create(&to).map_err(CopyError::Write)?;
    copy_and_sum(from, &mut target)
}

fn copy_and_sum(from: &Path, to: &mut dyn Write) -> Result<(u64, String), CopyError> {
    let mut source = ::files::open(from).map_err(CopyError::Read)?;
    let mut hasher = Sha256::new();
    let mut chunk = vec![0; CHUNK_BYTES];
    let mut bytes = 0;
    loop {
        let read = source.read(&mut chunk).map_err(CopyError::Read)?;
        if read == 0 {
            return Ok((bytes, hexadecimal(&hasher.finalize())));
        }
        hasher.update(&chunk[..read]);
        to.write_all(&chunk[..read]).map_err(CopyError::Write)?;
        bytes += read as u64;
    }
}

fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, byte| {
        // Writing to a string does not fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}

/// A folder and all below it.
fn folders_below(folder: &Path) -> std::io::Result<Vec<PathBuf>> {
    let mut found = vec![folder.to_owned()];
    let mut next = 0;
    while next < found.len() {
        for entry in std::fs::read_dir(&found[next])? {
            let entry = entry?;
            if entry.file_type()?.is_dir() {
                found.push(entry.path());
            }
        }
        next += 1;
    }
    Ok(found)
}
