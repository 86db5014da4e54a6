//! Reference poses against the gyroscope: poses of another sensor, in another order of columns or of another time turn otherwise
//! than the IMU did.

use geometry::median;
use nalgebra::UnitQuaternion;
use sensors::{ImuSample, ReferencePose};

use super::error::BuildError;
use super::reading_steps::steps;

/// Time over which a turn is compared (ns): at least, and at most.
const SPAN_NS: [i64; 2] = [500_000_000, 1_000_000_000];
/// Smaller turns by the gyroscope are not compared (rad): biases matter in them.
const LEAST_TURN: f64 = 0.1;
/// Turns agree where they differ by less than this part of the turn, besides the sigmas of the poses and the bias.
const TOLERANCE: f64 = 0.5;
/// What a bias of the gyroscope may add (rad).
const BIAS: f64 = 0.02;
/// With fewer turns there is no verdict.
const LEAST_TURNS: usize = 5;
/// Poses are refused where more than this part of the turns differ.
const MAX_CONTRADICTED: f64 = 0.5;

/// Refuses reference poses whose turns are not those of the gyroscope.
///
/// # Arguments
/// * `readings`: in order of time; without any nothing is compared.
/// * `sigma_theta_rad`: replaces the standard deviation that the poses state.
///
/// # Errors
/// [`BuildError::ReferencesTurnOtherwise`].
pub(super) fn check_turns(
    readings: &[ImuSample],
    references: &[ReferencePose],
    sigma_theta_rad: Option<f64>,
) -> Result<(), BuildError> {
    let mut poses: Vec<&ReferencePose> = references.iter().collect();
    poses.sort_by_key(|known| known.stamp_ns);
    let (mut turns, mut differences, mut contradicted) = (Vec::new(), Vec::new(), 0);
    let mut first = 0;
    while let Some(begin) = poses.get(first) {
        let next = poses.partition_point(|known| known.stamp_ns < begin.stamp_ns + SPAN_NS[0]);
        let Some(end) = poses.get(next) else { break };
        first = next;
        if end.stamp_ns - begin.stamp_ns > SPAN_NS[1] {
            continue;
        }
        let Some(turned) = turn(readings, begin.stamp_ns, end.stamp_ns) else { continue };
        if turned.angle() < LEAST_TURN {
            continue;
        }
        let by_poses = begin.pose.rotation.inverse() * end.pose.rotation;
        let difference = turned.angle_to(&by_poses);
        let sigma = sigma_theta_rad.unwrap_or_else(|| begin.largest_sigmas().0.hypot(end.largest_sigmas().0));
        contradicted += usize::from(difference > TOLERANCE * turned.angle() + BIAS + 3.0 * sigma);
        turns.push(turned.angle());
        differences.push(difference);
    }
    if turns.len() < LEAST_TURNS || contradicted as f64 <= MAX_CONTRADICTED * turns.len() as f64 {
        return Ok(());
    }
    let median_deg = |values: &mut [f64]| median(values).unwrap_or_default().to_degrees();
    Err(BuildError::ReferencesTurnOtherwise {
        contradicted,
        used: turns.len(),
        turn_deg: median_deg(&mut turns),
        difference_deg: median_deg(&mut differences),
    })
}

/// How the gyroscope turned between two times; `None` where its readings do not cover them.
fn turn(readings: &[ImuSample], from_ns: i64, to_ns: i64) -> Option<UnitQuaternion<f64>> {
    let turned = steps(readings, from_ns, to_ns)?
        .fold(UnitQuaternion::identity(), |turned, step| turned * step.turn());
    turned.coords.iter().all(|value| value.is_finite()).then_some(turned)
}
