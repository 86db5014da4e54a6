//! The stamps of a folder's tables, read before the rest: which rows have wrong ones, and which images make a pair.

use crate::pairing::{PairCounts, pair};
use crate::stamps::order;
use crate::table::Table;
use std::collections::HashSet;
use std::path::Path;
use std::sync::Arc;

/// So many rows with wrong stamps are named, the others counted.
const MAX_NAMED: usize = 3;

/// Lines of a table that are left out.
pub(super) type SkippedLines = Arc<HashSet<u64>>;

/// The stamps of a table.
#[derive(Clone, Debug, Default)]
pub(super) struct TableStamps {
    /// Those that are used, in the order of the file.
    pub(super) used: Vec<i64>,
    /// The lines of the others.
    pub(super) skipped: SkippedLines,
}

impl TableStamps {
    /// Reads the first column, up to a row that its reader refuses, and names the stamps that are wrong.
    pub(super) fn read(path: &Path) -> Self {
        let Ok(mut table) = Table::open(path, "") else { return Self::default() };
        let (mut stamps, mut lines) = (Vec::new(), Vec::new());
        while let Ok(Some(row)) = table.next_row() {
            let Ok(stamp_ns) = row.stamp() else { break };
            stamps.push(stamp_ns);
            lines.push(row.line());
        }
        let outliers = order(&stamps, &[], &[]).outliers;
        for outlier in outliers.iter().take(MAX_NAMED) {
            tracing::warn!(
                "{}, line {}: the stamp {} is {}; the row is left out",
                path.display(),
                lines[outlier.index],
                stamps[outlier.index],
                outlier.describe()
            );
        }
        if let Some(more) = outliers.len().checked_sub(MAX_NAMED).filter(|more| *more > 0) {
            tracing::warn!("{}: {more} more rows with stamps like these are left out", path.display());
        }
        let skipped: HashSet<u64> = outliers.iter().map(|outlier| lines[outlier.index]).collect();
        let used = stamps.iter().zip(&lines).filter(|(_, line)| !skipped.contains(line));
        Self { used: used.map(|(stamp_ns, _)| *stamp_ns).collect(), skipped: Arc::new(skipped) }
    }
}

/// The frames of the cameras of a folder.
#[derive(Clone, Debug, Default)]
pub(super) struct FrameStamps {
    /// Stamps of the images of camera 0 and camera 1 in each frame.
    pub(super) frames: Vec<(i64, Option<i64>)>,
    /// Of each camera.
    pub(super) skipped: Vec<SkippedLines>,
    /// Of two cameras.
    pub(super) pairs: Option<PairCounts>,
}

impl FrameStamps {
    /// Reads the stamps of the first `cameras` cameras, and pairs them.
    pub(super) fn read(mav: &Path, cameras: usize, tolerance_ns: i64) -> Self {
        let read = |camera| TableStamps::read(&mav.join(format!("cam{camera}/data.csv")));
        let tables: Vec<TableStamps> = (0..cameras).map(read).collect();
        let skipped = tables.iter().map(|table| Arc::clone(&table.skipped)).collect();
        let (frames, pairs) = match tables.as_slice() {
            [first, second, ..] => {
                let (partners, counts) = pair(&first.used, &second.used, tolerance_ns);
                let partners = partners.iter().map(|partner| partner.map(|number| second.used[number]));
                (first.used.iter().copied().zip(partners).collect(), Some(counts))
            }
            [first] => (first.used.iter().map(|stamp_ns| (*stamp_ns, None)).collect(), None),
            [] => Default::default(),
        };
        Self { frames, skipped, pairs }
    }
}
