//! What the columns of a table of poses are: as its header says, else as its form shows.

use sensors::{PoseColumns, QuaternionOrder};
use thiserror::Error;

/// Columns of a row of KITTI: three rows of `[R | t]`.
pub(super) const KITTI_COLUMNS: usize = 12;

/// Times of day in nanoseconds, microseconds and milliseconds since 1970 exceed these, and in seconds they do not.
const TIMES_OF_DAY: [(f64, TimeUnit); 3] =
    [(1e17, TimeUnit::Nanoseconds), (1e14, TimeUnit::Microseconds), (1e11, TimeUnit::Milliseconds)];

/// The unit of a table's times.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum TimeUnit {
    Seconds,
    Milliseconds,
    Microseconds,
    Nanoseconds,
}

impl TimeUnit {
    /// Decimal places down to a nanosecond.
    pub(super) fn places(self) -> i32 {
        match self {
            Self::Seconds => 9,
            Self::Milliseconds => 6,
            Self::Microseconds => 3,
            Self::Nanoseconds => 0,
        }
    }

    /// The unit of a time by its size; of a time that counts from the start of a recording, by how it is written.
    fn of(cell: &str, with_commas: bool) -> Self {
        let size = cell.parse::<f64>().map_or(0.0, f64::abs);
        if let Some((_, unit)) = TIMES_OF_DAY.into_iter().find(|(least, _)| size >= *least) {
            return unit;
        }
        let is_whole = !cell.contains(['.', 'e', 'E']);
        if with_commas && is_whole { Self::Nanoseconds } else { Self::Seconds }
    }
}

/// How the rows of a table of poses are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Layout {
    /// Columns are separated by commas; else by blanks or tabs.
    pub(super) with_commas: bool,
    pub(super) unit: TimeUnit,
    pub(super) columns: PoseColumns,
    /// The header names the columns.
    pub(super) by_header: bool,
}

/// Why the layout of a table is unknown.
#[derive(Debug, PartialEq, Eq, Error)]
pub(super) enum LayoutError {
    #[error(
        "{columns} columns are no known file of poses: known are TUM (t x y z qx qy qz qw), EuRoC ground truth with 8 or 17 \
         columns (ns, position, quaternion with w first, ...), reference_poses.csv with 10, states.csv of a run, KITTI \
         (12 columns), and tables whose header names the columns (timestamp, x, y, z, qw, qx, qy, qz in any order)"
    )]
    Unknown { columns: usize },
    #[error(
        "without a header nothing says whether the quaternion begins with w (EuRoC) or ends with it (TUM, ROS): say \
         --quaternion wxyz or --quaternion xyzw, or give the file a header (timestamp,x,y,z,qw,qx,qy,qz)"
    )]
    QuaternionOrder,
}

impl Layout {
    /// TUM: seconds, blanks, w last.
    #[cfg(test)]
    pub(super) const TUM: Self = Self {
        with_commas: false,
        unit: TimeUnit::Seconds,
        columns: PoseColumns::in_order(QuaternionOrder::WLast),
        by_header: false,
    };

    /// The layout of a table.
    ///
    /// # Arguments
    /// * `first`: its first row.
    /// * `header`: the columns that its header names.
    /// * `quaternion`: the order of a quaternion of which neither header nor form tells it.
    pub(super) fn of(
        first: &str,
        header: Option<PoseColumns>,
        quaternion: Option<QuaternionOrder>,
    ) -> Result<Self, LayoutError> {
        let with_commas = first.contains(',');
        let cells = cells(first, with_commas);
        if let Some(columns) = header.filter(|columns| columns.width() <= cells.len()) {
            let unit = TimeUnit::of(cells[columns.stamp], with_commas);
            return Ok(Self { with_commas, unit, columns, by_header: true });
        }
        let unit = TimeUnit::of(cells.first().copied().unwrap_or_default(), with_commas);
        if with_commas && cells.len() < 8 {
            return Err(LayoutError::Unknown { columns: cells.len() });
        }
        let order = if !with_commas || unit == TimeUnit::Seconds {
            // TUM, with blanks or commas.
            QuaternionOrder::WLast
        } else if first.trim_end().ends_with(',') {
            // VINS-Mono and VINS-Fusion end every row with a comma.
            QuaternionOrder::WFirst
        } else {
            quaternion.ok_or(LayoutError::QuaternionOrder)?
        };
        Ok(Self { with_commas, unit, columns: PoseColumns::in_order(order), by_header: false })
    }
}

/// The cells of a row, without what a comma at its end leaves.
pub(super) fn cells(row: &str, with_commas: bool) -> Vec<&str> {
    if !with_commas {
        return row.split_ascii_whitespace().collect();
    }
    let row = row.trim();
    row.strip_suffix(',').unwrap_or(row).split(',').map(str::trim).collect()
}
