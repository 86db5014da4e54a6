//! The columns of a table of poses, as its header names them or as its layout has them.

use std::fmt;

/// Where the quaternion's scalar part stands among its four numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum QuaternionOrder {
    /// `w x y z`, as in EuRoC's tables.
    WFirst,
    /// `x y z w`, as in TUM files and ROS messages.
    WLast,
}

impl fmt::Display for QuaternionOrder {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::WFirst => "q_w first",
            Self::WLast => "q_w last",
        })
    }
}

/// The columns of a pose in a row, counted from 0.
///
/// ```
/// use sensors::{PoseColumns, QuaternionOrder};
///
/// let okvis = "timestamp, p_WS_W_x, p_WS_W_y, p_WS_W_z, q_WS_x, q_WS_y, q_WS_z, q_WS_w, v_WS_W_x";
/// assert_eq!(PoseColumns::of_header(okvis), Some(PoseColumns::in_order(QuaternionOrder::WLast)));
/// assert_eq!(PoseColumns::of_header("#timestamp [ns],w_x,w_y,w_z,a_x,a_y,a_z"), None);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PoseColumns {
    /// Of the time.
    pub stamp: usize,
    /// Of the position's x, y, z.
    pub position: [usize; 3],
    /// Of the quaternion's w, x, y, z.
    pub quaternion: [usize; 4],
}

impl PoseColumns {
    /// Time, position, quaternion, from the first column on.
    pub const fn in_order(order: QuaternionOrder) -> Self {
        let quaternion = match order {
            QuaternionOrder::WFirst => [4, 5, 6, 7],
            QuaternionOrder::WLast => [7, 4, 5, 6],
        };
        Self { stamp: 0, position: [1, 2, 3], quaternion }
    }

    /// The columns that a header names; `None` where it does not name each of the eight once.
    pub fn of_header(header: &str) -> Option<Self> {
        let mut stamp = None;
        let mut position = [None; 3];
        let mut quaternion = [None; 4];
        for (column, name) in names(header).into_iter().enumerate() {
            let place = match Meaning::of(&name) {
                Meaning::Time if stamp.is_none() => &mut stamp,
                Meaning::Position(axis) => &mut position[axis],
                Meaning::Quaternion(axis) => &mut quaternion[axis],
                Meaning::Time | Meaning::Other => continue,
            };
            if place.replace(column).is_some() {
                return None;
            }
        }
        let [x, y, z] = position;
        let [q_w, q_x, q_y, q_z] = quaternion;
        Some(Self { stamp: stamp?, position: [x?, y?, z?], quaternion: [q_w?, q_x?, q_y?, q_z?] })
    }

    /// The order of the quaternion's columns.
    pub fn quaternion_order(&self) -> QuaternionOrder {
        let [q_w, q_x, ..] = self.quaternion;
        if q_w < q_x { QuaternionOrder::WFirst } else { QuaternionOrder::WLast }
    }

    /// Number of columns that a row needs.
    pub fn width(&self) -> usize {
        let columns = [self.stamp].into_iter().chain(self.position).chain(self.quaternion);
        columns.max().unwrap_or(0) + 1
    }
}

/// The names of the columns, in small letters, without comment signs and units.
fn names(header: &str) -> Vec<String> {
    let header = header.trim().trim_start_matches(['\u{feff}', '#', '%', ' ', '\t']);
    let cells: Vec<&str> = if header.contains(',') {
        header.split(',').collect()
    } else {
        let is_unit = |cell: &&str| cell.starts_with(['[', '(']);
        header.split_ascii_whitespace().filter(|cell| !is_unit(cell)).collect()
    };
    let name = |cell: &str| {
        let end = cell.find(['[', '(']).unwrap_or(cell.len());
        cell[..end].trim().trim_matches('"').to_ascii_lowercase()
    };
    cells.into_iter().map(name).collect()
}

/// What a column is.
enum Meaning {
    Time,
    /// Component 0, 1 or 2.
    Position(usize),
    /// Component w, x, y or z.
    Quaternion(usize),
    Other,
}

impl Meaning {
    fn of(name: &str) -> Self {
        let last = name.rsplit(['.', '/']).next().unwrap_or(name);
        if name == "t"
            || ["time", "stamp"].iter().any(|word| last.starts_with(word))
            || last.ends_with("stamp")
        {
            return Self::Time;
        }
        let Some((end, axis)) = name.char_indices().next_back() else { return Self::Other };
        let stem = name[..end].trim_end_matches(['_', '.', '-', '/', ' ']);
        let of_quaternion =
            stem.starts_with('q') || ["quat", "orient", "rotation"].iter().any(|word| stem.contains(word));
        if of_quaternion {
            return "wxyz".find(axis).map_or(Self::Other, Self::Quaternion);
        }
        let first = stem.split('_').next().unwrap_or_default();
        let of_position =
            matches!(first, "" | "p" | "t") || ["pos", "trans"].iter().any(|word| stem.contains(word));
        match "xyz".find(axis) {
            Some(axis) if of_position => Self::Position(axis),
            _ => Self::Other,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headers_of_other_programs_are_understood() {
        let first = Some(PoseColumns::in_order(QuaternionOrder::WFirst));
        let last = Some(PoseColumns::in_order(QuaternionOrder::WLast));
        for (header, expected) in [
            (
                "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []",
                first,
            ),
            (
                "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], v_RS_R_x [m s^-1], b_w_RS_S_x",
                first,
            ),
            ("#timestamp,x,y,z,qw,qx,qy,qz,vx,vy,vz,bgx,bgy,bgz,bax,bay,baz", first),
            (
                "timestamp, p_WS_W_x, p_WS_W_y, p_WS_W_z, q_WS_x, q_WS_y, q_WS_z, q_WS_w, v_WS_W_x, b_g_x, b_a_z",
                last,
            ),
            ("# timestamp(s) tx ty tz qx qy qz qw Pr11 Pr12 Pt33", last),
            ("# timestamp [s] x y z [m] qx qy qz qw", last),
            ("time pos_x pos_y pos_z quat_x quat_y quat_z quat_w\r", last),
            ("# timestamp tx ty tz qx qy qz", None),
            ("t,x,y,z,yaw,pitch,roll", None),
            ("timestamp,x,y,z,x,qw,qx,qy,qz", None),
            ("", None),
        ] {
            assert_eq!(PoseColumns::of_header(header), expected, "{header}");
        }
        let of_rostopic = "%time,field.header.seq,field.header.stamp,field.header.frame_id,field.pose.position.x,\
            field.pose.position.y,field.pose.position.z,field.pose.orientation.x,field.pose.orientation.y,\
            field.pose.orientation.z,field.pose.orientation.w";
        let columns = PoseColumns::of_header(of_rostopic).unwrap();
        assert_eq!((columns.stamp, columns.position, columns.quaternion), (0, [4, 5, 6], [10, 7, 8, 9]));
        assert_eq!((columns.width(), columns.quaternion_order()), (11, QuaternionOrder::WLast));
    }
}
