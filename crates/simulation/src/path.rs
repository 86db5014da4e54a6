//! The trajectories of the two runs: built-in, or along a given trajectory.
//!
//! World frame: z up, metres. Body frame: x forward, y left, z up.

use super::SimulationError;
use super::random::{Purpose, stream};
use super::scenario::{Scenario, flight, hand_held};
use super::spline::Spline;
use evaluation::trajectory::StampedPose;
use geometry::pose::Pose;
use nalgebra::{UnitQuaternion, Vector2, Vector3};
use rand::RngExt;
use std::f64::consts::TAU;

/// Distance between control poses. Faster wobble than a few of these cannot be expressed.
const KNOT_NS: i64 = 200_000_000;
/// Rest before the start, from which a robot finds gravity and its gyroscope's bias, seconds.
const REST_BEFORE_S: f64 = 2.5;
/// The same before a flight, whose images cost more, seconds.
const FLIGHT_REST_S: f64 = 1.2;
/// Rest at the end, seconds.
const REST_AFTER_S: f64 = 1.0;
/// Time to reach the cruising speed, seconds.
const SPEED_UP_S: f64 = 3.0;
/// Braking begins so far before the end, metres.
const BRAKE_M: f64 = 8.0;
/// A given trajectory must last at least so long, seconds.
const MIN_DURATION_S: f64 = 3.0;

/// How the trajectory of one run differs from the middle of the street.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Style {
    /// Mean distance to the left of the middle, metres.
    lateral: f64,
    /// Phases of weaving, wobbling and speeding, rad.
    phases: [f64; 6],
}

impl Style {
    /// The map is made on the right side of the street, the live run drives on the left.
    pub(crate) fn of_run(seed: u64, run: u64) -> Self {
        let mut rng = stream(seed, run, Purpose::Path);
        let lateral = if run == 0 { -0.7 } else { 0.8 };
        Self { lateral, phases: std::array::from_fn(|_| rng.random_range(0.0..TAU)) }
    }
}

/// Along a built-in trajectory; on streets at about `speed` m/s.
pub(crate) fn built_in(
    scenario: Scenario,
    start_ns: i64,
    speed: f64,
    style: &Style,
) -> Result<Spline, SimulationError> {
    let knot_s = KNOT_NS as f64 * 1e-9;
    if scenario == Scenario::Room {
        let pose = |knot: i32| hand_held(f64::from(knot - 1) * knot_s, REST_BEFORE_S, &style.phases);
        return spline(start_ns, KNOT_NS, (0..).map_while(pose).collect());
    }
    if scenario == Scenario::Flight {
        let pose =
            |knot: i32| flight(f64::from(knot - 1) * knot_s, FLIGHT_REST_S, style.lateral, &style.phases);
        return spline(start_ns, KNOT_NS, (0..).map_while(pose).collect());
    }
    let length = scenario.length();
    let (mut s, mut time, mut rested) = (0.0, -knot_s, 0.0);
    let mut controls = Vec::new();
    // A control pose before the beginning, and one after the end, are what a cubic spline needs.
    while rested < REST_AFTER_S + 2.0 * knot_s {
        let up = if scenario.starts_at_rest() { speed_up(time) } else { 1.0 };
        let pace = pace(up, s, length) * (1.0 + 0.2 * (TAU * time / 17.0 + style.phases[0]).sin());
        controls.push(street_pose(scenario, s, time, pace.min(1.0), style));
        s = (s + speed * pace * knot_s).min(length);
        time += knot_s;
        if s >= length {
            rested += knot_s;
        }
    }
    spline(start_ns, KNOT_NS, controls)
}

/// From standstill to the cruising speed, smoothly.
fn speed_up(time: f64) -> f64 {
    let up = ((time - REST_BEFORE_S) / SPEED_UP_S).clamp(0.0, 1.0);
    up * up * (3.0 - 2.0 * up)
}

/// Fraction of the cruising speed, smooth to standstill.
fn pace(up: f64, s: f64, length: f64) -> f64 {
    let down = ((length - s) / BRAKE_M).clamp(0.02, 1.0);
    if s >= length { 0.0 } else { up.min(down) }
}

/// The body on the street: a little beside the middle, swaying as much as it moves.
fn street_pose(scenario: Scenario, s: f64, time: f64, pace: f64, style: &Style) -> Pose {
    let length = scenario.lap_length();
    let (middle, heading) = scenario.middle_of_street(s);
    let phases = &style.phases;
    let lateral = style.lateral + 0.5 * (3.0 * TAU * s / length + phases[1]).sin();
    let left = Vector2::new(-heading.sin(), heading.cos());
    let ground = middle + left * lateral;
    let hill = scenario.hills_m() * (2.0 * TAU * s / length).sin();
    let height = 1.5 + hill + 0.05 * pace * (TAU * time / 0.9 + phases[2]).sin();
    let sway = |period: f64, phase: f64| pace * (TAU * time / period + phase).sin();
    let roll = 0.03 * sway(1.3, phases[3]);
    let pitch = 0.03 * sway(1.7, phases[4]);
    let yaw = heading + 0.05 * sway(4.1, phases[5]);
    Pose::new(UnitQuaternion::from_euler_angles(roll, pitch, yaw), Vector3::new(ground.x, ground.y, height))
}

/// Along a given trajectory of the body (z up), `sideways` metres to its left, smoothed by the spline.
pub(crate) fn along(
    trajectory: &[StampedPose],
    start_ns: i64,
    sideways: f64,
) -> Result<Spline, SimulationError> {
    let (Some(first), Some(last)) = (trajectory.first(), trajectory.last()) else {
        return Err(SimulationError::TrajectoryTooShort { seconds: 0.0, wanted: MIN_DURATION_S });
    };
    let duration_ns = last.stamp_ns - first.stamp_ns;
    let seconds = duration_ns as f64 * 1e-9;
    if seconds < MIN_DURATION_S {
        return Err(SimulationError::TrajectoryTooShort { seconds, wanted: MIN_DURATION_S });
    }
    let aside = Pose::new(UnitQuaternion::identity(), Vector3::y() * sideways);
    let stamps = (0..=duration_ns / KNOT_NS).map(|knot| first.stamp_ns + knot * KNOT_NS);
    spline(start_ns, KNOT_NS, stamps.map(|stamp| interpolate(trajectory, stamp).compose(&aside)).collect())
}

fn interpolate(trajectory: &[StampedPose], stamp_ns: i64) -> Pose {
    let after = trajectory.partition_point(|pose| pose.stamp_ns < stamp_ns).clamp(1, trajectory.len() - 1);
    let (a, b) = (&trajectory[after - 1], &trajectory[after]);
    let weight = (stamp_ns - a.stamp_ns) as f64 / (b.stamp_ns - a.stamp_ns) as f64;
    let rotation = a.pose.rotation.try_slerp(&b.pose.rotation, weight, 1e-12).unwrap_or(b.pose.rotation);
    Pose::new(rotation, a.pose.translation.lerp(&b.pose.translation, weight))
}

fn spline(start_ns: i64, knot_ns: i64, controls: Vec<Pose>) -> Result<Spline, SimulationError> {
    let seconds = controls.len() as f64 * knot_ns as f64 * 1e-9;
    Spline::new(start_ns, knot_ns, controls)
        .ok_or(SimulationError::TrajectoryTooShort { seconds, wanted: MIN_DURATION_S })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_starts_at_rest_and_goes_all_the_way_round_at_a_sane_pace() {
        for run in 0..2 {
            let spline = built_in(Scenario::Block, 0, 4.0, &Style::of_run(1, run)).unwrap();
            assert!(spline.at(1_500_000_000).velocity.norm() < 1e-9);
            assert!(spline.at(spline.end_ns()).velocity.norm() < 1e-9);
            let stamps = || (0..spline.end_ns()).step_by(50_000_000);
            let fastest = stamps().map(|stamp| spline.at(stamp).velocity.norm()).fold(0.0, f64::max);
            let hardest = stamps().map(|stamp| spline.at(stamp).acceleration.norm()).fold(0.0, f64::max);
            assert!((4.0..6.0).contains(&fastest), "{fastest}");
            assert!((1.0..15.0).contains(&hardest), "{hardest}");
            let positions: Vec<_> = stamps().map(|stamp| spline.at(stamp).pose.translation).collect();
            let path: f64 = positions.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
            assert!((300.0..400.0).contains(&path), "{path}");
            assert!((positions[0] - positions[positions.len() - 1]).norm() < 0.5);
        }
    }

    #[test]
    fn the_hand_held_body_starts_from_rest_and_moves_as_hands_do() {
        let spline = built_in(Scenario::Room, 0, 4.0, &Style::of_run(3, 1)).unwrap();
        assert!(spline.at(1_500_000_000).velocity.norm() < 1e-9);
        let stamps = || (6_000_000_000..60_000_000_000).step_by(50_000_000);
        let most = |of: &dyn Fn(&crate::spline::Motion) -> f64| {
            stamps().map(|stamp| of(&spline.at(stamp))).fold(0.0, f64::max)
        };
        let speed = most(&|motion| motion.velocity.norm());
        let force = most(&|motion| motion.acceleration.norm());
        let rate = most(&|motion| motion.angular_velocity.norm());
        assert!((0.8..4.0).contains(&speed) && (1.0..12.0).contains(&force), "{speed} {force}");
        assert!((0.5..3.0).contains(&rate), "{rate}");
    }

    #[test]
    fn a_flight_starts_from_rest_and_keeps_away_from_the_walls() {
        for run in 0..2 {
            let spline = built_in(Scenario::Flight, 0, 4.0, &Style::of_run(2, run)).unwrap();
            assert!(spline.at(800_000_000).velocity.norm() < 1e-9);
            let motions: Vec<_> =
                (4_000_000_000..60_000_000_000).step_by(50_000_000).map(|stamp| spline.at(stamp)).collect();
            let speed = motions.iter().map(|motion| motion.velocity.norm()).fold(0.0, f64::max);
            let rate = motions.iter().map(|motion| motion.angular_velocity.norm()).fold(0.0, f64::max);
            assert!((0.5..2.0).contains(&speed) && (0.5..1.6).contains(&rate), "{speed} {rate}");
            for position in motions.iter().map(|motion| motion.pose.translation) {
                let [x, y, z] = [position.x, position.y, position.z];
                assert!((x / 2.6).hypot(y / 2.1) < 1.0 && (1.0..2.0).contains(&z), "{position}");
            }
        }
    }

    #[test]
    fn loops_begin_in_motion_and_go_round_ten_times() {
        let spline =
            built_in(Scenario::Loops, 0, Scenario::Loops.usual_speed(), &Style::of_run(1, 0)).unwrap();
        assert!(spline.at(0).velocity.norm() > 2.0);
        assert!((350.0..460.0).contains(&(spline.end_ns() as f64 * 1e-9)));
        let cut = spline.until(60_000_000_000);
        assert!((cut.end_ns() - 60_000_000_000).abs() <= KNOT_NS);
        assert_eq!(cut.at(50_000_000_000), spline.at(50_000_000_000));
    }

    #[test]
    fn a_given_trajectory_is_followed() {
        let given: Vec<_> = (0..100)
            .map(|index| {
                let t = f64::from(index) * 0.1;
                let pose = Pose::new(
                    UnitQuaternion::from_euler_angles(0.0, 0.0, 0.3 * t),
                    Vector3::new(t, (0.5 * t).sin(), 0.0),
                );
                StampedPose { stamp_ns: 7_000_000_000 + i64::from(index) * 100_000_000, pose }
            })
            .collect();
        let spline = along(&given, 5_000, 0.0).unwrap();
        // The first control pose lies one knot before the start.
        let difference = spline.at(5_000 + 3_800_000_000).pose.local(&given[40].pose);
        assert!(difference.amax() < 0.01, "{difference}");
        assert!(along(&given[..10], 0, 0.0).is_err() && along(&[], 0, 0.0).is_err());
    }
}
