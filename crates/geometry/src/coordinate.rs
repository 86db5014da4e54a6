//! The bound on coordinates.

/// Largest absolute value of a coordinate (m) of a position that comes from outside: more than the radius of the Earth,
/// 6.4e6 m, so that maps in geocentric frames are possible. There an `f64` still resolves 2e-9 m; a squared distance of
/// positions beyond 1e150 m is infinite.
pub const MAX_COORDINATE_M: f64 = 1e7;

/// Whether a number may be a coordinate of a position (m): finite, and within [`MAX_COORDINATE_M`]. Text maps, stored maps and
/// messages are checked by this function.
///
/// ```
/// use geometry::is_coordinate;
/// assert!(is_coordinate(6_378_137.0) && is_coordinate(-1e7));
/// assert!(!is_coordinate(1e300) && !is_coordinate(1.1e7) && !is_coordinate(f64::NAN));
/// ```
pub fn is_coordinate(value: f64) -> bool {
    value.abs() <= MAX_COORDINATE_M
}
