//! Reading what a path names, where that is a regular file.
//!
//! A pipe without a writer blocks whoever opens it, a device may never end: in a folder that somebody else made, either
//! stands where a file is expected.

use std::fs::File;
use std::io::{Error, ErrorKind, Read as _, Result};
use std::path::Path;

/// Most bytes of a file of text that is read as a whole: a table of a day's readings of an IMU has half as much.
pub const MAX_TEXT_BYTES: u64 = 4 << 30;

/// Opens a file for reading.
///
/// # Errors
/// As of [`File::open`]; [`ErrorKind::InvalidInput`] for a folder, a pipe, a device or a socket, which is not opened.
///
/// ```
/// assert!(files::open("/dev/zero").is_err() || cfg!(not(unix)));
/// ```
pub fn open(path: impl AsRef<Path>) -> Result<File> {
    let path = path.as_ref();
    require_file(std::fs::metadata(path)?.file_type())?;
    File::open(path)
}

/// Reads a file.
///
/// # Errors
/// As of [`open`]; [`ErrorKind::FileTooLarge`] for one of more than `most` bytes, of which no more are read.
pub fn read(path: impl AsRef<Path>, most: u64) -> Result<Vec<u8>> {
    let file = open(path)?;
    let length = file.metadata()?.len();
    let too_large = |length: u64| {
        Error::new(ErrorKind::FileTooLarge, format!("it has {length} bytes, more than {most} are not read"))
    };
    if length > most {
        return Err(too_large(length));
    }
    // A file may grow, and those of /proc have no length.
    let mut bytes = Vec::with_capacity(usize::try_from(length).unwrap_or_default());
    file.take(most.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most { Err(too_large(bytes.len() as u64)) } else { Ok(bytes) }
}

/// Reads a file of text, at most [`MAX_TEXT_BYTES`].
///
/// # Errors
/// As of [`read`]; [`ErrorKind::InvalidData`] where it is not UTF-8.
pub fn read_to_string(path: impl AsRef<Path>) -> Result<String> {
    let bytes = read(path, MAX_TEXT_BYTES)?;
    String::from_utf8(bytes)
        .map_err(|_| Error::new(ErrorKind::InvalidData, "stream did not contain valid UTF-8"))
}

fn require_file(kind: std::fs::FileType) -> Result<()> {
    if kind.is_file() {
        return Ok(());
    }
    let what = if kind.is_dir() { "a folder" } else { special(kind) };
    Err(Error::new(ErrorKind::InvalidInput, format!("it is {what}, not a file")))
}

#[cfg(unix)]
fn special(kind: std::fs::FileType) -> &'static str {
    use std::os::unix::fs::FileTypeExt as _;
    if kind.is_fifo() {
        "a pipe"
    } else if kind.is_socket() {
        "a socket"
    } else {
        "a device"
    }
}

#[cfg(not(unix))]
fn special(_: std::fs::FileType) -> &'static str {
    "neither a file nor a folder"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_read_up_to_its_limit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("text");
        std::fs::write(&path, "hello").unwrap();
        assert_eq!(read(&path, 5).unwrap(), b"hello");
        assert_eq!(read_to_string(&path).unwrap(), "hello");
        let error = read(&path, 4).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::FileTooLarge);
        assert!(error.to_string().contains("5 bytes"), "{error}");
        assert_eq!(read(folder.path().join("none"), 5).unwrap_err().kind(), ErrorKind::NotFound);
        std::fs::write(&path, [0xff, 0xfe]).unwrap();
        assert_eq!(read_to_string(&path).unwrap_err().kind(), ErrorKind::InvalidData);
    }

    #[cfg(unix)]
    #[test]
    fn pipes_devices_and_folders_are_named_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let link = folder.path().join("link");
        std::os::unix::fs::symlink("/dev/zero", &link).unwrap();
        for (path, what) in [(pipe.as_path(), "a pipe"), (&link, "a device"), (folder.path(), "a folder")] {
            let error = read_to_string(path).unwrap_err().to_string();
            assert!(error.contains(what), "{error}");
        }
    }
}
