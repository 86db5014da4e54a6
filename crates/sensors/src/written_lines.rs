//! Text files that our programs write line by line, and that end in half a line where a program was killed.

use super::SequenceError;
use std::path::Path;

/// The complete lines of a text file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WrittenLines {
    /// The lines, each with its line feed.
    pub text: String,
    /// The line that was cut off and left out, counted from 1.
    pub cut_off_line: Option<u64>,
}

/// Reads a file whose writer ends every line with a line feed; a last line without one is left out, with a warning.
///
/// # Errors
/// [`SequenceError::Missing`] or [`SequenceError::Io`], with the file.
pub fn read_written_lines(path: &Path, advice: &str) -> Result<WrittenLines, SequenceError> {
    let mut bytes = files::read(path, files::MAX_TEXT_BYTES).map_err(|source| match source.kind() {
        std::io::ErrorKind::NotFound => SequenceError::missing(path, advice),
        _ => SequenceError::io(path, source),
    })?;
    let complete = bytes.iter().rposition(|&byte| byte == b'\n').map_or(0, |last| last + 1);
    let is_cut = bytes.len() > complete;
    bytes.truncate(complete);
    let invalid =
        |error| SequenceError::io(path, std::io::Error::new(std::io::ErrorKind::InvalidData, error));
    let text = String::from_utf8(bytes).map_err(invalid)?;
    let cut_off_line = is_cut.then(|| text.lines().count() as u64 + 1);
    if let Some(line) = cut_off_line {
        warn_cut_off(path, line);
    }
    Ok(WrittenLines { text, cut_off_line })
}

/// Says that the last row of a table that a program wrote is left out.
pub fn warn_cut_off(path: &Path, line: u64) {
    tracing::warn!(
        "{}, line {line}: the last row is cut off, as when a run is killed; it is left out, and all rows before it are used",
        path.display()
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_last_line_can_be_cut_off() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("events.csv");
        for (text, expected, cut) in [
            ("a\nb\n", "a\nb\n", None),
            ("a\nb\nhal", "a\nb\n", Some(3)),
            ("hal", "", Some(1)),
            ("", "", None),
        ] {
            std::fs::write(&path, text).unwrap();
            let lines = read_written_lines(&path, "").unwrap();
            assert_eq!((lines.text.as_str(), lines.cut_off_line), (expected, cut));
        }
        // Half of a character of several bytes is no reason to lose the rest.
        std::fs::write(&path, b"a\n\xc3").unwrap();
        assert_eq!(read_written_lines(&path, "").unwrap().text, "a\n");
    }
}
