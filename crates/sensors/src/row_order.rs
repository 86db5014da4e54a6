//! The order in which the rows of a table are read.

use crate::SequenceError;
use crate::table::Table;
use std::collections::HashSet;
use std::path::Path;

/// The order of the rows of a table: that of the file without some lines, or another one.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct RowOrder {
    /// Lines that are left out.
    pub(crate) skipped: HashSet<u64>,
    /// Where it is not that of the file.
    pub(crate) sorted: Option<SortedLines>,
}

/// Lines in an order that is not that of the file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct SortedLines {
    /// Up to `last` of the file.
    pub(crate) lines: Vec<u64>,
    /// Lines behind this one follow in the order of the file: the first of them has no stamp.
    pub(crate) last: u64,
}

impl RowOrder {
    /// The rows of a table by their stamps; those of one stamp in the order of the file.
    ///
    /// # Errors
    /// A row without a stamp, a file that cannot be read.
    pub(crate) fn by_stamp(path: &Path) -> Result<Self, SequenceError> {
        let mut table = Table::open(path, "")?;
        let mut rows = Vec::new();
        while let Some(row) = table.next_row()? {
            rows.push((row.stamp()?, row.line()));
        }
        let last = rows.last().map_or(0, |(_, line)| *line);
        rows.sort_by_key(|(stamp_ns, _)| *stamp_ns);
        let lines = rows.into_iter().map(|(_, line)| line).collect();
        Ok(Self { skipped: HashSet::new(), sorted: Some(SortedLines { lines, last }) })
    }
}
