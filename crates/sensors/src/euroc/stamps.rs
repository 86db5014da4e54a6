//! The stamps of a folder's tables, read before the rest: which rows have wrong ones, in which order they are read, and which
//! images make a frame.

use crate::CameraSensor;
use crate::pairing::{JoinedImages, PairCounts, join_recorded};
use crate::row_order::{RowOrder, SortedLines};
use crate::stamps::{Told, order};
use crate::table::Table;
use std::collections::HashSet;
use std::path::Path;
use std::sync::Arc;

/// The stamps of a table.
#[derive(Clone, Debug, Default)]
pub(super) struct TableStamps {
    /// Those that are used, in order of time.
    pub(super) used: Vec<i64>,
    /// The order in which the rows are read.
    pub(super) order: Arc<RowOrder>,
    /// Stamps that are wrong.
    pub(super) left_out: Arc<HashSet<i64>>,
}

impl TableStamps {
    /// Reads the first column, up to a row that its reader refuses, and says what is odd about the stamps.
    ///
    /// A table has no times of recording: where many rows in a row go back, its clock was set back or parts of the file changed
    /// places, and nobody knows which. Such rows stay where they are, and are refused when they are read; so are those of a table
    /// whose stamps hardly differ.
    pub(super) fn read(path: &Path) -> Self {
        let Ok(mut table) = Table::open(path, "") else { return Self::default() };
        let (mut stamps, mut lines) = (Vec::new(), Vec::new());
        while let Ok(Some(row)) = table.next_row() {
            let Ok(stamp_ns) = row.stamp() else { break };
            stamps.push(stamp_ns);
            lines.push(row.line());
        }
        let mut found = order(&stamps, &[], &[]);
        let left_out: HashSet<i64> = found.outliers.iter().map(|outlier| stamps[outlier.index]).collect();
        if !found.steps.is_empty() || found.doubled > found.sorted.len() {
            let is_wrong: HashSet<usize> = found.outliers.iter().map(|outlier| outlier.index).collect();
            let as_written =
                stamps.iter().copied().enumerate().filter(|(index, _)| !is_wrong.contains(index));
            found.sorted = as_written.map(|(index, stamp_ns)| (stamp_ns, index)).collect();
            (found.steps, found.doubled, found.out_of_order) = Default::default();
        }
        let which = |index: usize| format!("line {}", lines[index]);
        found.tell(&stamps, &Told { name: &path.display().to_string(), which: &which, all: "rows" });
        if found.out_of_order > 0 {
            tracing::warn!("{}: {}", path.display(), found.describe_order(stamps.len(), "rows"));
        }
        let used: HashSet<usize> = found.sorted.iter().map(|(_, index)| *index).collect();
        let skipped =
            (0..lines.len()).filter(|index| !used.contains(index)).map(|index| lines[index]).collect();
        let is_in_order = found.sorted.is_sorted_by_key(|(_, index)| *index);
        let sorted = (!is_in_order).then(|| SortedLines {
            lines: found.sorted.iter().map(|(_, index)| lines[*index]).collect(),
            last: lines.last().copied().unwrap_or(0),
        });
        Self {
            used: found.sorted.iter().map(|(stamp_ns, _)| *stamp_ns).collect(),
            order: Arc::new(RowOrder { skipped, sorted }),
            left_out: Arc::new(left_out),
        }
    }
}

/// The frames of the cameras of a folder.
#[derive(Clone, Debug, Default)]
pub(super) struct FrameStamps {
    /// The images of each frame.
    pub(super) frames: Vec<JoinedImages>,
    /// Of each camera.
    pub(super) images: Vec<TableStamps>,
    /// Of stereo pairs.
    pub(super) pairs: Option<PairCounts>,
}

impl FrameStamps {
    /// Reads the stamps of the cameras, and joins their images to frames.
    pub(super) fn read(mav: &Path, cameras: &[CameraSensor], tolerance_ns: i64) -> Self {
        let read = |camera| TableStamps::read(&mav.join(format!("cam{camera}/data.csv")));
        let tables: Vec<TableStamps> = (0..cameras.len()).map(read).collect();
        let stamps = tables.iter().map(|table| table.used.iter().copied());
        let (frames, pairs) = join_recorded(cameras, stamps, tolerance_ns);
        Self { frames, images: tables, pairs }
    }
}
