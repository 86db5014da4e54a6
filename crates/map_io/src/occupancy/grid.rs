//! Cells in the plane.

/// What is known of a cell.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Cell {
    /// Nothing.
    #[default]
    Unknown,
    /// A camera looked through it.
    Free,
    /// A landmark is in it.
    Occupied,
}

impl Cell {
    /// As `nav_msgs/OccupancyGrid` writes it: percent of being occupied, -1 where that is unknown.
    pub fn percent(self) -> i8 {
        match self {
            Self::Unknown => -1,
            Self::Free => 0,
            Self::Occupied => 100,
        }
    }
}

/// Cells in the x-y plane of a map.
#[derive(Clone, Debug, PartialEq)]
pub struct OccupancyGrid {
    /// Side of a cell, metres.
    pub resolution_m: f64,
    /// The outer corner of the first cell in the map's frame, metres: where x and y are least.
    pub origin_m: [f64; 2],
    /// Cells along x.
    pub width: usize,
    /// Cells along y.
    pub height: usize,
    /// By rows of equal y, beginning at the origin: `width * height` cells.
    pub cells: Vec<Cell>,
}

impl OccupancyGrid {
    /// The cell at a place, `None` outside of the grid.
    ///
    /// # Arguments
    /// * `x`, `y`: in the map's frame, metres.
    pub fn at(&self, x: f64, y: f64) -> Option<Cell> {
        let [column, row] =
            [x - self.origin_m[0], y - self.origin_m[1]].map(|m| (m / self.resolution_m).floor());
        let is_inside = column >= 0.0 && row >= 0.0 && column < self.width as f64 && row < self.height as f64;
        if is_inside { self.cells.get(row as usize * self.width + column as usize).copied() } else { None }
    }

    /// How many cells are of a kind.
    pub fn count(&self, kind: Cell) -> usize {
        self.cells.iter().filter(|cell| **cell == kind).count()
    }
}
