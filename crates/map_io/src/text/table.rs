//! Comma-separated tables: rows that know where they came from, and numbers that survive being printed.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use geometry::{MAX_COORDINATE_M, is_coordinate};

use super::error::MapFileError;

/// One line of a table, without the line end.
pub(super) struct Row<'a> {
    path: &'a Path,
    /// Counted from 1.
    line: usize,
    fields: Vec<&'a str>,
}

/// A file read into memory, with its name for error messages.
pub(super) struct Table {
    path: PathBuf,
    text: String,
}

impl Table {
    /// Reads a file.
    ///
    /// # Errors
    /// [`MapFileError::Read`] with `remedy` where the file is missing, unreadable or not UTF-8.
    pub(super) fn read(path: &Path, remedy: &str) -> Result<Table, MapFileError> {
        let text = files::read_to_string(path).map_err(|reason| MapFileError::Read {
            path: path.to_owned(),
            reason,
            remedy: remedy.to_owned(),
        })?;
        Ok(Table { path: path.to_owned(), text })
    }

    /// Reads a file that need not exist.
    pub(super) fn read_optional(path: &Path) -> Result<Option<Table>, MapFileError> {
        if path.exists() {
            Table::read(path, "make it readable, or remove it if it is not part of the map").map(Some)
        } else {
            Ok(None)
        }
    }

    /// The lines with data: neither empty nor a comment (`#`).
    pub(super) fn rows(&self) -> impl Iterator<Item = Row<'_>> {
        self.text.lines().enumerate().filter(|(_, text)| is_data(text)).map(|(index, text)| Row {
            path: &self.path,
            line: index + 1,
            fields: text.split(',').map(str::trim).collect(),
        })
    }
}

fn is_data(text: &str) -> bool {
    let text = text.trim();
    !text.is_empty() && !text.starts_with('#')
}

impl<'a> Row<'a> {
    /// How many fields the row has.
    pub(super) fn len(&self) -> usize {
        self.fields.len()
    }

    /// An error about this row.
    pub(super) fn error(&self, problem: impl Into<String>, remedy: impl Into<String>) -> MapFileError {
        MapFileError::line(self.path, self.line, problem, remedy)
    }

    /// Checks the number of fields.
    pub(super) fn expect_fields(&self, least: usize, most: usize, columns: &str) -> Result<(), MapFileError> {
        if (least..=most).contains(&self.fields.len()) {
            return Ok(());
        }
        let wanted = if least == most { least.to_string() } else { format!("{least} to {most}") };
        Err(self.error(
            format!("it has {} fields, expected {wanted}", self.fields.len()),
            format!("the columns are: {columns} (a short last line means a truncated file)"),
        ))
    }

    /// One field as text.
    pub(super) fn text(&self, index: usize) -> &'a str {
        self.fields.get(index).copied().unwrap_or_default()
    }

    /// One field as an integer.
    pub(super) fn integer<T: FromStr>(&self, index: usize, name: &str) -> Result<T, MapFileError> {
        self.text(index).parse().map_err(|_| {
            self.error(
                format!("{name} is {:?}, which is no integer in range", self.text(index)),
                "write it in decimal digits without a fraction",
            )
        })
    }

    /// One field as a finite number.
    pub(super) fn number(&self, index: usize, name: &str) -> Result<f64, MapFileError> {
        match self.text(index).parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(value),
            _ => Err(self.error(
                format!("{name} is {:?}, which is no finite number", self.text(index)),
                "write a decimal number, or remove the record",
            )),
        }
    }

    /// One field as a finite single-precision number.
    pub(super) fn single(&self, index: usize, name: &str) -> Result<f32, MapFileError> {
        match self.text(index).parse::<f32>() {
            Ok(value) if value.is_finite() => Ok(value),
            _ => Err(self.error(
                format!("{name} is {:?}, which is no finite number", self.text(index)),
                "write a decimal number, or remove the record",
            )),
        }
    }

    /// `N` fields from `first` on as finite numbers.
    pub(super) fn numbers<const N: usize>(&self, first: usize, name: &str) -> Result<[f64; N], MapFileError> {
        let mut values = [0.0; N];
        for (offset, value) in values.iter_mut().enumerate() {
            *value = self.number(first + offset, name)?;
        }
        Ok(values)
    }

    /// The coordinates of a position (m), finite and within [`MAX_COORDINATE_M`].
    pub(super) fn position(&self, first: usize, name: &str) -> Result<[f64; 3], MapFileError> {
        let position = self.numbers(first, name)?;
        match position.into_iter().find(|value| !is_coordinate(*value)) {
            Some(value) => Err(self.error(
                format!("the {name} has the coordinate {value:e} m, more than {MAX_COORDINATE_M:e} m"),
                "write metres, in a frame whose origin is nearby",
            )),
            None => Ok(position),
        }
    }

    /// One field of hexadecimal digits as bytes.
    pub(super) fn bytes(&self, index: usize, name: &str) -> Result<Vec<u8>, MapFileError> {
        types::hexadecimal::decode(self.text(index)).filter(|bytes| !bytes.is_empty()).ok_or_else(|| {
            self.error(
                format!("the {name} is no whole number of bytes in hexadecimal digits"),
                "write two digits 0-9, a-f for each byte",
            )
        })
    }
}

/// As [`calibration::numbers::shortest`], in single precision.
pub(super) fn shortest_single(value: f32) -> String {
    let magnitude = value.abs();
    if magnitude == 0.0 || (1e-5..1e9).contains(&magnitude) {
        format!("{value}")
    } else {
        format!("{value:e}")
    }
}
