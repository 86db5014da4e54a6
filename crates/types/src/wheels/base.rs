//! Bases on wheels and their geometry.

use serde::{Deserialize, Serialize};
use std::fmt;

/// Most lengths and angles of a base.
pub const MAX_WHEEL_PARAMETERS: usize = 6;

/// A kind of base.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum BaseKind {
    /// Two driven wheels on one axis.
    #[default]
    Differential,
    /// A car: a driven axle that does not steer, and a steered one.
    Ackermann,
    /// Four wheels with rollers at 45 degrees; seen from above, the rollers form an X.
    Mecanum,
    /// Three omni wheels, 120 degrees apart, that roll about the base.
    Omni3,
    /// Four omni wheels, 90 degrees apart, that roll about the base.
    Omni4,
}

impl BaseKind {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::Differential, Self::Ackermann, Self::Mecanum, Self::Omni3, Self::Omni4];

    /// Its name in files and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Differential => "differential",
            Self::Ackermann => "ackermann",
            Self::Mecanum => "mecanum",
            Self::Omni3 => "omni3",
            Self::Omni4 => "omni4",
        }
    }

    /// The kind of a name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// Number of wheels whose speed is measured.
    pub fn wheels(self) -> usize {
        match self {
            Self::Ackermann => 1,
            Self::Differential => 2,
            Self::Omni3 => 3,
            Self::Mecanum | Self::Omni4 => 4,
        }
    }

    /// Names of the numbers of a reading.
    pub fn columns(self) -> &'static [&'static str] {
        match self {
            Self::Differential => &["left", "right"],
            Self::Ackermann => &["drive", "steering"],
            Self::Mecanum => &["front_left", "front_right", "rear_left", "rear_right"],
            Self::Omni3 => &["wheel_0", "wheel_1", "wheel_2"],
            Self::Omni4 => &["wheel_0", "wheel_1", "wheel_2", "wheel_3"],
        }
    }

    /// Whether it can move sideways.
    pub fn moves_sideways(self) -> bool {
        matches!(self, Self::Mecanum | Self::Omni3 | Self::Omni4)
    }
}

impl fmt::Display for BaseKind {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.name())
    }
}

/// A base and its geometry, metres. Its frame has x forward, y left, z up, and its origin on the floor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
#[non_exhaustive]
pub enum WheelBase {
    /// Two driven wheels on one axis. The origin is between them.
    Differential {
        /// Radius of the left wheel.
        radius_left_m: f64,
        /// Radius of the right wheel.
        radius_right_m: f64,
        /// Distance between the wheels.
        track_m: f64,
    },
    /// A car. The origin is at the middle of the axle that does not steer, whose mean speed is measured.
    Ackermann {
        /// Radius of its wheels.
        radius_m: f64,
        /// Distance between the axles.
        wheelbase_m: f64,
        /// Added to the measured steering angle, rad.
        #[serde(default)]
        steering_offset_rad: f64,
    },
    /// Four mecanum wheels. The origin is in their middle.
    Mecanum {
        /// Radii: front left, front right, rear left, rear right.
        radii_m: [f64; 4],
        /// Distance of a wheel's centre from the origin along x, plus that along y: half of wheelbase and track together.
        reach_m: f64,
        /// Way to the side, of that which the wheels turn: rollers slip by some per cent.
        #[serde(default = "all_of_the_way")]
        sideways_scale: f64,
    },
    /// Three omni wheels, 120 degrees apart. The origin is in their middle, the x axis goes through the first one.
    Omni3 {
        /// Radii, counterclockwise from the first one.
        radii_m: [f64; 3],
        /// Distance of the wheels from the origin.
        reach_m: f64,
        /// Way to the side, of that which the wheels turn.
        #[serde(default = "all_of_the_way")]
        sideways_scale: f64,
    },
    /// Four omni wheels, 90 degrees apart. The origin is in their middle, the x axis goes through the first one. The first and the
    /// third one make the way to the side: what is lost of it is in their radii.
    Omni4 {
        /// Radii, counterclockwise from the first one.
        radii_m: [f64; 4],
        /// Distance of the wheels from the origin.
        reach_m: f64,
    },
}

fn all_of_the_way() -> f64 {
    1.0
}

impl WheelBase {
    /// A base whose wheels have one radius.
    ///
    /// # Arguments
    /// * `size_m`: track, wheelbase or reach.
    ///
    /// ```
    /// use types::{BaseKind, WheelBase};
    /// let car = WheelBase::new(BaseKind::Ackermann, 0.3, 2.6);
    /// assert_eq!(car.parameters(), [0.3, 2.6, 0.0]);
    /// assert_eq!(car.parameter_names(), ["radius_m", "wheelbase_m", "steering_offset_rad"]);
    /// ```
    pub fn new(kind: BaseKind, radius_m: f64, size_m: f64) -> Self {
        match kind {
            BaseKind::Differential => {
                Self::Differential { radius_left_m: radius_m, radius_right_m: radius_m, track_m: size_m }
            }
            BaseKind::Ackermann => {
                Self::Ackermann { radius_m, wheelbase_m: size_m, steering_offset_rad: 0.0 }
            }
            BaseKind::Mecanum => {
                Self::Mecanum { radii_m: [radius_m; 4], reach_m: size_m, sideways_scale: 1.0 }
            }
            BaseKind::Omni3 => Self::Omni3 { radii_m: [radius_m; 3], reach_m: size_m, sideways_scale: 1.0 },
            BaseKind::Omni4 => Self::Omni4 { radii_m: [radius_m; 4], reach_m: size_m },
        }
    }

    /// What it is.
    pub fn kind(&self) -> BaseKind {
        match self {
            Self::Differential { .. } => BaseKind::Differential,
            Self::Ackermann { .. } => BaseKind::Ackermann,
            Self::Mecanum { .. } => BaseKind::Mecanum,
            Self::Omni3 { .. } => BaseKind::Omni3,
            Self::Omni4 { .. } => BaseKind::Omni4,
        }
    }

    /// Names of [`Self::parameters`], with their units.
    pub fn parameter_names(&self) -> &'static [&'static str] {
        match self {
            Self::Differential { .. } => &["radius_left_m", "radius_right_m", "track_m"],
            Self::Ackermann { .. } => &["radius_m", "wheelbase_m", "steering_offset_rad"],
            Self::Mecanum { .. } => &[
                "radius_front_left_m",
                "radius_front_right_m",
                "radius_rear_left_m",
                "radius_rear_right_m",
                "reach_m",
                "sideways_scale",
            ],
            Self::Omni3 { .. } => &["radius_0_m", "radius_1_m", "radius_2_m", "reach_m", "sideways_scale"],
            Self::Omni4 { .. } => &["radius_0_m", "radius_1_m", "radius_2_m", "radius_3_m", "reach_m"],
        }
    }

    /// The radii, then track, wheelbase or reach, then the offset of the steering or the scale of the way to the side where there is one.
    pub fn parameters(&self) -> Vec<f64> {
        match *self {
            Self::Differential { radius_left_m, radius_right_m, track_m } => {
                vec![radius_left_m, radius_right_m, track_m]
            }
            Self::Ackermann { radius_m, wheelbase_m, steering_offset_rad } => {
                vec![radius_m, wheelbase_m, steering_offset_rad]
            }
            Self::Mecanum { radii_m: [a, b, c, d], reach_m, sideways_scale } => {
                vec![a, b, c, d, reach_m, sideways_scale]
            }
            Self::Omni4 { radii_m: [a, b, c, d], reach_m } => vec![a, b, c, d, reach_m],
            Self::Omni3 { radii_m: [a, b, c], reach_m, sideways_scale } => {
                vec![a, b, c, reach_m, sideways_scale]
            }
        }
    }

    /// Adds to each of the parameters.
    ///
    /// # Arguments
    /// * `steps`: in the order of [`Self::parameters`]; further ones are not used.
    pub fn add(&mut self, steps: &[f64]) {
        let step = |index: usize| steps.get(index).copied().unwrap_or(0.0);
        let (radii, size): (&mut [f64], _) = match self {
            Self::Differential { radius_left_m, radius_right_m, track_m } => {
                *radius_left_m += step(0);
                *radius_right_m += step(1);
                *track_m += step(2);
                return;
            }
            Self::Ackermann { radius_m, wheelbase_m, steering_offset_rad } => {
                *steering_offset_rad += step(2);
                (std::slice::from_mut(radius_m), wheelbase_m)
            }
            Self::Mecanum { radii_m, reach_m, sideways_scale } => {
                *sideways_scale += step(radii_m.len() + 1);
                (radii_m, reach_m)
            }
            Self::Omni4 { radii_m, reach_m } => (radii_m, reach_m),
            Self::Omni3 { radii_m, reach_m, sideways_scale } => {
                *sideways_scale += step(radii_m.len() + 1);
                (radii_m, reach_m)
            }
        };
        radii.iter_mut().enumerate().for_each(|(index, radius)| *radius += step(index));
        *size += step(radii.len());
    }

    /// Radius of a wheel of a reading, metres.
    pub fn radius_m(&self, wheel: usize) -> f64 {
        match *self {
            Self::Differential { radius_left_m, radius_right_m, .. } => {
                [radius_left_m, radius_right_m].get(wheel).copied().unwrap_or(radius_left_m)
            }
            Self::Ackermann { radius_m, .. } => radius_m,
            Self::Mecanum { radii_m, .. } | Self::Omni4 { radii_m, .. } => radii_m[wheel.min(3)],
            Self::Omni3 { radii_m, .. } => radii_m[wheel.min(2)],
        }
    }

    /// Way to the side, of that which the wheels turn; one where the base has no such parameter.
    pub fn sideways_scale(&self) -> f64 {
        match *self {
            Self::Mecanum { sideways_scale, .. } | Self::Omni3 { sideways_scale, .. } => sideways_scale,
            Self::Differential { .. } | Self::Ackermann { .. } | Self::Omni4 { .. } => 1.0,
        }
    }

    /// Sets the [`sideways_scale`](Self::sideways_scale); `false` where the base has no such parameter.
    pub fn set_sideways_scale(&mut self, scale: f64) -> bool {
        match self {
            Self::Mecanum { sideways_scale, .. } | Self::Omni3 { sideways_scale, .. } => {
                *sideways_scale = scale;
                true
            }
            Self::Differential { .. } | Self::Ackermann { .. } | Self::Omni4 { .. } => false,
        }
    }

    /// Track, wheelbase or reach, metres.
    pub fn size_m(&self) -> f64 {
        match *self {
            Self::Differential { track_m, .. } => track_m,
            Self::Ackermann { wheelbase_m, .. } => wheelbase_m,
            Self::Mecanum { reach_m, .. } | Self::Omni3 { reach_m, .. } | Self::Omni4 { reach_m, .. } => {
                reach_m
            }
        }
    }

    /// Sets the radii. One radius is that of all wheels; `false` where there are neither one nor as many as wheels.
    pub fn set_radii_m(&mut self, radii: &[f64]) -> bool {
        let wheels = self.kind().wheels();
        if radii.len() != 1 && radii.len() != wheels {
            return false;
        }
        let radius = |wheel: usize| radii[wheel.min(radii.len() - 1)];
        match self {
            Self::Differential { radius_left_m, radius_right_m, .. } => {
                (*radius_left_m, *radius_right_m) = (radius(0), radius(1));
            }
            Self::Ackermann { radius_m, .. } => *radius_m = radius(0),
            Self::Mecanum { radii_m, .. } | Self::Omni4 { radii_m, .. } => {
                *radii_m = std::array::from_fn(radius);
            }
            Self::Omni3 { radii_m, .. } => *radii_m = std::array::from_fn(radius),
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameters_are_named_and_added_one_by_one() {
        for kind in BaseKind::ALL {
            let base = WheelBase::new(kind, 0.125, 0.5);
            assert_eq!(base.kind(), kind);
            assert_eq!(BaseKind::named(kind.name()), Some(kind));
            let before = base.parameters();
            assert_eq!(before.len(), base.parameter_names().len());
            assert!(
                before.len() <= MAX_WHEEL_PARAMETERS
                    && before[kind.wheels()].total_cmp(&base.size_m()).is_eq()
            );
            for index in 0..before.len() {
                let mut steps = vec![0.0; before.len()];
                steps[index] = 0.25;
                let mut moved = base;
                moved.add(&steps);
                let changed: Vec<f64> = moved.parameters().iter().zip(&before).map(|(a, b)| a - b).collect();
                assert_eq!(changed, steps);
            }
            let mut others = base;
            let radii: Vec<f64> = (0..kind.wheels()).map(|wheel| 0.25 + wheel as f64).collect();
            assert!(others.set_radii_m(&radii) && others.set_radii_m(&[0.1]));
            assert!((0..kind.wheels()).all(|wheel| others.radius_m(wheel).total_cmp(&0.1).is_eq()));
            assert!(!others.set_radii_m(&[0.1; 7]));
        }
    }
}
