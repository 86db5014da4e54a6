//! Direction of gravity in the frame of the ground truth, estimated from ground truth and IMU.
//!
//! Over any stretch of time `v1 - v0 = integral of (R f) dt + g T`, with the specific force `f` that the
//! accelerometer measures and the truth's rotation `R`. Over a whole run the errors of `v0` and `v1` are divided by minutes.

use super::rows::{Rows, Stamped};
use super::{ImuSample, SequenceError, TruthRow, TruthTrack};
use nalgebra::Vector3;
use std::iter::Peekable;

/// Gravity is taken to be along a coordinate axis when it is this close to it: motion capture systems are levelled by
/// hand (0.55 deg off in one of EuRoC's rooms), and frames that are tilted on purpose are tilted by more.
const SNAP_DEGREES: f64 = 3.0;
/// A stretch of truth ends where the next row is further away.
const MAX_GAP_NS: i64 = 250_000_000;
/// Without velocities, the speed at the ends of a stretch is taken over this time.
const END_SPAN_NS: i64 = 100_000_000;
/// Plausible estimates of gravity on Earth with a biased accelerometer, m/s^2.
const PLAUSIBLE: std::ops::RangeInclusive<f64> = 9.3..=10.3;

/// The run is processed in pieces of this length, nanoseconds, so that memory does not grow with its length.
const PIECE_NS: i64 = 30_000_000_000;

/// Unit direction of gravity in the truth's frame; `None` where truth and IMU do not overlap, or
/// contradict each other so much that gravity would not have its known strength.
///
/// # Errors
/// Those of the rows.
pub(crate) fn direction(
    truth: Rows<'_, TruthRow>,
    imu: Rows<'_, ImuSample>,
) -> Result<Option<Vector3<f64>>, SequenceError> {
    Ok(estimate(truth, imu)?.and_then(|gravity| direction_of_gravity(&gravity)))
}

/// The unit direction of an estimate of gravity (m/s^2), along a coordinate axis where it is within 3 degrees of one; `None`, with
/// a warning, where its strength is not that of the Earth.
///
/// ```
/// use nalgebra::Vector3;
/// let found = sensors::direction_of_gravity(&Vector3::new(0.1, 0.0, -9.8));
/// assert_eq!(found, Some(-Vector3::z()));
/// assert_eq!(sensors::direction_of_gravity(&Vector3::new(0.0, 0.0, -1.0)), None);
/// ```
pub fn direction_of_gravity(gravity: &Vector3<f64>) -> Option<Vector3<f64>> {
    let strength = gravity.norm();
    if !PLAUSIBLE.contains(&strength) {
        tracing::warn!("poses and IMU contradict each other: they give a gravity of {strength:.2} m/s^2");
        return None;
    }
    Some(snap(gravity / strength))
}

/// The nearest axis if there is one within [`SNAP_DEGREES`].
fn snap(direction: Vector3<f64>) -> Vector3<f64> {
    let axis = direction.iamax();
    let mut snapped = Vector3::zeros();
    snapped[axis] = direction[axis].signum();
    if direction.dot(&snapped) >= SNAP_DEGREES.to_radians().cos() { snapped } else { direction }
}

fn estimate(
    truth: Rows<'_, TruthRow>,
    imu: Rows<'_, ImuSample>,
) -> Result<Option<Vector3<f64>>, SequenceError> {
    let (mut truth, mut imu) = (truth.peekable(), imu.peekable());
    let mut balance = Balance::default();
    let (mut rows, mut samples) = (Vec::<TruthRow>::new(), Vec::<ImuSample>::new());
    loop {
        while let Some(row) =
            next_until(&mut truth, rows.last().map_or(i64::MAX, |last| last.stamp_ns + MAX_GAP_NS))?
        {
            rows.push(row);
            if row.stamp_ns - rows[0].stamp_ns >= PIECE_NS {
                break;
            }
        }
        let (Some(first), Some(last)) = (rows.first().copied(), rows.last().copied()) else {
            return Ok(balance.gravity());
        };
        samples.clear();
        while let Some(sample) = next_until(&mut imu, last.stamp_ns)? {
            if sample.stamp_ns >= first.stamp_ns {
                samples.push(sample);
            }
        }
        balance.add(&rows, &samples);
        rows.clear();
        // A piece that was cut off at its length continues where it ended.
        if last.stamp_ns - first.stamp_ns >= PIECE_NS {
            rows.push(last);
        }
    }
}

/// The next row that is not later than `until_ns`.
fn next_until<T: Stamped>(
    rows: &mut Peekable<Rows<'_, T>>,
    until_ns: i64,
) -> Result<Option<T>, SequenceError> {
    let due = |row: &Result<T, SequenceError>| row.as_ref().map_or(true, |row| row.stamp_ns() <= until_ns);
    rows.next_if(due).transpose()
}

/// Both sides of `v1 - v0 = integral of (R f) dt + g T`, summed over pieces of a run.
#[derive(Default)]
struct Balance {
    velocity_change: Vector3<f64>,
    specific_force: Vector3<f64>,
    seconds: f64,
}

impl Balance {
    /// Adds a piece of truth without gaps, and the samples in its time.
    fn add(&mut self, rows: &[TruthRow], samples: &[ImuSample]) {
        let track = TruthTrack::new(rows);
        let (Some(begin), Some(end)) = (samples.first(), samples.last()) else { return };
        let (begin, end) = (begin.stamp_ns, end.stamp_ns);
        if end - begin < 4 * END_SPAN_NS {
            return;
        }
        let ends = (velocity(&track, begin, 1), velocity(&track, end, -1));
        let (Some(first), Some(last)) = ends else { return };
        self.velocity_change += last.value - first.value;
        self.specific_force += specific_force_between(&track, samples, first.stamp_ns, last.stamp_ns);
        self.seconds += (last.stamp_ns - first.stamp_ns) as f64 * 1e-9;
    }

    fn gravity(&self) -> Option<Vector3<f64>> {
        (self.seconds > 0.0).then(|| (self.velocity_change - self.specific_force) / self.seconds)
    }
}

struct VelocityAt {
    stamp_ns: i64,
    value: Vector3<f64>,
}

/// The velocity near an end of a stretch (`inwards`: 1 at its beginning, -1 at its end).
fn velocity(track: &TruthTrack<'_>, stamp_ns: i64, inwards: i64) -> Option<VelocityAt> {
    if let Some(value) = track.velocity(stamp_ns, MAX_GAP_NS) {
        return Some(VelocityAt { stamp_ns, value });
    }
    let near = track.pose(stamp_ns, MAX_GAP_NS)?;
    let far = track.pose(stamp_ns + inwards * END_SPAN_NS, MAX_GAP_NS)?;
    let value = (far.translation - near.translation) / (inwards as f64 * END_SPAN_NS as f64 * 1e-9);
    Some(VelocityAt { stamp_ns: stamp_ns + inwards * END_SPAN_NS / 2, value })
}

/// Integral of the specific force in the truth's frame, trapezoidal, over the samples of an interval.
fn specific_force_between(track: &TruthTrack<'_>, samples: &[ImuSample], from: i64, to: i64) -> Vector3<f64> {
    let in_truth_frame = |sample: &ImuSample| {
        track.pose(sample.stamp_ns, MAX_GAP_NS).map(|pose| pose.rotation * sample.accelerometer)
    };
    let mut sum = Vector3::zeros();
    for pair in samples.windows(2) {
        let (begin, end) = (pair[0].stamp_ns.max(from), pair[1].stamp_ns.min(to));
        if begin >= end {
            continue;
        }
        if let (Some(a), Some(b)) = (in_truth_frame(&pair[0]), in_truth_frame(&pair[1])) {
            sum += (a + b) * (0.5e-9 * (end - begin) as f64);
        }
    }
    sum
}
