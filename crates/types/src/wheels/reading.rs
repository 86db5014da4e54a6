//! Readings of the wheels of a base.

use super::BaseKind;

/// Most numbers of a reading.
pub const MAX_WHEELS: usize = 4;

/// What the wheels of a base do at one time.
///
/// | base | values |
/// |---|---|
/// | [differential](BaseKind::Differential) | left, right |
/// | [Ackermann](BaseKind::Ackermann) | driven axle, steering angle (rad, to the left) |
/// | [mecanum](BaseKind::Mecanum) | front left, front right, rear left, rear right |
/// | omni, [three](BaseKind::Omni3) or [four](BaseKind::Omni4) wheels | counterclockwise, from the one on the x axis |
///
/// Speeds are angular, in rad/s, forward (of an omni wheel: counterclockwise about the base) is positive.
///
/// ```
/// use types::WheelReading;
/// let reading = WheelReading::new(0, [1.5, 2.5]);
/// assert_eq!(reading.values, [1.5, 2.5, 0.0, 0.0]);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WheelReading {
    /// Time, nanoseconds.
    pub stamp_ns: i64,
    /// As the base has them; further ones are zero.
    pub values: [f64; MAX_WHEELS],
}

impl WheelReading {
    /// A reading of a base with `COUNT` numbers, at most [`MAX_WHEELS`]; further ones are left out.
    pub fn new<const COUNT: usize>(stamp_ns: i64, values: [f64; COUNT]) -> Self {
        Self::of_slice(stamp_ns, &values)
    }

    /// The same of a list.
    pub fn of_slice(stamp_ns: i64, values: &[f64]) -> Self {
        let at = |index: usize| values.get(index).copied().unwrap_or(0.0);
        Self { stamp_ns, values: std::array::from_fn(at) }
    }

    /// The speeds of wheels of 1 m radius under a base that moves: of a differential drive with the wheels 1 m apart, or of mecanum
    /// wheels with a reach of 1 m.
    ///
    /// # Arguments
    /// * `kind`: of a base that does not move sideways a differential drive, of another one mecanum wheels.
    /// * `velocity`: ahead and to the left, m/s.
    /// * `turn`: about the z axis, rad/s.
    pub fn of_base_velocity(kind: BaseKind, stamp_ns: i64, velocity: [f64; 2], turn: f64) -> Self {
        let [ahead, left] = velocity;
        if kind.moves_sideways() {
            let values = [ahead - left - turn, ahead + left + turn, ahead + left - turn, ahead - left + turn];
            return Self::new(stamp_ns, values);
        }
        Self::new(stamp_ns, [ahead - 0.5 * turn, ahead + 0.5 * turn])
    }

    /// Whether all of it is finite.
    pub fn is_finite(&self) -> bool {
        self.values.iter().all(|value| value.is_finite())
    }

    /// Linear interpolation between two readings.
    pub fn between(a: &Self, b: &Self, stamp_ns: i64) -> Self {
        let span = (b.stamp_ns - a.stamp_ns) as f64;
        let weight = if span > 0.0 { (stamp_ns - a.stamp_ns) as f64 / span } else { 0.0 };
        let lerp = |index: usize| a.values[index] + (b.values[index] - a.values[index]) * weight;
        Self { stamp_ns, values: std::array::from_fn(lerp) }
    }
}
