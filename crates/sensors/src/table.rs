//! A reader of comma-separated tables: row by row, without an allocation a row; errors name the file and the line.
//!
//! Lines that begin with `#` are comments (EuRoC's headers); so is a first line whose first cell is a column's name.

use super::error::SequenceError;
use super::pose_columns::PoseColumns;
use super::row_order::RowOrder;
use csv::{ByteRecord, Reader, ReaderBuilder};
use std::collections::{BTreeMap, HashSet};
use std::fmt::Display;
use std::fs::File;
use std::io::{Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// A comma-separated file that is being read.
///
/// ```
/// # let folder = tempfile::tempdir()?;
/// # let path = folder.path().join("imu.csv");
/// std::fs::write(&path, "#timestamp [ns],rate [rad/s]\n5000000, 0.25\n")?;
/// let mut table = sensors::Table::open(&path, "it holds the turn rates")?;
/// let mut rates = Vec::new();
/// while let Some(row) = table.next_row()? {
///     rates.push((row.stamp()?, row.finite(1)?));
/// }
/// assert_eq!(rates, [(5_000_000, 0.25)]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Table {
    path: PathBuf,
    reader: Reader<File>,
    record: ByteRecord,
    rows: u64,
    /// The columns of a pose, where a header before the first row names them.
    pose_columns: Option<PoseColumns>,
    /// Length of the file, bytes.
    length: u64,
    ends_with_line_feed: bool,
    /// Lines that are left out.
    skipped: HashSet<u64>,
    /// The rows, where they are read in another order than that of the file.
    sorted: Option<std::vec::IntoIter<ByteRecord>>,
}

impl Table {
    /// Opens a file.
    ///
    /// # Arguments
    /// * `advice`: what the file is for; part of the error when it is missing.
    ///
    /// # Errors
    /// [`SequenceError::Missing`] or [`SequenceError::Io`], with the file.
    pub fn open(path: &Path, advice: &str) -> Result<Self, SequenceError> {
        let mut file = files::open(path).map_err(|source| match source.kind() {
            std::io::ErrorKind::NotFound => SequenceError::missing(path, advice),
            _ => SequenceError::io(path, source),
        })?;
        let (length, ends_with_line_feed) =
            length_and_end(&mut file).map_err(|source| SequenceError::io(path, source))?;
        let reader = ReaderBuilder::new()
            .has_headers(false)
            .flexible(true)
            .quoting(false)
            .buffer_capacity(1 << 16)
            .from_reader(file);
        Ok(Self {
            path: path.to_path_buf(),
            reader,
            record: ByteRecord::new(),
            rows: 0,
            pose_columns: None,
            length,
            ends_with_line_feed,
            skipped: HashSet::new(),
            sorted: None,
        })
    }

    /// Opens a file whose rows are read in a given order. Rows that are not in the order of the file are held in memory.
    ///
    /// # Errors
    /// As [`Table::open`]; where rows are held in memory also as [`Table::next_row`].
    pub(crate) fn open_in_order(path: &Path, advice: &str, order: &RowOrder) -> Result<Self, SequenceError> {
        let mut table = Self::open(path, advice)?;
        table.skipped.clone_from(&order.skipped);
        let Some(wanted) = &order.sorted else { return Ok(table) };
        let mut records = BTreeMap::new();
        while let Some(row) = table.next_row()? {
            let line = row.line();
            records.insert(line, table.record.clone());
        }
        let rest = records.split_off(&(wanted.last + 1));
        let sorted: Vec<ByteRecord> =
            wanted.lines.iter().filter_map(|line| records.remove(line)).chain(rest.into_values()).collect();
        table.sorted = Some(sorted.into_iter());
        Ok(table)
    }

    /// Reads the next row; `None` at the end of the file.
    ///
    /// # Errors
    /// [`SequenceError::Row`] with file and line: the file cannot be read any further.
    pub fn next_row(&mut self) -> Result<Option<Row<'_>>, SequenceError> {
        if let Some(sorted) = &mut self.sorted {
            let Some(record) = sorted.next() else { return Ok(None) };
            self.record = record;
            return Ok(Some(self.row()));
        }
        loop {
            let more = self.reader.read_byte_record(&mut self.record).map_err(|error| {
                let line = error.position().map_or(0, csv::Position::line);
                SequenceError::Row {
                    path: self.path.clone(),
                    line,
                    problem: format!("it cannot be read: {error}"),
                }
            })?;
            if !more {
                return Ok(None);
            }
            // The csv reader could skip comments itself, but then takes the comment's line for the row's.
            if self.record.get(0).is_some_and(|cell| cell.trim_ascii_start().starts_with(b"#")) {
                self.read_header();
                continue;
            }
            self.rows += 1;
            if self.rows == 1 && is_header(&self.record) {
                self.read_header();
                continue;
            }
            if self.skipped.contains(&self.row().line()) {
                continue;
            }
            return Ok(Some(self.row()));
        }
    }

    /// Takes the columns from a header; what stands below the first row is a comment.
    fn read_header(&mut self) {
        if self.rows <= 1 {
            let cells: Vec<_> = self.record.iter().map(String::from_utf8_lossy).collect();
            self.pose_columns = PoseColumns::of_header(&cells.join(",")).or(self.pose_columns);
        }
    }

    /// Whether the row that was read last is the end of a file that does not end in a line feed.
    ///
    /// A program that is killed while it writes a table leaves such a row: its last cell may be half a number.
    pub fn row_is_unterminated(&self) -> bool {
        !self.ends_with_line_feed && self.reader.position().byte() >= self.length
    }

    /// The row that was read last; without any cells before the first [`Table::next_row`].
    pub fn row(&self) -> Row<'_> {
        Row { path: &self.path, record: &self.record, pose_columns: self.pose_columns }
    }
}

/// Length of a file in bytes, and whether its last byte is a line feed; its position is the beginning again.
fn length_and_end(file: &mut File) -> std::io::Result<(u64, bool)> {
    let length = file.seek(SeekFrom::End(0))?;
    let mut last = [b'\n'];
    if length > 0 {
        file.seek(SeekFrom::Start(length - 1))?;
        file.read_exact(&mut last)?;
    }
    file.rewind()?;
    Ok((length, last == [b'\n']))
}

/// A first cell that begins with a letter names a column.
fn is_header(record: &ByteRecord) -> bool {
    let first = record.get(0).unwrap_or_default().trim_ascii();
    first.first().is_some_and(u8::is_ascii_alphabetic) && !first.eq_ignore_ascii_case(b"nan")
}

/// One row of a [`Table`].
#[derive(Clone, Copy, Debug)]
pub struct Row<'a> {
    path: &'a Path,
    record: &'a ByteRecord,
    pose_columns: Option<PoseColumns>,
}

impl<'a> Row<'a> {
    /// An error about this row, with file and line.
    pub fn wrong(&self, problem: impl Into<String>) -> SequenceError {
        SequenceError::Row { path: self.path.to_path_buf(), line: self.line(), problem: problem.into() }
    }

    /// The columns of a pose, where the table's header names them.
    pub fn pose_columns(&self) -> Option<PoseColumns> {
        self.pose_columns
    }

    /// The line of the file, counted from 1.
    pub fn line(&self) -> u64 {
        self.record.position().map_or(0, csv::Position::line)
    }

    /// Number of cells.
    pub fn len(&self) -> usize {
        self.record.len()
    }

    /// Whether the row has no cells.
    pub fn is_empty(&self) -> bool {
        self.record.is_empty()
    }

    /// Checks that the row has at least `wanted` cells.
    ///
    /// # Errors
    /// [`SequenceError::Row`]: the row is cut off.
    pub fn require(&self, wanted: usize) -> Result<(), SequenceError> {
        if self.len() >= wanted {
            return Ok(());
        }
        let words = self.cell(0)?.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty());
        if self.len() == 1 && words.count() > 1 {
            return Err(self.wrong("the columns are separated by blanks: separate them by commas"));
        }
        if self.len() == 1 && self.cell(0)?.contains(&b';') {
            return Err(self.wrong("the columns are separated by semicolons: separate them by commas"));
        }
        Err(self.wrong(format!(
            "the row is cut off: {} of {wanted} columns are there; delete it or copy the file again",
            self.len()
        )))
    }

    /// A cell without surrounding blanks. Columns count from 0.
    ///
    /// # Errors
    /// [`SequenceError::Row`]: the row has no such column.
    pub fn cell(&self, column: usize) -> Result<&'a [u8], SequenceError> {
        match self.record.get(column) {
            Some(cell) => Ok(cell.trim_ascii()),
            None => Err(self.wrong(format!("column {} is missing: the row is cut off", column + 1))),
        }
    }

    /// A cell, parsed as `T`.
    ///
    /// # Errors
    /// [`SequenceError::Row`]: the row has no such column, or the cell is not a `T`.
    pub fn parse<T: FromStr<Err: Display>>(&self, column: usize) -> Result<T, SequenceError> {
        let cell = self.cell(column)?;
        let text = std::str::from_utf8(cell).unwrap_or("not text");
        text.parse().map_err(|error| self.wrong(format!("column {}: \"{text}\": {error}", column + 1)))
    }

    /// The time stamp in the first column, nanoseconds.
    ///
    /// # Errors
    /// [`SequenceError::Row`]: the cell is not a whole number.
    pub fn stamp(&self) -> Result<i64, SequenceError> {
        let cell = self.cell(0)?;
        let text = std::str::from_utf8(cell).unwrap_or("not text");
        text.parse().map_err(|error| {
            self.wrong(format!("column 1: \"{text}\" is no time in whole nanoseconds: {error}"))
        })
    }

    /// A cell as a finite number.
    ///
    /// # Errors
    /// [`SequenceError::Row`]: the cell is no number, infinite or NaN.
    pub fn finite(&self, column: usize) -> Result<f64, SequenceError> {
        let value: f64 = self.parse(column)?;
        if value.is_finite() {
            return Ok(value);
        }
        Err(self.wrong(format!("column {} is {value}: delete the row, or record again", column + 1)))
    }

    /// `N` finite numbers from `column` on.
    ///
    /// # Errors
    /// As [`Row::finite`].
    pub fn finite_array<const N: usize>(&self, column: usize) -> Result<[f64; N], SequenceError> {
        let mut values = [0.0; N];
        for (offset, value) in values.iter_mut().enumerate() {
            *value = self.finite(column + offset)?;
        }
        Ok(values)
    }
}

/// Checks that the time stamp of a row is later than that of the row before.
///
/// # Errors
/// [`SequenceError::Row`] for `row`: its time repeats or goes back.
pub fn check_order(row: &Row<'_>, before: Option<i64>, stamp_ns: i64) -> Result<(), SequenceError> {
    match before {
        Some(0) if stamp_ns == 0 => {
            Err(row.wrong("the time stamps are zero: they were not filled in when the file was recorded"))
        }
        Some(before) if stamp_ns <= before => Err(row.wrong(format!(
            "time stamp {stamp_ns} does not come after {before}: sort the file by time and delete repeated rows"
        ))),
        _ => Ok(()),
    }
}
