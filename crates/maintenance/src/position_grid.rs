//! Positions by where they are, so that the nearest one is found without looking at all of them.

use std::collections::HashMap;

use nalgebra::Vector3;

/// Positions (m), by the cubes that they are in.
pub(crate) struct PositionGrid {
    side_m: f64,
    cubes: HashMap<[i64; 3], Vec<Vector3<f64>>>,
}

impl PositionGrid {
    /// # Arguments
    /// * `side_m`: of a cube.
    pub(crate) fn new(positions: impl Iterator<Item = Vector3<f64>>, side_m: f64) -> PositionGrid {
        let mut cubes: HashMap<[i64; 3], Vec<Vector3<f64>>> = HashMap::new();
        for position in positions {
            cubes.entry(cube_of(&position, side_m)).or_default().push(position);
        }
        PositionGrid { side_m, cubes }
    }

    /// Distance of the nearest one (m) where that is at most the side of a cube, else a larger number.
    pub(crate) fn nearest(&self, position: &Vector3<f64>) -> f64 {
        let [x, y, z] = cube_of(position, self.side_m);
        let near = |at: i64| at.saturating_sub(1)..=at.saturating_add(1);
        let cubes = near(x).flat_map(move |x| near(y).flat_map(move |y| near(z).map(move |z| [x, y, z])));
        let positions = cubes.filter_map(|cube| self.cubes.get(&cube)).flatten();
        positions.map(|of| (of - position).norm()).fold(f64::INFINITY, f64::min)
    }
}

fn cube_of(position: &Vector3<f64>, side_m: f64) -> [i64; 3] {
    position.map(|coordinate| (coordinate / side_m).floor() as i64).into()
}
