//! How a base moves while its wheels turn.
//!
//! Each wheel of a base rolls by a part of the base's motion, `u = c k ω + a v_x + b v_y`:
//!
//! | base | `(c, a, b)` of each wheel | `k` |
//! |---|---|---|
//! | differential | `(-1, 1, 0)`, `(1, 1, 0)` | half of the track |
//! | mecanum | `(-1, 1, -1)`, `(1, 1, 1)`, `(-1, 1, 1)`, `(1, 1, -1)` | reach |
//! | omni, wheel at the angle `α` | `(1, -sin α, cos α)` | reach |
//!
//! The columns of these tables are orthogonal: the least-squares solution for the motion divides by the sums of their squares. Rollers slip:
//! of the way to the side that the wheels turn, the base makes a part, its `sideways_scale` (of four omni wheels it is in two radii). A car's
//! motion is `v_x = r ω_wheel`, `ω = v_x tan(δ) / L` with its wheelbase `L` and the angle `δ` of its steering.

use nalgebra::{Matrix3x4, Vector3};
use std::f64::consts::FRAC_PI_2;
use types::{BaseKind, MAX_WHEELS, WheelBase, WheelReading};

/// What a wheel rolls with a turn (per `k`), and with a motion ahead and to the left.
type Rolling = [f64; 3];

const DIFFERENTIAL: [Rolling; 2] = [[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0]];
const MECANUM: [Rolling; 4] = [[-1.0, 1.0, -1.0], [1.0, 1.0, 1.0], [-1.0, 1.0, 1.0], [1.0, 1.0, -1.0]];
/// Sine of 60 degrees.
const SIN_60: f64 = 0.866_025_403_784_438_6;
const OMNI3: [Rolling; 3] = [[1.0, 0.0, 1.0], [1.0, -SIN_60, -0.5], [1.0, SIN_60, -0.5]];
const OMNI4: [Rolling; 4] = [[1.0, 0.0, 1.0], [1.0, -1.0, 0.0], [1.0, 0.0, -1.0], [1.0, 1.0, 0.0]];

/// Motion of a car over a metre of wheelbase, beside which the angle of its steering is not looked for, metres.
const LEAST_MOTION_M: f64 = 1e-3;
/// A car's wheels do not steer further, rad.
const MAX_STEERING_RAD: f64 = FRAC_PI_2 - 0.1;

/// What a base does between two readings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Step {
    /// Angle, way ahead and way to the left (rad, metres).
    pub(super) motion: Vector3<f64>,
    /// The way of each wheel, metres; zero of a steering.
    pub(super) rolled: [f64; MAX_WHEELS],
    /// Of `motion`, with respect to the way of each wheel (metres), and to the integral of the steering angle (rad s).
    pub(super) by_values: Matrix3x4<f64>,
    /// Of `motion`, with respect to the parameters behind the radii: track, wheelbase or reach, and offset of the steering or scale of the
    /// way to the side.
    pub(super) by_geometry: [Vector3<f64>; 2],
}

/// The table of a base whose motion is linear in its wheels.
fn table(base: &WheelBase) -> Option<(&'static [Rolling], f64)> {
    let size = base.size_m();
    match base.kind() {
        BaseKind::Differential => Some((&DIFFERENTIAL, size / 2.0)),
        BaseKind::Mecanum => Some((&MECANUM, size)),
        BaseKind::Omni3 => Some((&OMNI3, size)),
        BaseKind::Omni4 => Some((&OMNI4, size)),
        _ => None,
    }
}

/// Sums of the squares of a table's columns.
fn squares(table: &[Rolling]) -> Rolling {
    std::array::from_fn(|column| table.iter().map(|row| row[column] * row[column]).sum())
}

/// The angle of a car's steering, of a reading of it.
fn steering_rad(base: &WheelBase, measured_rad: f64) -> f64 {
    let offset_rad = base.parameters().get(2).copied().unwrap_or(0.0);
    (measured_rad + offset_rad).clamp(-MAX_STEERING_RAD, MAX_STEERING_RAD)
}

impl Step {
    /// # Arguments
    /// * `values`: mean of those of both readings.
    /// * `seconds`: between them.
    pub(super) fn new(base: &WheelBase, values: &[f64; MAX_WHEELS], seconds: f64) -> Self {
        let rolled_by = |wheel: usize| base.radius_m(wheel) * (values[wheel] * seconds);
        let mut step = Self {
            motion: Vector3::zeros(),
            rolled: [0.0; MAX_WHEELS],
            by_values: Matrix3x4::zeros(),
            by_geometry: [Vector3::zeros(); 2],
        };
        let Some((table, k)) = table(base) else {
            let (ahead, steering_rad) = (rolled_by(0), steering_rad(base, values[1]));
            let (tangent, wheelbase) = (steering_rad.tan(), base.size_m());
            let by_steering = ahead * (1.0 + tangent * tangent) / wheelbase;
            let turn = ahead * tangent / wheelbase;
            step.motion = Vector3::new(turn, ahead, 0.0);
            step.rolled[0] = ahead;
            step.by_values.set_column(0, &Vector3::new(tangent / wheelbase, 1.0, 0.0));
            step.by_values[(0, 1)] = if seconds > 0.0 { by_steering / seconds } else { 0.0 };
            step.by_geometry = [-turn / wheelbase, by_steering].map(|turn| Vector3::x() * turn);
            return step;
        };
        let ([turns, aheads, lefts], scale) = (squares(table), base.sideways_scale());
        for (wheel, [c, a, b]) in table.iter().enumerate() {
            let sideways = if lefts > 0.0 { scale * b / lefts } else { 0.0 };
            let column = Vector3::new(c / (k * turns), a / aheads, sideways);
            step.rolled[wheel] = rolled_by(wheel);
            step.motion += column * step.rolled[wheel];
            step.by_values.set_column(wheel, &column);
        }
        step.by_geometry =
            [Vector3::x() * (-step.motion.x / base.size_m()), Vector3::z() * (step.motion.z / scale)];
        step
    }

    /// Speed of the base at a reading: turn, ahead, left (rad/s, m/s).
    pub(super) fn speed(base: &WheelBase, reading: &WheelReading) -> Vector3<f64> {
        Self::new(base, &reading.values, 1.0).motion
    }
}

/// Part of a motion that each wheel makes, metres; of a steering, that of the steered wheels to the left.
///
/// # Arguments
/// * `motion`: turn, ahead, left (rad, metres).
pub fn ways_of_wheels(base: &WheelBase, motion: &Vector3<f64>) -> [f64; MAX_WHEELS] {
    let mut ways = [0.0; MAX_WHEELS];
    let Some((table, k)) = table(base) else {
        // The front wheels roll sideways where the steering is off.
        ways[0] = motion.y;
        ways[1] = motion.x * base.size_m();
        return ways;
    };
    for (way, [c, a, b]) in ways.iter_mut().zip(table) {
        *way = c * k * motion.x + a * motion.y + b * motion.z / base.sideways_scale();
    }
    ways
}

/// What has to be subtracted from all readings of an interval so that the base moves by so much less.
///
/// # Arguments
/// * `readings`: of the interval.
/// * `excess`: turn, ahead, left.
/// * `seconds`: duration.
pub(super) fn values_of_excess(
    base: &WheelBase,
    readings: &[WheelReading],
    excess: &Vector3<f64>,
    seconds: f64,
) -> [f64; MAX_WHEELS] {
    let mut values = ways_of_wheels(base, excess);
    if table(base).is_some() {
        for (wheel, value) in values.iter_mut().enumerate().take(base.kind().wheels()) {
            *value = *value / base.radius_m(wheel) / seconds;
        }
        return values;
    }
    let count = readings.len().max(1) as f64;
    let mean = |index: usize| readings.iter().map(|reading| reading.values[index]).sum::<f64>() / count;
    values[0] = excess.y / base.radius_m(0) / seconds;
    let drive = mean(0) - values[0];
    let moved = Step::new(base, &[drive, mean(1), 0.0, 0.0], seconds);
    // The turn that is left when the drive is right, by the steering; at rest no steering explains a turn.
    let left_over = excess.x - moved.by_values[(0, 0)] * excess.y;
    let by_steering = moved.by_geometry[1].x;
    values[1] = left_over * by_steering / (by_steering * by_steering + LEAST_MOTION_M * LEAST_MOTION_M);
    values
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::numeric::numeric_jacobian;
    use nalgebra::DVector;

    fn bases() -> impl Iterator<Item = WheelBase> {
        BaseKind::ALL.into_iter().map(|kind| {
            let mut base = WheelBase::new(kind, 0.1, 0.6);
            base.add(&[0.002, -0.003, 0.001, 0.004, 0.0, -0.05][..base.parameters().len()]);
            base
        })
    }

    #[test]
    fn wheels_that_roll_as_the_base_moves_move_it_so() {
        for base in bases().filter(|base| base.kind() != BaseKind::Ackermann) {
            let left = if base.kind().moves_sideways() { -0.4 } else { 0.0 };
            let motion = Vector3::new(0.3, 1.2, left);
            let ways = ways_of_wheels(&base, &motion);
            let values = std::array::from_fn(|wheel| ways[wheel] / base.radius_m(wheel) / 0.5);
            let step = Step::new(&base, &values, 0.5);
            assert!((step.motion - motion).amax() < 1e-12, "{base:?}: {}", step.motion);
            let wheels = base.kind().wheels();
            assert!((0..wheels).all(|wheel| (step.rolled[wheel] - ways[wheel]).abs() < 1e-12));
        }
    }

    #[test]
    fn a_car_turns_about_the_axis_of_its_rear_wheels() {
        let base = WheelBase::Ackermann { radius_m: 0.3, wheelbase_m: 2.5, steering_offset_rad: 0.1 };
        let step = Step::new(&base, &[10.0, 0.2, 0.0, 0.0], 0.5);
        assert!((step.motion - Vector3::new(1.5 * 0.3_f64.tan() / 2.5, 1.5, 0.0)).amax() < 1e-12);
    }

    #[test]
    fn the_jacobians_are_the_numeric_ones() {
        for base in bases() {
            let (values, seconds) = ([11.0, 0.35, -7.0, 5.0], 0.02);
            let wheels = base.kind().wheels();
            let columns = base.kind().columns().len();
            let found = Step::new(&base, &values, seconds);
            let motion = |base: &WheelBase, values: &[f64; 4]| {
                DVector::from_column_slice(Step::new(base, values, seconds).motion.as_slice())
            };
            let by_values = numeric_jacobian(columns, |error| {
                let mut moved = values;
                for (index, value) in moved.iter_mut().enumerate().take(columns) {
                    let unit = if index < wheels { base.radius_m(index) * seconds } else { seconds };
                    *value += error[index] / unit;
                }
                motion(&base, &moved)
            });
            assert!((by_values - found.by_values.columns(0, columns)).amax() < 1e-6, "{base:?}");
            let by_geometry = numeric_jacobian(base.parameters().len() - wheels, |error| {
                let mut steps = vec![0.0; wheels];
                steps.extend(error.iter());
                let mut moved = base;
                moved.add(&steps);
                motion(&moved, &values)
            });
            for (index, column) in by_geometry.column_iter().enumerate() {
                assert!((column - found.by_geometry[index]).amax() < 1e-6, "{base:?}");
            }
        }
    }

    /// Readings that are corrected move the base as it was stated to move.
    #[test]
    fn an_excess_is_subtracted_from_the_readings() {
        for base in bases() {
            let left = if base.kind().moves_sideways() { 0.02 } else { 0.0 };
            let (mean, seconds) = ([11.0, 0.35, -7.0, 5.0], 0.2);
            let readings = [WheelReading::new(0, mean); 3];
            let excess = Vector3::new(0.01, 0.03, left);
            let values = values_of_excess(&base, &readings, &excess, seconds);
            let corrected = std::array::from_fn(|index| mean[index] - values[index]);
            let before = Step::new(&base, &mean, seconds).motion;
            let after = Step::new(&base, &corrected, seconds).motion;
            assert!((before - after - excess).amax() < 5e-4, "{base:?}: {}", before - after);
        }
    }
}
