//! Readings of the wheels of a differential drive.

/// Angular speeds of the two wheels at one time. Forward is positive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WheelReading {
    /// Time, nanoseconds.
    pub stamp_ns: i64,
    /// Left wheel, rad/s.
    pub left: f64,
    /// Right wheel, rad/s.
    pub right: f64,
}

impl WheelReading {
    /// The speeds of wheels of 1 m radius that are 1 m apart, under a base that moves.
    ///
    /// # Arguments
    /// * `ahead`: m/s.
    /// * `turn`: about the z axis, rad/s.
    pub fn of_base_velocity(stamp_ns: i64, ahead: f64, turn: f64) -> Self {
        Self { stamp_ns, left: ahead - 0.5 * turn, right: ahead + 0.5 * turn }
    }

    /// Whether both speeds are finite.
    pub fn is_finite(&self) -> bool {
        self.left.is_finite() && self.right.is_finite()
    }

    /// Linear interpolation between two readings.
    pub fn between(a: &Self, b: &Self, stamp_ns: i64) -> Self {
        let span = (b.stamp_ns - a.stamp_ns) as f64;
        let weight = if span > 0.0 { (stamp_ns - a.stamp_ns) as f64 / span } else { 0.0 };
        let lerp = |a: f64, b: f64| a + (b - a) * weight;
        Self { stamp_ns, left: lerp(a.left, b.left), right: lerp(a.right, b.right) }
    }
}
