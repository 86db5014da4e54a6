//! Grids of a room whose walls are known.

use super::*;
use geometry::{Camera, Distortion, Pose, PoseWithCovariance};
use map::{Keyframe, Landmark, MapContents, MapMetadata, Observation};
use nalgebra::{UnitQuaternion, Vector3};
use protocol::DescriptorKind;
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};

/// Half the side of the room, metres: the middle of a cell.
const WALL: f64 = 3.05;
/// Height of the camera above the floor, which is at z = -1 in the map.
const CAMERA: f64 = 0.5;
const FLOOR: f64 = -1.0;

fn keyframe(id: u64, position: Vector3<f64>) -> Keyframe {
    let (focal, centre) = ([300.0; 2], [160.0, 120.0]);
    Keyframe {
        id,
        stamp_ns: id as i64,
        global_from_keyframe: PoseWithCovariance::exact(Pose::new(UnitQuaternion::identity(), position)),
        camera: Camera { width: 320, height: 240, focal, centre, distortion: Distortion::None },
        features: None,
    }
}

/// A landmark in the frame of the map, seen by the keyframes 0 to `seen_by`.
fn landmark(id: u64, position: Vector3<f64>, map: &MapContents, seen_by: u64) -> Landmark {
    let anchor = &map.keyframes[0].global_from_keyframe.pose;
    let observation = |keyframe| Observation { keyframe, pixel: [0.0; 2], descriptor: vec![0; 32] };
    let position_in_anchor = anchor.inverse_transform(&position);
    Landmark { id, anchor: 0, position_in_anchor, observations: (0..seen_by).map(observation).collect() }
}

/// A room of 6.1 x 6.1 m with 4 cameras and landmarks on its walls up to 2.5 m, on its floor and on its ceiling.
fn room() -> MapContents {
    let mut map = MapContents::empty(MapMetadata::new("room", "test", DescriptorKind::Binary, 32));
    for (id, [x, y]) in [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]].into_iter().enumerate() {
        map.keyframes.push(keyframe(id as u64, Vector3::new(x, y, FLOOR + CAMERA)));
    }
    let mut random = StdRng::seed_from_u64(7);
    for id in 0..20_000 {
        let along = random.random_range(-WALL..WALL);
        let height = FLOOR + random.random_range(0.0..2.5);
        let [other, third] = std::array::from_fn(|_| random.random_range(-WALL..WALL));
        let position = match id % 6 {
            0 => Vector3::new(WALL, along, height),
            1 => Vector3::new(-WALL, along, height),
            2 => Vector3::new(along, WALL, height),
            3 => Vector3::new(along, -WALL, height),
            4 => Vector3::new(other, third, FLOOR),
            _ => Vector3::new(other, third, FLOOR + 2.5),
        };
        let landmark = landmark(id, position, &map, 4);
        map.landmarks.push(landmark);
    }
    map
}

fn settings() -> GridSettings {
    GridSettings { resolution_m: 0.1, ..GridSettings::new(Floor::BelowCameras(CAMERA)) }
}

#[test]
fn walls_are_occupied_the_room_is_free_and_nothing_is_known_behind() {
    let grid = OccupancyGrid::of_map(&room(), &settings()).unwrap();
    assert_eq!(
        grid,
        OccupancyGrid::of_map(&room(), &GridSettings { floor: Floor::At(FLOOR), ..settings() }).unwrap()
    );
    for step in -27..=27 {
        let along = f64::from(step) * 0.1 + 0.01;
        for wall in [[WALL, along], [-WALL, along], [along, WALL], [along, -WALL]] {
            assert_eq!(grid.at(wall[0], wall[1]), Some(Cell::Occupied), "{wall:?}");
        }
        for other in -27..=27 {
            let place = (along, f64::from(other) * 0.1 + 0.01);
            assert_eq!(grid.at(place.0, place.1), Some(Cell::Free), "{place:?}");
        }
        assert_eq!(grid.at(WALL + 0.3, along), None, "the grid ends at the walls");
    }
}

#[test]
fn what_is_low_or_high_is_no_obstacle_and_says_nothing_behind_it() {
    let mut map = room();
    map.landmarks.clear();
    // A table's edge that hides nothing, a lamp, and a kerb: the camera is 0.5 m above the floor.
    for (id, (x, height)) in [(2.0, 0.8), (3.0, 2.4), (4.0, 0.05)].into_iter().enumerate() {
        let position = Vector3::new(x + 0.05, 0.05 + id as f64, FLOOR + height);
        let landmark = landmark(id as u64, position, &map, 1);
        map.landmarks.push(landmark);
    }
    let grid = OccupancyGrid::of_map(&map, &settings()).unwrap();
    assert_eq!(grid.at(2.05, 0.05), Some(Cell::Occupied));
    assert_eq!(grid.count(Cell::Occupied), 1);
    // The line to the lamp leaves the heights at 2.0 of 2.4 m, that to the kerb at 0.1 of 0.05 m: the grid ends there.
    let camera = Vector3::new(-0.5, -0.5, 0.0);
    let along =
        |x: f64, y: f64, part: f64| (camera.x + (x - camera.x) * part, camera.y + (y - camera.y) * part);
    let leaves = [(3.05, 1.05, 1.5 / 1.9), (4.05, 2.05, 0.4 / 0.45)];
    for (x, y, part) in leaves {
        let (inside, outside) = (along(x, y, part - 0.03), along(x, y, part + 0.05));
        assert_eq!(grid.at(inside.0, inside.1), Some(Cell::Free));
        assert_ne!(grid.at(outside.0, outside.1), Some(Cell::Free));
    }
}

#[test]
fn what_is_far_away_is_no_obstacle_but_the_way_to_it_is_free() {
    let mut map = room();
    map.landmarks.clear();
    let far = landmark(1, Vector3::new(20.0, -0.45, FLOOR + CAMERA), &map, 1);
    map.landmarks.push(far);
    let grid = OccupancyGrid::of_map(&map, &settings()).unwrap();
    assert_eq!((grid.count(Cell::Occupied), grid.at(9.3, -0.5)), (0, Some(Cell::Free)));
    assert_eq!(grid.at(9.7, -0.5), None);
}

#[test]
fn single_landmarks_are_left_out_where_more_are_wanted() {
    let mut map = room();
    let single = landmark(30_000, Vector3::new(1.05, 1.05, FLOOR + 1.0), &map, 4);
    map.landmarks.push(single);
    let at = |min_landmarks| {
        OccupancyGrid::of_map(&map, &GridSettings { min_landmarks, ..settings() }).unwrap().at(1.05, 1.05)
    };
    assert_eq!((at(1), at(2)), (Some(Cell::Occupied), Some(Cell::Free)));
}

#[test]
fn what_cannot_be_a_grid_is_named() {
    let map = room();
    let refused = |settings: GridSettings| OccupancyGrid::of_map(&map, &settings).unwrap_err();
    for resolution_m in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(matches!(refused(GridSettings { resolution_m, ..settings() }), GridError::Setting { .. }));
    }
    assert!(matches!(
        refused(GridSettings { heights_m: [2.0, 0.1], ..settings() }),
        GridError::Setting { .. }
    ));
    assert!(matches!(
        refused(GridSettings { floor: Floor::At(40.0), ..settings() }),
        GridError::Empty { .. }
    ));
    assert!(matches!(
        refused(GridSettings { resolution_m: 0.001, ..settings() }),
        GridError::TooLarge { .. }
    ));
    let mut tilted = room();
    tilted.info.gravity_in_global = Some(Vector3::new(0.0, 0.2, -1.0).normalize());
    let error = OccupancyGrid::of_map(&tilted, &settings()).unwrap_err();
    assert!(matches!(error, GridError::NotLevel { tilt_deg } if (tilt_deg - 11.3).abs() < 0.1), "{error}");
    tilted.info.gravity_in_global = Some(-Vector3::z());
    assert!(OccupancyGrid::of_map(&tilted, &settings()).is_ok());
}

/// What Nav2's map server makes of the files, mode `trinary`.
fn read_by_map_server(folder: &std::path::Path) -> OccupancyGrid {
    let yaml = std::fs::read_to_string(folder.join(NAV2_YAML)).unwrap();
    let value = |key: &str| {
        let line = yaml.lines().find_map(|line| line.strip_prefix(&format!("{key}: "))).unwrap();
        line.to_owned()
    };
    let number = |text: &str| text.trim().parse::<f64>().unwrap();
    let origin: Vec<f64> = value("origin").trim_matches(['[', ']']).split(',').map(number).collect();
    let (occupied, free) = (number(&value("occupied_thresh")), number(&value("free_thresh")));
    assert_eq!((value("mode").as_str(), value("negate").as_str(), origin[2]), ("trinary", "0", 0.0));
    let image = std::fs::read(folder.join(value("image"))).unwrap();
    let parts: Vec<&[u8]> = image.splitn(4, |byte| *byte == b'\n').collect();
    let [magic, size, most, pixels] = parts[..] else { panic!("three lines, and pixels") };
    assert_eq!((magic, most), (&b"P5"[..], &b"255"[..]));
    let size = String::from_utf8_lossy(size);
    let size: Vec<usize> = size.split(' ').map(|side| side.parse().unwrap()).collect();
    let cell = |pixel: &u8| match (255.0 - f64::from(*pixel)) / 255.0 {
        probability if probability > occupied => Cell::Occupied,
        probability if probability < free => Cell::Free,
        _ => Cell::Unknown,
    };
    OccupancyGrid {
        resolution_m: number(&value("resolution")),
        origin_m: [origin[0], origin[1]],
        width: size[0],
        height: size[1],
        cells: pixels.chunks(size[0]).rev().flatten().map(cell).collect(),
    }
}

#[test]
fn the_map_server_of_nav2_reads_the_same_grid() {
    let mut map = room();
    // Open on one side, so that there is something unknown.
    map.landmarks.retain(|landmark| landmark.id % 6 != 2);
    let grid = OccupancyGrid::of_map(&map, &settings()).unwrap();
    assert!([Cell::Unknown, Cell::Free, Cell::Occupied].iter().all(|kind| grid.count(*kind) > 0));
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path().join("nav2");
    grid.write_nav2(&folder).unwrap();
    assert_eq!(read_by_map_server(&folder), grid);
    grid.write_nav2(&folder).unwrap();
}
