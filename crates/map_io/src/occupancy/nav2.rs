//! The files of Nav2's map server.

use super::grid::{Cell, OccupancyGrid};
use std::fmt::Write as _;
use std::io;
use std::path::Path;

/// Name of the description.
pub const NAV2_YAML: &str = "map.yaml";
/// Name of the image that it refers to.
pub const NAV2_IMAGE: &str = "map.pgm";

/// Thresholds between which a cell is unknown: a pixel of 205 is occupied with 0.196.
const OCCUPIED: f64 = 0.65;
const FREE: f64 = 0.196;

impl Cell {
    /// The grey value that ROS's map server writes.
    fn pixel(self) -> u8 {
        match self {
            Self::Occupied => 0,
            Self::Unknown => 205,
            Self::Free => 254,
        }
    }
}

impl OccupancyGrid {
    /// Writes `map.yaml` and `map.pgm` (mode `trinary`) into a folder, which is created where it is missing. Older ones are replaced.
    ///
    /// # Errors
    /// A folder that cannot be written.
    pub fn write_nav2(&self, folder: impl AsRef<Path>) -> io::Result<()> {
        let folder = folder.as_ref();
        std::fs::create_dir_all(folder)?;
        files::write_whole(folder.join(NAV2_IMAGE), &self.pgm())?;
        files::write_whole(folder.join(NAV2_YAML), self.yaml().as_bytes())
    }

    /// A binary PGM; its first row is the one of the largest y.
    fn pgm(&self) -> Vec<u8> {
        let mut bytes = format!("P5\n{} {}\n255\n", self.width, self.height).into_bytes();
        for row in self.cells.chunks(self.width.max(1)).rev() {
            bytes.extend(row.iter().map(|cell| cell.pixel()));
        }
        bytes
    }

    fn yaml(&self) -> String {
        let [x, y] = self.origin_m;
        let mut text = format!("image: {NAV2_IMAGE}\nmode: trinary\n");
        // Writing to a string does not fail.
        let _ = writeln!(text, "resolution: {:?}\norigin: [{x:?}, {y:?}, 0.0]", self.resolution_m);
        let _ = writeln!(text, "negate: 0\noccupied_thresh: {OCCUPIED}\nfree_thresh: {FREE}");
        text
    }
}
