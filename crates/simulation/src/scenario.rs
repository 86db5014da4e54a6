//! The built-in trajectories: a street round a block, ten loops on a circle, a hand-held body in a room, a flight in a room.
//!
//! World frame: z up, metres. Body frame: x forward, y left, z up.

use geometry::pose::Pose;
use nalgebra::{UnitQuaternion, Vector2, Vector3};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Half of the block's length, metres.
const HALF_LENGTH: f64 = 55.0;
/// Half of its width, metres.
const HALF_WIDTH: f64 = 32.5;
/// Radius of its corners, metres.
const CORNER: f64 = 12.0;
/// Radius of the loops, metres, and their number: as in the simulation `loops` of the paper's authors.
const LOOP_RADIUS: f64 = 20.0;
const LOOPS: f64 = 10.0;
/// Duration of the trajectories in a room, seconds.
const ROOM_S: f64 = 300.0;

/// Half axes of the flight round a room, metres, its angular rate (rad/s), and where it begins (rad).
const FLIGHT_RADII: [f64; 2] = [1.9, 1.4];
const FLIGHT_RATE: f64 = 0.44;
const FLIGHT_START: f64 = 0.3;

/// A built-in trajectory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum Scenario {
    /// Once round a block of houses, 326 m, from rest to rest.
    #[default]
    Block,
    /// Ten loops of 126 m on a circle that rises and falls by a metre, in motion from the start.
    Loops,
    /// Five minutes hand-held, within a few metres and looking around, from rest.
    Room,
    /// Five minutes of flight round the middle of a room of 9 m x 7 m, looking ahead, from rest.
    Flight,
}

impl Scenario {
    /// Usual speed, m/s; without effect on `Room` and `Flight`.
    pub fn usual_speed(self) -> f64 {
        match self {
            Self::Block | Self::Room | Self::Flight => 4.0,
            Self::Loops => PI,
        }
    }

    /// Range of depths of landmarks in front of the camera, metres.
    pub fn depth_m(self) -> [f64; 2] {
        match self {
            Self::Block | Self::Loops => [4.0, 30.0],
            Self::Room | Self::Flight => [1.5, 8.0],
        }
    }

    /// Whether the body is at rest at first.
    pub(crate) fn starts_at_rest(self) -> bool {
        self != Self::Loops
    }

    /// Length of the middle of the street once round, metres.
    pub(crate) fn lap_length(self) -> f64 {
        match self {
            Self::Block => 4.0 * (HALF_LENGTH + HALF_WIDTH - 2.0 * CORNER) + TAU * CORNER,
            Self::Loops | Self::Room | Self::Flight => TAU * LOOP_RADIUS,
        }
    }

    /// Length of the whole trajectory, metres.
    pub(crate) fn length(self) -> f64 {
        self.lap_length() * if self == Self::Loops { LOOPS } else { 1.0 }
    }

    /// Amplitude of the street's height, twice a lap, metres.
    pub(crate) fn hills_m(self) -> f64 {
        if self == Self::Block { 1.5 } else { 1.0 }
    }

    /// Position and heading (rad, from x) on the middle of the street, `s` metres from the start, anticlockwise.
    pub(crate) fn middle_of_street(self, s: f64) -> (Vector2<f64>, f64) {
        if self == Self::Block {
            return round_the_block(s.rem_euclid(self.lap_length()));
        }
        let heading = s / LOOP_RADIUS;
        (Vector2::new(heading.sin(), 1.0 - heading.cos()) * LOOP_RADIUS, heading)
    }
}

fn round_the_block(mut rest: f64) -> (Vector2<f64>, f64) {
    let straights = [2.0 * (HALF_LENGTH - CORNER), 2.0 * (HALF_WIDTH - CORNER)];
    let mut position = Vector2::new(-HALF_LENGTH + CORNER, -HALF_WIDTH);
    let mut heading = 0.0_f64;
    for side in 0..4 {
        let straight = straights[side % 2];
        let forward = Vector2::new(heading.cos(), heading.sin());
        if rest < straight {
            return (position + forward * rest, heading);
        }
        rest -= straight;
        position += forward * straight;
        let centre = position + Vector2::new(-forward.y, forward.x) * CORNER;
        let on_corner = |angle: f64| {
            let turned = heading + angle;
            centre + Vector2::new(turned.sin(), -turned.cos()) * CORNER
        };
        let turn = rest / CORNER;
        if turn < FRAC_PI_2 {
            return (on_corner(turn), heading + turn);
        }
        rest -= FRAC_PI_2 * CORNER;
        position = on_corner(FRAC_PI_2);
        heading += FRAC_PI_2;
    }
    (position, heading)
}

/// The hand-held body, at rest until `rest_s`.
///
/// # Arguments
/// * `phases`: of position (three) and rotation (three), rad; they differ from run to run.
pub(crate) fn hand_held(time: f64, rest_s: f64, phases: &[f64; 6]) -> Option<Pose> {
    if time > ROOM_S {
        return None;
    }
    let own = own_time(time, rest_s);
    let wave = |period: f64, phase: f64| (TAU * own / period + phase).sin();
    let position = Vector3::new(
        1.2 * wave(7.3, phases[0]) + 0.2 * wave(2.1, phases[3]),
        1.0 * wave(6.1, phases[1]) + 0.2 * wave(1.9, phases[4]),
        1.4 + 0.4 * wave(4.7, phases[2]) + 0.1 * wave(1.5, phases[5]),
    );
    let rotation = UnitQuaternion::from_euler_angles(
        0.2 * wave(3.9, phases[3]),
        0.25 * wave(3.1, phases[4]),
        0.9 * wave(11.0, phases[5]) + 0.2 * wave(2.7, phases[0]),
    );
    Some(Pose::new(rotation, position))
}

/// The body in flight round the middle of the room, at rest until `rest_s`.
///
/// # Arguments
/// * `lateral`: how much wider than usual the round is, metres; a wider one is flown faster.
/// * `phases`: of height and radius (two) and rotation (three), rad; they differ from run to run.
pub(crate) fn flight(time: f64, rest_s: f64, lateral: f64, phases: &[f64; 6]) -> Option<Pose> {
    if time > ROOM_S {
        return None;
    }
    let own = own_time(time, rest_s);
    let wave = |period: f64, phase: f64| (TAU * own / period + phase).sin();
    let round = FLIGHT_RATE * (1.0 + 0.2 * lateral) * own + FLIGHT_START;
    let wider = 0.3 * lateral + 0.12 * wave(3.7, phases[0]);
    let position = Vector3::new(
        (FLIGHT_RADII[0] + wider) * round.cos(),
        (FLIGHT_RADII[1] + wider) * round.sin(),
        1.5 + 0.25 * wave(5.9, phases[1]) + 0.05 * wave(1.7, phases[2]),
    );
    let ahead = (FLIGHT_RADII[1] * round.cos()).atan2(-FLIGHT_RADII[0] * round.sin());
    let rotation = UnitQuaternion::from_euler_angles(
        0.07 * wave(2.3, phases[3]),
        0.10 * wave(3.1, phases[4]),
        ahead + 0.2 * wave(4.3, phases[5]),
    );
    Some(Pose::new(rotation, position))
}

/// Time that speeds up smoothly, so that a motion starts from rest at any phase, seconds.
fn own_time(time: f64, rest_s: f64) -> f64 {
    let since = (time - rest_s).max(0.0);
    if since < 2.0 { since * since / 4.0 } else { since - 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streets_are_closed_and_their_heading_is_their_direction() {
        for scenario in [Scenario::Block, Scenario::Loops] {
            let step = 1e-4;
            for index in 0..1000 {
                let s = f64::from(index) / 1000.0 * scenario.lap_length();
                let ((here, heading), (next, _)) =
                    (scenario.middle_of_street(s), scenario.middle_of_street(s + step));
                let direction = (next - here) / step;
                assert!((direction - Vector2::new(heading.cos(), heading.sin())).amax() < 1e-4, "at {s}");
            }
            let (start, (end, _)) =
                (scenario.middle_of_street(0.0).0, scenario.middle_of_street(scenario.length()));
            assert!((start - end).norm() < 1e-6);
        }
        assert!(Scenario::Block.lap_length() > 300.0 && (Scenario::Loops.length() - 1257.0).abs() < 1.0);
    }
}
