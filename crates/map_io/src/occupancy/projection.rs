//! The landmarks of a map in the plane.

use super::error::GridError;
use super::grid::{Cell, OccupancyGrid};
use super::traversal::traverse;
use geometry::tilt_beyond_limit_deg;
use map::MapContents;
use nalgebra::Vector3;
use std::collections::BTreeMap;

/// Most cells of a grid: a message of so many bytes goes over Zenoh.
const MAX_CELLS: u64 = 15_000_000;

/// Where the floor is.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Floor {
    /// z of the floor in the map's frame, metres.
    At(f64),
    /// So many metres below the median of the keyframes' cameras.
    BelowCameras(f64),
}

/// How a map becomes a grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GridSettings {
    /// Side of a cell, metres.
    pub resolution_m: f64,
    /// Where the floor is.
    pub floor: Floor,
    /// What is between these heights above the floor stops a robot, metres.
    pub heights_m: [f64; 2],
    /// What a camera sees farther away says nothing of obstacles there, metres: landmarks become uncertain with the distance.
    pub max_range_m: f64,
    /// A cell with fewer landmarks is not occupied.
    pub min_landmarks: u32,
}

impl GridSettings {
    /// Cells of 5 cm, obstacles from 0.1 to 2 m above the floor, seen within 10 m.
    pub fn new(floor: Floor) -> Self {
        Self { resolution_m: 0.05, floor, heights_m: [0.1, 2.0], max_range_m: 10.0, min_landmarks: 1 }
    }

    fn check(&self) -> Result<(), GridError> {
        let positive = [("the resolution", self.resolution_m), ("the range", self.max_range_m)];
        for (setting, value) in positive {
            if !(0.001..=1000.0).contains(&value) {
                return Err(GridError::Setting { setting, value, wanted: "it must be from 0.001 to 1000 m" });
            }
        }
        let [low, high] = self.heights_m;
        if !(low.is_finite() && high.is_finite() && low < high) {
            let wanted = "it must be above the lower height";
            return Err(GridError::Setting { setting: "the upper height", value: high, wanted });
        }
        let (Floor::At(floor) | Floor::BelowCameras(floor)) = self.floor;
        if !floor.is_finite() {
            return Err(GridError::Setting {
                setting: "the floor",
                value: floor,
                wanted: "it must be finite",
            });
        }
        Ok(())
    }
}

/// What was seen between the heights.
#[derive(Default)]
struct Seen {
    /// Landmarks: x and y, metres.
    obstacles: Vec<[f64; 2]>,
    /// What cameras looked through: both ends, metres, and whether a landmark is at the second.
    rays: Vec<([f64; 2], [f64; 2], bool)>,
}

impl OccupancyGrid {
    /// The grid of a map, in its x-y plane.
    ///
    /// A cell with a landmark between the two heights is occupied. Else it is free where the line from a camera to a landmark that it saw
    /// passes it between the heights. All others are unknown: walls without texture, too, have no landmarks.
    ///
    /// # Returns
    /// A grid that just holds what is known.
    ///
    /// # Errors
    /// Settings that are no lengths, a map whose z axis is not vertical, nothing between the heights, or too many cells.
    pub fn of_map(map: &MapContents, settings: &GridSettings) -> Result<Self, GridError> {
        settings.check()?;
        check_level(map.info.gravity_in_global)?;
        let cameras: BTreeMap<u64, Vector3<f64>> = map
            .keyframes
            .iter()
            .map(|keyframe| (keyframe.id, keyframe.global_from_keyframe.pose.translation))
            .collect();
        let floor = match settings.floor {
            Floor::At(z) => z,
            Floor::BelowCameras(height) => median(cameras.values().map(|camera| camera.z)) - height,
        };
        let heights = settings.heights_m.map(|height| floor + height);
        let (seen, positions) = look(map, &cameras, heights, settings.max_range_m);
        if seen.rays.is_empty() && seen.obstacles.is_empty() {
            let z = || positions.iter().map(|position| position.z);
            return Err(GridError::Empty {
                low_m: heights[0],
                high_m: heights[1],
                landmarks: positions.len(),
                lowest_m: z().fold(f64::INFINITY, f64::min),
                highest_m: z().fold(f64::NEG_INFINITY, f64::max),
            });
        }
        seen.grid(settings)
    }
}

/// What cameras saw between two heights, and where the landmarks are.
fn look(
    map: &MapContents,
    cameras: &BTreeMap<u64, Vector3<f64>>,
    [low, high]: [f64; 2],
    max_range_m: f64,
) -> (Seen, Vec<Vector3<f64>>) {
    let (mut seen, mut positions) = (Seen::default(), Vec::new());
    for (landmark, position) in map.landmarks_in_global() {
        positions.push(position);
        let is_between = position.z >= low && position.z <= high;
        let mut is_near = false;
        for observation in &landmark.observations {
            let Some(camera) = cameras.get(&observation.keyframe) else { continue };
            let range = (position - camera).norm();
            is_near |= range <= max_range_m;
            let reach = (max_range_m / range).min(1.0);
            if let Some([begin, end]) = between(camera.z, position.z, [low, high], reach) {
                let at = |part: f64| (camera + (position - camera) * part).xy().into();
                seen.rays.push((at(begin), at(end), is_between && reach >= 1.0));
            }
        }
        if is_between && is_near {
            seen.obstacles.push(position.xy().into());
        }
    }
    (seen, positions)
}

/// The part of a line of sight that is between two heights.
///
/// # Arguments
/// * `from`, `to`: its heights at 0 and at 1.
/// * `reach`: where it ends, from 0 to 1.
fn between(from: f64, to: f64, [low, high]: [f64; 2], reach: f64) -> Option<[f64; 2]> {
    let rise = to - from;
    let crossings = [low, high].map(|height| (height - from) / rise);
    let is_level = rise.abs() < 1e-12;
    let (enters, leaves) = if is_level {
        if from >= low && from <= high { (0.0, 1.0) } else { return None }
    } else {
        (crossings[0].min(crossings[1]), crossings[0].max(crossings[1]))
    };
    let (begin, end) = (enters.max(0.0), leaves.min(reach));
    (begin < end).then_some([begin, end])
}

impl Seen {
    fn grid(&self, settings: &GridSettings) -> Result<OccupancyGrid, GridError> {
        let resolution_m = settings.resolution_m;
        let ends = self.rays.iter().flat_map(|(from, to, _)| [from, to]).chain(&self.obstacles);
        let (mut least, mut most) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for end in ends {
            for axis in 0..2 {
                least[axis] = least[axis].min(end[axis]);
                most[axis] = most[axis].max(end[axis]);
            }
        }
        // Multiples of a cell: grids of one place lie on each other.
        let first = least.map(|m| (m / resolution_m).floor());
        let [width, height] =
            [0, 1].map(|axis| ((most[axis] / resolution_m).floor() - first[axis]) as u64 + 1);
        if width.saturating_mul(height) > MAX_CELLS {
            return Err(GridError::TooLarge { width, height, most: MAX_CELLS });
        }
        let (width, height) = (width as usize, height as usize);
        let in_cells = |point: &[f64; 2]| [0, 1].map(|axis| point[axis] / resolution_m - first[axis]);
        let index = |[column, row]: [i64; 2]| {
            let is_inside = column >= 0 && row >= 0 && (column as usize) < width && (row as usize) < height;
            is_inside.then_some(row as usize * width + column as usize)
        };
        let mut cells = vec![Cell::Unknown; width * height];
        for (from, to, ends_at_landmark) in &self.rays {
            let (from, to) = (in_cells(from), in_cells(to));
            let last = to.map(|value| value.floor() as i64);
            traverse(from, to, |cell| {
                let is_landmark = *ends_at_landmark && cell == last;
                if let Some(at) = index(cell).filter(|_| !is_landmark) {
                    cells[at] = Cell::Free;
                }
            });
        }
        let mut counts: BTreeMap<usize, u32> = BTreeMap::new();
        for obstacle in &self.obstacles {
            if let Some(at) = index(in_cells(obstacle).map(|value| value.floor() as i64)) {
                *counts.entry(at).or_default() += 1;
            }
        }
        for (at, count) in counts {
            if count >= settings.min_landmarks {
                cells[at] = Cell::Occupied;
            }
        }
        let origin_m = first.map(|cell| cell * resolution_m);
        Ok(OccupancyGrid { resolution_m, origin_m, width, height, cells })
    }
}

/// Refuses a map whose z axis is known not to be vertical.
fn check_level(gravity: Option<Vector3<f64>>) -> Result<(), GridError> {
    let tilt_deg = gravity.and_then(|gravity| tilt_beyond_limit_deg(&-gravity));
    tilt_deg.map_or(Ok(()), |tilt_deg| Err(GridError::NotLevel { tilt_deg }))
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    geometry::median(&mut values.collect::<Vec<f64>>()).unwrap_or_default()
}
