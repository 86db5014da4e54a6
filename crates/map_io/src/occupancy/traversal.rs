//! The cells of a grid along a segment.

/// Calls `visit` with each cell that a segment passes, in order, from that of its begin to that of its end.
///
/// # Arguments
/// * `from`, `to`: in cells, x and y; the cell (0, 0) is from 0 to 1 along both axes.
///
/// Source: Amanatides & Woo, A Fast Voxel Traversal Algorithm for Ray Tracing, Eurographics 1987.
pub(super) fn traverse(from: [f64; 2], to: [f64; 2], mut visit: impl FnMut([i64; 2])) {
    let cell_of = |point: [f64; 2]| point.map(|value| value.floor() as i64);
    let (mut cell, last) = (cell_of(from), cell_of(to));
    let step: [i64; 2] = std::array::from_fn(|axis| (last[axis] - cell[axis]).signum());
    // Parts of the segment until the next border, and between two borders, along each axis.
    let part = |axis: usize| 1.0 / (to[axis] - from[axis]).abs();
    let mut next: [f64; 2] = std::array::from_fn(|axis| {
        let border = cell[axis] as f64 + if step[axis] > 0 { 1.0 } else { 0.0 };
        if step[axis] == 0 { f64::INFINITY } else { (border - from[axis]).abs() * part(axis) }
    });
    visit(cell);
    // Borders are counted, so that rounding never leads past the end.
    let borders: i64 = (0..2).map(|axis| (last[axis] - cell[axis]).abs()).sum();
    for _ in 0..borders {
        let is_done = |axis: usize| cell[axis] == last[axis];
        let axis = usize::from(is_done(0) || !is_done(1) && next[1] < next[0]);
        cell[axis] += step[axis];
        next[axis] += part(axis);
        visit(cell);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::rngs::StdRng;
    use rand::{RngExt as _, SeedableRng as _};

    #[test]
    fn all_cells_of_a_segment_are_visited_once_and_no_others() {
        let mut random = StdRng::seed_from_u64(3);
        for _ in 0..2000 {
            let [from, to]: [[f64; 2]; 2] =
                std::array::from_fn(|_| std::array::from_fn(|_| random.random_range(-9.0..9.0)));
            let mut cells = Vec::new();
            traverse(from, to, |cell| cells.push(cell));
            assert_eq!(*cells.last().unwrap(), to.map(|value| value.floor() as i64));
            for pair in cells.windows(2) {
                assert_eq!(
                    (pair[0][0] - pair[1][0]).abs() + (pair[0][1] - pair[1][1]).abs(),
                    1,
                    "neighbours"
                );
            }
            for sample in 0..=500 {
                let at = f64::from(sample) / 500.0;
                let point = [0, 1].map(|axis| (from[axis] + at * (to[axis] - from[axis])).floor() as i64);
                assert!(cells.contains(&point), "{from:?} {to:?} {point:?}");
            }
            // Each is passed: the segment comes nearer to its middle than half a diagonal.
            for cell in &cells {
                let middle = cell.map(|value| value as f64 + 0.5);
                let along = [to[0] - from[0], to[1] - from[1]];
                let square = along[0].powi(2) + along[1].powi(2);
                let offset = [middle[0] - from[0], middle[1] - from[1]];
                let part = ((offset[0] * along[0] + offset[1] * along[1]) / square).clamp(0.0, 1.0);
                let distance = (offset[0] - part * along[0]).hypot(offset[1] - part * along[1]);
                assert!(distance < 0.5_f64.hypot(0.5) + 1e-9, "{from:?} {to:?} {cell:?}");
            }
        }
    }

    #[test]
    fn a_segment_within_a_cell_is_that_cell() {
        let mut cells = Vec::new();
        traverse([0.2, 0.2], [0.2, 0.2], |cell| cells.push(cell));
        assert_eq!(cells, [[0, 0]]);
    }
}
