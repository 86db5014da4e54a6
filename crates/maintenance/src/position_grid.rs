//! Things by where they are, so that those near a position are found without looking at all of them.

use std::collections::HashMap;

use nalgebra::Vector3;

/// Values by the cubes that their positions (m) are in.
pub(crate) struct PositionGrid<T> {
    side_m: f64,
    cubes: HashMap<[i64; 3], Vec<T>>,
}

impl<T> PositionGrid<T> {
    /// A grid without values.
    ///
    /// # Arguments
    /// * `side_m`: of a cube.
    pub(crate) fn new(side_m: f64) -> PositionGrid<T> {
        PositionGrid { side_m, cubes: HashMap::new() }
    }

    pub(crate) fn insert(&mut self, position: &Vector3<f64>, value: T) {
        let cube = self.cube_of(position);
        self.cubes.entry(cube).or_default().push(value);
    }

    /// All values within the side of a cube, and some that are farther away: those of the cube of the position and of its neighbours,
    /// of each cube in the order in which they were inserted.
    pub(crate) fn around<'a>(&'a self, position: &Vector3<f64>) -> impl Iterator<Item = &'a T> + use<'a, T> {
        let [x, y, z] = self.cube_of(position);
        let near = |at: i64| at.saturating_sub(1)..=at.saturating_add(1);
        let cubes = near(x).flat_map(move |x| near(y).flat_map(move |y| near(z).map(move |z| [x, y, z])));
        cubes.filter_map(|cube| self.cubes.get(&cube)).flatten()
    }

    fn cube_of(&self, position: &Vector3<f64>) -> [i64; 3] {
        position.map(|coordinate| (coordinate / self.side_m).floor() as i64).into()
    }
}

impl PositionGrid<Vector3<f64>> {
    /// A grid of positions (m), each of which is its own value.
    pub(crate) fn of_positions(positions: impl Iterator<Item = Vector3<f64>>, side_m: f64) -> Self {
        let mut grid = PositionGrid::new(side_m);
        positions.for_each(|position| grid.insert(&position, position));
        grid
    }

    /// Distance of the nearest one (m) where that is at most the side of a cube, else a larger number.
    pub(crate) fn nearest(&self, position: &Vector3<f64>) -> f64 {
        self.around(position).map(|of| (of - position).norm()).fold(f64::INFINITY, f64::min)
    }
}
