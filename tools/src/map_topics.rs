//! A stored map as messages of ROS 2.

use map::MapContents;
use map_io::occupancy::OccupancyGrid;
use ros_messages::builtin_interfaces::Time;
use ros_messages::geometry_msgs::Pose;
use ros_messages::nav_msgs::{self, MapMetaData};
use ros_messages::sensor_msgs::PointCloud2;
use ros_messages::std_msgs::Header;
use std::time::SystemTime;

/// Most points of a cloud: sessions drop messages above 16 MiB.
pub const MAX_POINTS: usize = 1_000_000;

/// The landmarks of a map in its frame, metres; of more than [`MAX_POINTS`] every second, third, and so on.
pub fn points_message(map: &MapContents, frame: &str) -> PointCloud2 {
    let step = map.landmarks.len().div_ceil(MAX_POINTS).max(1);
    let positions = map.landmarks_in_global().step_by(step);
    let points: Vec<[f32; 3]> =
        positions.map(|(_, position)| position.map(|value| value as f32).into()).collect();
    PointCloud2::of_points(header(frame), &points)
}

/// A grid with its place in the frame of the map.
pub fn grid_message(grid: &OccupancyGrid, frame: &str) -> nav_msgs::OccupancyGrid {
    let header = header(frame);
    let [x, y] = grid.origin_m;
    let origin = Pose { position: [x, y, 0.0].into(), ..Pose::default() };
    let info = MapMetaData {
        map_load_time: header.stamp,
        resolution: grid.resolution_m as f32,
        width: grid.width as u32,
        height: grid.height as u32,
        origin,
    };
    nav_msgs::OccupancyGrid { header, info, data: grid.cells.iter().map(|cell| cell.percent()).collect() }
}

fn header(frame: &str) -> Header {
    let since_epoch = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    let stamp = Time::from_nanoseconds(since_epoch.as_nanos() as i64).unwrap_or_default();
    Header { stamp, frame_id: frame.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use map_io::occupancy::Cell;
    use testing::{Place, PlaceOptions};

    #[test]
    fn points_are_the_landmarks_in_the_frame_of_the_map() {
        let map = Place::new(&PlaceOptions::default()).map;
        let cloud = points_message(&map, "hall");
        assert_eq!((cloud.width as usize, cloud.header.frame_id.as_str()), (map.landmarks.len(), "hall"));
        let landmark = &map.landmarks[7];
        let anchor = map.keyframes.iter().find(|keyframe| keyframe.id == landmark.anchor).unwrap();
        let expected = anchor.global_from_keyframe.pose.transform(&landmark.position_in_anchor);
        for axis in 0..3 {
            let at = 12 * 7 + 4 * axis;
            let value = f32::from_le_bytes(cloud.data[at..at + 4].try_into().unwrap());
            assert!((f64::from(value) - expected[axis]).abs() < 1e-4);
        }
    }

    #[test]
    fn a_grid_keeps_its_cells_and_its_place() {
        let cells = vec![Cell::Occupied, Cell::Free, Cell::Unknown, Cell::Free, Cell::Free, Cell::Occupied];
        let grid = OccupancyGrid { resolution_m: 0.5, origin_m: [-3.0, 2.5], width: 3, height: 2, cells };
        let message = grid_message(&grid, "map");
        assert_eq!(message.data, [100, 0, -1, 0, 0, 100]);
        assert_eq!((message.info.width, message.info.height, message.info.resolution), (3, 2, 0.5));
        assert_eq!(message.info.origin.position, [-3.0, 2.5, 0.0].into());
    }
}
