//! Cells: a k-d tree over the ground plane.

use nalgebra::{Unit, Vector3};
use serde::{Deserialize, Serialize};

/// Names a cell of a partition. A number is never used again for another place.
pub type CellId = u32;

/// A tree is cut at medians: more levels than these are no tree of ours.
const MAX_DEPTH: usize = 64;
/// Places that are nearer to each other than this are not cut apart, metres: differences like these are rounding.
const SMALLEST_CELL_M: f64 = 1e-3;
/// How far axes may be from unit length and from a right angle.
const AXIS_TOLERANCE: f64 = 1e-6;

/// Cuts the ground plane into cells. A later release keeps the cuts of the former one and cuts only cells that have grown too
/// large, so that cells in which nothing changed stay as they are.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Partition {
    /// Unit vectors in G that span the ground plane.
    axes: [[f64; 3]; 2],
    root: Node,
    /// The number of the next new cell.
    next: CellId,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
enum Node {
    Cell(CellId),
    Split {
        /// Index of the axis.
        axis: usize,
        /// What is below goes to `low`, metres along the axis.
        at: f64,
        low: Box<Node>,
        high: Box<Node>,
    },
}

impl Partition {
    /// One cell for everything.
    ///
    /// # Arguments
    /// * `gravity_in_global`: unit vector; the ground plane is perpendicular to it. `None`: the plane of x and y.
    pub fn whole(gravity_in_global: Option<Vector3<f64>>) -> Self {
        let up = Unit::new_normalize(gravity_in_global.unwrap_or_else(Vector3::z));
        // The axis of G that lies flattest, made perpendicular.
        let flattest = Vector3::ith_axis(up.iamin());
        let first = (flattest.into_inner() - up.into_inner() * up.dot(&flattest)).normalize();
        let second = up.cross(&first);
        Self { axes: [first.into(), second.into()], root: Node::Cell(0), next: 1 }
    }

    /// The cell of a position in G, metres.
    pub fn cell_of(&self, position: &Vector3<f64>) -> CellId {
        let mut node = &self.root;
        loop {
            match node {
                Node::Cell(cell) => return *cell,
                Node::Split { axis, at, low, high } => {
                    node = if self.along(*axis, position) < *at { low } else { high };
                }
            }
        }
    }

    /// Cuts cells that hold more positions than `limit`, until none does.
    pub fn cut(&mut self, positions: &[Vector3<f64>], limit: usize) {
        let flat = positions.iter().map(|position| [0, 1].map(|axis| self.along(axis, position))).collect();
        grow(&mut self.root, flat, limit.max(1), &mut self.next, 0);
    }

    /// All cells.
    pub fn cells(&self) -> Vec<CellId> {
        let mut cells = Vec::new();
        collect(&self.root, &mut cells);
        cells
    }

    /// Whether this can be a partition.
    ///
    /// # Errors
    /// [`PartitionError`].
    pub(crate) fn check(&self) -> Result<(), PartitionError> {
        let [first, second] = self.axes.map(Vector3::from);
        let deviations = [first.norm() - 1.0, second.norm() - 1.0, first.dot(&second)];
        if !deviations.iter().all(|deviation| deviation.abs() <= AXIS_TOLERANCE) {
            return Err(PartitionError::Axes);
        }
        check_node(&self.root, 0)?;
        let mut cells = self.cells();
        let count = cells.len();
        cells.sort_unstable();
        cells.dedup();
        if cells.len() != count || cells.last().is_some_and(|last| *last >= self.next) {
            return Err(PartitionError::Twice);
        }
        Ok(())
    }

    fn along(&self, axis: usize, position: &Vector3<f64>) -> f64 {
        Vector3::from(self.axes[axis.min(1)]).dot(position)
    }
}

/// Why something is no partition.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PartitionError {
    /// Its axes are not two orthogonal unit vectors.
    #[error("the axes of its partition do not span a plane")]
    Axes,
    /// A cut that no partition has.
    #[error("its partition has a cut along axis {axis} at {at}, {depth} levels deep")]
    Cut {
        /// 0 or 1.
        axis: usize,
        /// Where, metres.
        at: f64,
        /// Cuts above it.
        depth: usize,
    },
    /// Two leaves are the same cell.
    #[error("a cell of its partition is named twice")]
    Twice,
}

fn collect(node: &Node, cells: &mut Vec<CellId>) {
    match node {
        Node::Cell(cell) => cells.push(*cell),
        Node::Split { low, high, .. } => {
            collect(low, cells);
            collect(high, cells);
        }
    }
}

fn check_node(node: &Node, depth: usize) -> Result<(), PartitionError> {
    let Node::Split { axis, at, low, high } = node else { return Ok(()) };
    if *axis > 1 || !at.is_finite() || depth >= MAX_DEPTH {
        return Err(PartitionError::Cut { axis: *axis, at: *at, depth });
    }
    check_node(low, depth + 1)?;
    check_node(high, depth + 1)
}

fn grow(node: &mut Node, positions: Vec<[f64; 2]>, limit: usize, next: &mut CellId, depth: usize) {
    if let Node::Cell(cell) = *node {
        if positions.len() <= limit || depth >= MAX_DEPTH {
            return;
        }
        let Some((axis, at)) = median(&positions) else { return };
        // The lower half keeps the number.
        *node = Node::Split { axis, at, low: Box::new(Node::Cell(cell)), high: Box::new(Node::Cell(*next)) };
        *next += 1;
    }
    if let Node::Split { axis, at, low, high } = node {
        let (below, above) = positions.into_iter().partition(|position: &[f64; 2]| position[*axis] < *at);
        grow(low, below, limit, next, depth + 1);
        grow(high, above, limit, next, depth + 1);
    }
}

/// The cut along the longer side that leaves half on either side; `None` where all positions are about the same.
fn median(positions: &[[f64; 2]]) -> Option<(usize, f64)> {
    let along = |axis: usize| {
        let mut values: Vec<f64> = positions.iter().map(|position| position[axis]).collect();
        values.sort_unstable_by(f64::total_cmp);
        values
    };
    let side = |values: &[f64]| values.last().zip(values.first()).map_or(0.0, |(last, first)| last - first);
    let sides = [along(0), along(1)];
    let axis = usize::from(side(&sides[1]) > side(&sides[0]));
    if side(&sides[axis]) < SMALLEST_CELL_M {
        return None;
    }
    let values = &sides[axis];
    // Something must lie below the cut.
    let at = *values.get(values.len() / 2)?;
    let at = if at > values[0] { at } else { *values.iter().find(|value| **value > at)? };
    Some((axis, at))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn places(count: usize) -> impl Strategy<Value = Vec<Vector3<f64>>> {
        let coordinate = || prop_oneof![-1e3..1e3, (-3..3).prop_map(f64::from)];
        let place = (coordinate(), coordinate(), coordinate()).prop_map(|(x, y, z)| Vector3::new(x, y, z));
        prop::collection::vec(place, 1..count)
    }

    fn counts(partition: &Partition, places: &[Vector3<f64>]) -> std::collections::BTreeMap<CellId, usize> {
        let mut counts = std::collections::BTreeMap::new();
        for place in places {
            *counts.entry(partition.cell_of(place)).or_default() += 1;
        }
        counts
    }

    proptest! {
        #[test]
        fn cells_hold_at_most_their_limit_and_are_balanced(places in places(300), limit in 1..40_usize) {
            let mut partition = Partition::whole(None);
            partition.cut(&places, limit);
            partition.check().unwrap();
            for (cell, count) in counts(&partition, &places) {
                let same = |a: &Vector3<f64>, b: &Vector3<f64>| (a.xy() - b.xy()).norm() < 2.0 * SMALLEST_CELL_M;
                let inside: Vec<_> = places.iter().filter(|place| partition.cell_of(place) == cell).collect();
                prop_assert!(count <= limit || inside.iter().all(|place| same(place, inside[0])));
            }
        }

        #[test]
        fn growth_keeps_the_cells_that_are_small_enough(first in places(200), more in places(200)) {
            let mut partition = Partition::whole(None);
            partition.cut(&first, 20);
            let before = partition.clone();
            let all: Vec<_> = first.iter().chain(&more).copied().collect();
            partition.cut(&all, 20);
            partition.check().unwrap();
            let sizes = counts(&before, &all);
            for place in &all {
                let cell = before.cell_of(place);
                if sizes[&cell] <= 20 {
                    prop_assert_eq!(partition.cell_of(place), cell);
                }
            }
        }
    }

    #[test]
    fn cells_of_many_places_are_about_equally_full() {
        let places: Vec<_> = (0..4096)
            .map(|i| Vector3::new(f64::from(i % 64), f64::from(i / 64) * 1.01, f64::from(i % 7)))
            .collect();
        let mut partition = Partition::whole(Some(-Vector3::z()));
        partition.cut(&places, 300);
        let counts = counts(&partition, &places);
        assert_eq!(counts.len(), partition.cells().len());
        assert!(counts.values().all(|count| (200..=300).contains(count)), "{counts:?}");
    }

    #[test]
    fn the_plane_is_perpendicular_to_gravity() {
        for gravity in [Vector3::x(), -Vector3::y(), -Vector3::z(), Vector3::new(1.0, -2.0, 0.5).normalize()]
        {
            let mut partition = Partition::whole(Some(gravity));
            partition.check().unwrap();
            // Places one above the other are one cell, however many.
            let tower: Vec<_> = (0..100).map(|i| gravity * f64::from(i)).collect();
            partition.cut(&tower, 10);
            assert_eq!(partition.cells(), [0], "{gravity}");
            // And beside each other they are not.
            let row: Vec<_> =
                tower.iter().map(|place| place + gravity.yzx() * (place.norm() + 1.0)).collect();
            partition.cut(&row, 10);
            assert!(partition.cells().len() > 5, "{gravity}");
        }
    }

    #[test]
    fn what_is_no_partition_is_refused() {
        let text = |value: &Partition| serde_json::to_string(value).unwrap();
        let mut cut = Partition::whole(None);
        cut.cut(&[Vector3::zeros(), Vector3::x()], 1);
        assert_eq!(serde_json::from_str::<Partition>(&text(&cut)).unwrap(), cut);
        let doubled = Partition { next: 0, ..cut.clone() };
        assert_eq!(doubled.check().unwrap_err(), PartitionError::Twice);
        let flat = Partition { axes: [[1.0, 0.0, 0.0]; 2], ..cut.clone() };
        assert_eq!(flat.check().unwrap_err(), PartitionError::Axes);
        let mut deep = Node::Cell(0);
        for level in 1..100 {
            let high = Box::new(Node::Cell(level));
            deep = Node::Split { axis: 0, at: 0.0, low: Box::new(deep), high };
        }
        assert!(
            Partition { root: deep, next: 200, ..cut }
                .check()
                .unwrap_err()
                .to_string()
                .contains("levels deep")
        );
    }
}
