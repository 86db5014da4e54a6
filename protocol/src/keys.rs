//! Key expressions, below the session's namespace (one namespace per fleet), and the names in them.
//!
//! | key | kind |
//! |---|---|
//! | [`map_match`], [`map_localize`], [`map_info`], [`map_keyframe`] | queryable |
//! | [`map_sessions`] | queryable of a server that takes sessions |
//! | [`cell_match`], [`cell_localize`], [`cell_keyframe`] | queryable, for servers of other cells of the map |
//! | [`map_changes`] | publisher |
//! | [`robot_pose`], [`robot_odometry`], [`robot_odometry_predicted`], [`robot_status`] | publisher |
//! | [`robot_imu`], [`robot_camera`], [`robot_tracks`], [`robot_wheels`], [`robot_gnss`] | subscriber |
//! | [`robot`], [`map_server`], [`map_member`], [`cell_holder`], [`version_holder`] | liveliness |
//!
//! ```
//! assert_eq!(protocol::keys::map_match("cellar")?, "map/cellar/match");
//! assert!(protocol::keys::map_match("cellar/*").is_err());
//! # Ok::<(), protocol::keys::NameError>(())
//! ```

use crate::limits::KeyframeId;
use thiserror::Error;

/// Parameter of a query's selector that names the client: the server is fair to clients. Anybody can state any name.
pub const CLIENT_PARAMETER: &str = "client";

/// Parameter of a query's selector: so many milliseconds its client waits for a first reply. A query that has waited longer in
/// the queue of a server is not answered any more: nobody would read the answer, and the next query would wait for it.
pub const PATIENCE_PARAMETER: &str = "patience_ms";

/// Longest name, bytes.
pub const MAX_NAME_BYTES: usize = 64;

/// A name that cannot be one chunk of a key expression.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum NameError {
    /// The name is the empty string.
    #[error("a name of a map, robot or server cannot be empty")]
    Empty,
    /// The name exceeds [`MAX_NAME_BYTES`].
    #[error("a name of {length} bytes is too long: at most {MAX_NAME_BYTES}")]
    TooLong {
        /// Its bytes.
        length: usize,
    },
    /// The name holds a character with a meaning in key expressions, or an invisible one.
    #[error("the name {name:?} holds {character:?}; use letters, digits, '-', '_' and '.'")]
    Character {
        /// The name.
        name: String,
        /// The first such character.
        character: char,
    },
}

/// Checks that a name can be one chunk of a key: not empty, not too long, and without `/ * $ # ? @`, white space and
/// control characters (a leading `@` would hide the key from wildcards).
///
/// # Errors
/// [`NameError`] says which of these.
pub fn validate_name(name: &str) -> Result<(), NameError> {
    if name.is_empty() {
        return Err(NameError::Empty);
    }
    if name.len() > MAX_NAME_BYTES {
        return Err(NameError::TooLong { length: name.len() });
    }
    let forbidden = |&character: &char| {
        matches!(character, '/' | '*' | '$' | '#' | '?' | '@')
            || character.is_whitespace()
            || character.is_control()
    };
    match name.chars().find(forbidden) {
        Some(character) => Err(NameError::Character { name: name.to_owned(), character }),
        None => Ok(()),
    }
}

fn key(prefix: &str, name: &str, suffix: &str) -> Result<String, NameError> {
    validate_name(name)?;
    Ok(format!("{prefix}/{name}{suffix}"))
}

/// `map/{map}/match`: [`crate::MatchRequest`] in, [`crate::MatchReply`]s out.
///
/// # Errors
/// [`NameError`] if the name cannot be part of a key.
pub fn map_match(map: &str) -> Result<String, NameError> {
    key("map", map, "/match")
}

/// `map/{map}/localize`: [`crate::LocalizeRequest`] in, [`crate::LocalizeReply`] out.
///
/// # Errors
/// [`NameError`] if the name cannot be part of a key.
pub fn map_localize(map: &str) -> Result<String, NameError> {
    key("map", map, "/localize")
}

/// `map/{map}/info`: nothing in, [`crate::MapInfoReply`] out.
///
/// # Errors
/// [`NameError`] if the name cannot be part of a key.
pub fn map_info(map: &str) -> Result<String, NameError> {
    key("map", map, "/info")
}

/// `map/{map}/keyframes/{id}`: nothing in, [`crate::KeyframeReply`] out.
///
/// # Errors
/// [`NameError`] if the name cannot be part of a key.
pub fn map_keyframe(map: &str, id: KeyframeId) -> Result<String, NameError> {
    key("map", map, &format!("/keyframes/{id}"))
}

/// `map/{map}/keyframes/*`: declared by the server.
///
/// # Errors
/// [`NameError`] if the name cannot be part of a key.
pub fn map_keyframes(map: &str) -> Result<String, NameError> {
    key("map", map, "/keyframes/*")
}

/// `map/{map}/sessions/{robot}`: [`crate::SessionPart`] in, [`crate::SessionPartReply`] out; `*` for all robots.
///
/// # Errors
/// [`NameError`] if a name cannot be part of a key.
pub fn map_sessions(map: &str, robot: Option<&str>) -> Result<String, NameError> {
    key("map", map, &format!("/sessions/{}", name_or_all(robot)?))
}

/// `map/{map}/cell/{cell}/match`: [`crate::MatchRequest`] in, [`crate::CellMatchReply`] out.
///
/// # Errors
/// [`NameError`] if the name cannot be part of a key.
pub fn cell_match(map: &str, cell: u32) -> Result<String, NameError> {
    key("map", map, &format!("/cell/{cell}/match"))
}

/// `map/{map}/cell/{cell}/localize`: [`crate::LocalizeRequest`] in, [`crate::CellLocalizeReply`] out.
///
/// # Errors
/// [`NameError`] if the name cannot be part of a key.
pub fn cell_localize(map: &str, cell: u32) -> Result<String, NameError> {
    key("map", map, &format!("/cell/{cell}/localize"))
}

/// `map/{map}/cell/{cell}/keyframes/{id}`: nothing in, [`crate::KeyframeReply`] out; without an id the cell's queryable.
///
/// # Errors
/// [`NameError`] if the name cannot be part of a key.
pub fn cell_keyframe(map: &str, cell: u32, id: Option<KeyframeId>) -> Result<String, NameError> {
    let last = id.map_or_else(|| "*".to_owned(), |id| id.to_string());
    key("map", map, &format!("/cell/{cell}/keyframes/{last}"))
}

/// `map/{map}/server/{server}`: liveliness of a server that serves some cells of a map; `*` for all servers.
///
/// # Errors
/// [`NameError`] if a name cannot be part of a key.
pub fn map_member(map: &str, server: Option<&str>) -> Result<String, NameError> {
    key("map", map, &format!("/server/{}", name_or_all(server)?))
}

/// `map/{map}/cell/{cell}/server/{server}`: liveliness of a cell at a server; `*` for all.
///
/// # Errors
/// [`NameError`] if a name cannot be part of a key.
pub fn cell_holder(map: &str, cell: Option<u32>, server: Option<&str>) -> Result<String, NameError> {
    let cell = cell.map_or_else(|| "*".to_owned(), |cell| cell.to_string());
    key("map", map, &format!("/cell/{cell}/server/{}", name_or_all(server)?))
}

/// `map/{map}/version/{version}/server/{server}`: liveliness of a version that a server has loaded; `*` for all servers.
///
/// # Errors
/// [`NameError`] if a name cannot be part of a key.
pub fn version_holder(map: &str, version: u64, server: Option<&str>) -> Result<String, NameError> {
    key("map", map, &format!("/version/{version}/server/{}", name_or_all(server)?))
}

fn name_or_all(name: Option<&str>) -> Result<&str, NameError> {
    let Some(name) = name else { return Ok("*") };
    validate_name(name)?;
    Ok(name)
}

/// The id at the end of a key of [`map_keyframe`]; `None` for anything else.
///
/// ```
/// assert_eq!(protocol::keys::keyframe_of("map/cellar/keyframes/17"), Some(17));
/// assert_eq!(protocol::keys::keyframe_of("map/cellar/keyframes/*"), None);
/// ```
pub fn keyframe_of(key: &str) -> Option<KeyframeId> {
    let (parent, id) = key.rsplit_once('/')?;
    let digits_only = id.bytes().all(|byte| byte.is_ascii_digit());
    if parent.ends_with("/keyframes") && digits_only { id.parse().ok() } else { None }
}

/// The name of the robot in a key of a robot; `None` where there is none that is valid.
///
/// ```
/// assert_eq!(protocol::keys::robot_of("robot/ada/pose"), Some("ada"));
/// assert_eq!(protocol::keys::robot_of("robot"), None);
/// ```
pub fn robot_of(key: &str) -> Option<&str> {
    key.split('/').nth(1).filter(|name| validate_name(name).is_ok())
}

/// `map/{map}/changes`: [`crate::MapChangeNotice`].
///
/// # Errors
/// [`NameError`] if the name cannot be part of a key.
pub fn map_changes(map: &str) -> Result<String, NameError> {
    key("map", map, "/changes")
}

/// `robot/{robot}/pose`: [`crate::RobotPose`].
///
/// # Errors
/// [`NameError`] if the name cannot be part of a key.
pub fn robot_pose(robot: &str) -> Result<String, NameError> {
    key("robot", robot, "/pose")
}

/// `robot/{robot}/odometry`: [`crate::RobotOdometry`].
///
/// # Errors
/// [`NameError`] if the name cannot be part of a key.
pub fn robot_odometry(robot: &str) -> Result<String, NameError> {
    key("robot", robot, "/odometry")
}

/// `robot/{robot}/odometry_predicted`: [`crate::RobotOdometry`] at the rate of the IMU.
///
/// # Errors
/// [`NameError`] if the name cannot be part of a key.
pub fn robot_odometry_predicted(robot: &str) -> Result<String, NameError> {
    key("robot", robot, "/odometry_predicted")
}

/// `robot/{robot}/status`: [`crate::RobotStatus`].
///
/// # Errors
/// [`NameError`] if the name cannot be part of a key.
pub fn robot_status(robot: &str) -> Result<String, NameError> {
    key("robot", robot, "/status")
}

/// `robot/{robot}/sensors/imu`: [`crate::sensors::ImuMessage`]s.
///
/// # Errors
/// [`NameError`] if the name cannot be part of a key.
pub fn robot_imu(robot: &str) -> Result<String, NameError> {
    key("robot", robot, "/sensors/imu")
}

/// `robot/{robot}/sensors/cam{index}`: images with a [`crate::sensors::ImageHeader`].
///
/// # Errors
/// [`NameError`] if the name cannot be part of a key.
pub fn robot_camera(robot: &str, index: usize) -> Result<String, NameError> {
    key("robot", robot, &format!("/sensors/cam{index}"))
}

/// `robot/{robot}/sensors/tracks`: [`crate::sensors::TracksMessage`]s.
///
/// # Errors
/// [`NameError`] if the name cannot be part of a key.
pub fn robot_tracks(robot: &str) -> Result<String, NameError> {
    key("robot", robot, "/sensors/tracks")
}

/// `robot/{robot}/sensors/wheels`: [`crate::sensors::WheelMessage`]s.
///
/// # Errors
/// [`NameError`] if the name cannot be part of a key.
pub fn robot_wheels(robot: &str) -> Result<String, NameError> {
    key("robot", robot, "/sensors/wheels")
}

/// `robot/{robot}/sensors/gnss`: [`crate::sensors::GnssMessage`]s.
///
/// # Errors
/// [`NameError`] if the name cannot be part of a key.
pub fn robot_gnss(robot: &str) -> Result<String, NameError> {
    key("robot", robot, "/sensors/gnss")
}

/// `robot/{robot}`: liveliness of a robot.
///
/// # Errors
/// [`NameError`] if the name cannot be part of a key.
pub fn robot(name: &str) -> Result<String, NameError> {
    key("robot", name, "")
}

/// `map_server/{server}`: liveliness of a map server.
///
/// # Errors
/// [`NameError`] if the name cannot be part of a key.
pub fn map_server(server: &str) -> Result<String, NameError> {
    key("map_server", server, "")
}
