//! Propagation of the IMU state and its error over an interval of IMU samples.
//!
//! The error is `[δθ, δp, δv, δb_g, δb_a]` with the rotation error in the odometry frame,
//! `R = Exp(δθ) R̂`, so
//! ```text
//! δθ' = -R (δb_g + n_g)     δp' = δv     δv' = -[R a]x δθ - R (δb_a + n_a)     δb' = n_b
//! ```
//! Source of the transition's closed form in terms of the states at both ends: Li & Mourikis, IJRR 2013.

use adjustment::ViewMotion;
use geometry::{Pose, rotation};
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use types::ImuNoise;
use types::ImuSample;

/// Dimension of the IMU error state.
pub const IMU_DIM: usize = 15;
/// Offset of the velocity error in the IMU error state.
pub const VELOCITY: usize = 6;
/// Offset of the gyroscope bias error.
pub const GYROSCOPE_BIAS: usize = 9;
/// Offset of the accelerometer bias error.
pub const ACCELEROMETER_BIAS: usize = 12;

/// Samples further apart than this have a gap between them, seconds. IMUs sample at 100 Hz and more.
const MAX_STEP_S: f64 = 0.05;
/// Standard deviation of the angular velocity in a gap from the linear interpolation between its ends, rad/s.
const GAP_RATE: f64 = 0.5;
/// The same for the specific force, m/s^2.
const GAP_FORCE: f64 = 2.0;
/// Time over which the error of a guess of the motion is alike, seconds.
const GUESSED_S: f64 = 0.1;

/// A 15x15 matrix over the IMU error state.
pub type ImuMatrix = SMatrix<f64, IMU_DIM, IMU_DIM>;
/// An error of the IMU state.
pub type ImuError = SVector<f64, IMU_DIM>;

/// Pose and velocity in L, and the biases.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuState {
    /// IMU pose in L.
    pub local_from_imu: Pose,
    /// Velocity in L, m/s.
    pub velocity: Vector3<f64>,
    /// Gyroscope bias, rad/s.
    pub gyroscope_bias: Vector3<f64>,
    /// Accelerometer bias, m/s^2.
    pub accelerometer_bias: Vector3<f64>,
}

impl ImuState {
    /// At the origin without velocity: where readings are integrated from by themselves.
    pub fn at_rest(gyroscope_bias: Vector3<f64>, accelerometer_bias: Vector3<f64>) -> Self {
        Self {
            local_from_imu: Pose::identity(),
            velocity: Vector3::zeros(),
            gyroscope_bias,
            accelerometer_bias,
        }
    }

    /// Of a pose and a motion of an adjustment.
    pub fn of(local_from_imu: Pose, motion: &ViewMotion) -> Self {
        let ViewMotion { velocity, gyroscope_bias, accelerometer_bias } = *motion;
        Self { local_from_imu, velocity, gyroscope_bias, accelerometer_bias }
    }

    /// Velocity and biases.
    pub fn motion(&self) -> ViewMotion {
        let Self { velocity, gyroscope_bias, accelerometer_bias, .. } = *self;
        ViewMotion { velocity, gyroscope_bias, accelerometer_bias }
    }

    /// Adds an error `[δθ, δp, δv, δb_g, δb_a]`.
    #[must_use]
    pub fn retract(&self, error: &ImuError) -> Self {
        Self {
            local_from_imu: self.local_from_imu.retract(&error.fixed_rows::<6>(0).into()),
            velocity: self.velocity + error.fixed_rows::<3>(VELOCITY),
            gyroscope_bias: self.gyroscope_bias + error.fixed_rows::<3>(GYROSCOPE_BIAS),
            accelerometer_bias: self.accelerometer_bias + error.fixed_rows::<3>(ACCELEROMETER_BIAS),
        }
    }

    /// Whether all values are finite.
    pub fn is_finite(&self) -> bool {
        self.local_from_imu.is_finite()
            && [self.velocity, self.gyroscope_bias, self.accelerometer_bias]
                .iter()
                .all(|vector| vector.iter().all(|value| value.is_finite()))
    }
}

/// The result of [`propagate`].
#[derive(Clone, Copy, Debug)]
pub struct Propagated {
    /// State at the end of the interval.
    pub state: ImuState,
    /// Error transition over the interval.
    pub transition: ImuMatrix,
    /// Process noise covariance of the interval.
    pub noise: ImuMatrix,
}

/// Position and velocity at which the transition is linearized at the begin of the interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionEstimate {
    /// Position in L, metres.
    pub position: Vector3<f64>,
    /// Velocity in L, m/s.
    pub velocity: Vector3<f64>,
}

impl MotionEstimate {
    /// Position and velocity of a state.
    pub fn of(state: &ImuState) -> Self {
        Self { position: state.local_from_imu.translation, velocity: state.velocity }
    }
}

/// Integrates `readings`, the first at the time of the state and the last at the target time.
///
/// The samples are interpolated linearly; one fourth-order Runge-Kutta step per pair of samples.
///
/// # Arguments
/// * `gravity`: magnitude, m/s^2; L has z up.
/// * `first`: first estimates of position and velocity at the begin (first-estimates Jacobians), or the newest ones.
pub fn propagate(
    state: &ImuState,
    first: &MotionEstimate,
    readings: &[ImuSample],
    noise: &ImuNoise,
    gravity: f64,
) -> Propagated {
    let mut propagation = Propagation::new(state, first, noise, gravity);
    for pair in readings.windows(2) {
        propagation.step(&pair[0], &pair[1]);
    }
    propagation.end()
}

/// [`propagate`] one pair of samples at a time.
#[derive(Clone, Debug)]
pub struct Propagation {
    first: MotionEstimate,
    noise: ImuNoise,
    gravity: Vector3<f64>,
    now: ImuState,
    transition: ImuMatrix,
    covariance: ImuMatrix,
    /// Seconds since the begin.
    elapsed: f64,
}

impl Propagation {
    /// Nothing is integrated yet; arguments as those of [`propagate`].
    pub fn new(state: &ImuState, first: &MotionEstimate, noise: &ImuNoise, gravity: f64) -> Self {
        Self {
            first: *first,
            noise: *noise,
            gravity: Vector3::new(0.0, 0.0, -gravity),
            now: *state,
            transition: ImuMatrix::identity(),
            covariance: ImuMatrix::zeros(),
            elapsed: 0.0,
        }
    }

    /// Integrates from `a`, which is where the last step ended, to `b`. Samples of one time change nothing.
    pub fn step(&mut self, a: &ImuSample, b: &ImuSample) {
        self.step_within(a, b, b.stamp_ns - a.stamp_ns);
    }

    /// [`Self::step`] of a part of the time between two readings: images cut a gap in them, and it is as uncertain in parts as in one piece.
    ///
    /// # Arguments
    /// * `spacing_ns`: between the readings that `a` and `b` are interpolated from.
    pub fn step_within(&mut self, a: &ImuSample, b: &ImuSample, spacing_ns: i64) {
        let dt = (b.stamp_ns - a.stamp_ns) as f64 * 1e-9;
        if dt <= 0.0 {
            return;
        }
        let (next, step) = integrate(&self.now, a, b, dt, &self.gravity);
        step.apply(&mut self.transition);
        step.apply(&mut self.covariance);
        self.covariance.transpose_mut();
        step.apply(&mut self.covariance);
        let gap_s = dt.max(spacing_ns as f64 * 1e-9);
        self.covariance += step_noise(&noise_across_gap(&self.noise, gap_s), dt);
        self.now = next;
        self.elapsed += dt;
    }

    /// The result up to now.
    pub fn end(&self) -> Propagated {
        let Self { first, gravity, now, elapsed, .. } = *self;
        let (mut transition, covariance) = (self.transition, self.covariance);
        // The columns of the rotation error in closed form, evaluated at the first estimates.
        let end = &now.local_from_imu.translation;
        let velocity_gain = now.velocity - first.velocity - gravity * elapsed;
        let position_gain =
            end - first.position - first.velocity * elapsed - gravity * (0.5 * elapsed * elapsed);
        transition.fixed_view_mut::<3, 3>(VELOCITY, 0).copy_from(&-rotation::skew(&velocity_gain));
        transition.fixed_view_mut::<3, 3>(3, 0).copy_from(&-rotation::skew(&position_gain));
        Propagated { state: now, transition, noise: (covariance + covariance.transpose()) * 0.5 }
    }
}

/// Error transition of one step: the identity plus these blocks.
struct StepTransition {
    dt: f64,
    rotation_by_gyroscope_bias: Matrix3<f64>,
    position_by_rotation: Matrix3<f64>,
    position_by_gyroscope_bias: Matrix3<f64>,
    position_by_accelerometer_bias: Matrix3<f64>,
    velocity_by_rotation: Matrix3<f64>,
    velocity_by_gyroscope_bias: Matrix3<f64>,
    velocity_by_accelerometer_bias: Matrix3<f64>,
}

impl StepTransition {
    /// `M ← F M`, a third of the operations of the dense product.
    fn apply(&self, matrix: &mut ImuMatrix) {
        for mut column in matrix.column_iter_mut() {
            let part = |begin: usize| -> Vector3<f64> { column.fixed_rows::<3>(begin).into() };
            let (rotation, velocity) = (part(0), part(VELOCITY));
            let (gyroscope, accelerometer) = (part(GYROSCOPE_BIAS), part(ACCELEROMETER_BIAS));
            let rotation_change = self.rotation_by_gyroscope_bias * gyroscope;
            let position_change = self.position_by_rotation * rotation
                + velocity * self.dt
                + self.position_by_gyroscope_bias * gyroscope
                + self.position_by_accelerometer_bias * accelerometer;
            let velocity_change = self.velocity_by_rotation * rotation
                + self.velocity_by_gyroscope_bias * gyroscope
                + self.velocity_by_accelerometer_bias * accelerometer;
            for k in 0..3 {
                column[k] += rotation_change[k];
                column[3 + k] += position_change[k];
                column[VELOCITY + k] += velocity_change[k];
            }
        }
    }
}

/// The state after the time from one sample to another, forward or backward, without its error.
pub(crate) fn advance(
    state: &ImuState,
    from: &ImuSample,
    to: &ImuSample,
    gravity: &Vector3<f64>,
) -> ImuState {
    let dt = (to.stamp_ns - from.stamp_ns) as f64 * 1e-9;
    integrate(state, from, to, dt, gravity).0
}

/// One step between two samples: the new state and the error transition.
fn integrate(
    state: &ImuState,
    a: &ImuSample,
    b: &ImuSample,
    dt: f64,
    gravity: &Vector3<f64>,
) -> (ImuState, StepTransition) {
    let rate = 0.5 * (a.gyroscope + b.gyroscope) - state.gyroscope_bias;
    let force = [a.accelerometer, 0.5 * (a.accelerometer + b.accelerometer), b.accelerometer]
        .map(|reading| reading - state.accelerometer_bias);
    let begin = state.local_from_imu.rotation;
    let middle = begin * rotation::exp(&(rate * (0.5 * dt)));
    let mut end = begin * rotation::exp(&(rate * dt));
    end.renormalize();
    let world = [begin * force[0], middle * force[1], end * force[2]];

    let velocity_gain = (world[0] + 4.0 * world[1] + world[2]) * (dt / 6.0);
    let position_gain = (world[0] + 2.0 * world[1]) * (dt * dt / 6.0);
    let next = ImuState {
        local_from_imu: Pose::new(
            end,
            state.local_from_imu.translation
                + state.velocity * dt
                + position_gain
                + gravity * (0.5 * dt * dt),
        ),
        velocity: state.velocity + velocity_gain + gravity * dt,
        ..*state
    };

    let middle: Matrix3<f64> = middle.to_rotation_matrix().into_inner();
    let lever = rotation::skew(&world[1]);
    let step = StepTransition {
        dt,
        rotation_by_gyroscope_bias: -middle * dt,
        position_by_rotation: -lever * (0.5 * dt * dt),
        position_by_gyroscope_bias: lever * middle * (dt * dt * dt / 6.0),
        position_by_accelerometer_bias: -middle * (0.5 * dt * dt),
        velocity_by_rotation: -lever * dt,
        velocity_by_gyroscope_bias: lever * middle * (0.5 * dt * dt),
        velocity_by_accelerometer_bias: -middle * dt,
    };
    (next, step)
}

/// The noise of readings that are no measurements, but a guess of the motion between two images.
pub(crate) fn noise_of_a_guess(noise: &ImuNoise) -> ImuNoise {
    noise_across_gap(noise, GUESSED_S)
}

/// Noise of a step, increased where there is a gap in the samples, of which the step may be a part: over the whole gap the variance of the turn
/// is `(GAP_RATE gap)^2`, however it is cut.
fn noise_across_gap(noise: &ImuNoise, gap_s: f64) -> ImuNoise {
    if gap_s <= MAX_STEP_S {
        return *noise;
    }
    let increased = |density: f64, deviation: f64| density.hypot(deviation * gap_s.sqrt());
    let mut with_gap = *noise;
    with_gap.gyroscope = increased(noise.gyroscope, GAP_RATE);
    with_gap.accelerometer = increased(noise.accelerometer, GAP_FORCE);
    with_gap
}

/// Variance of the turn about an axis in a step that no readings measure (rad^2); zero for one between readings that follow each other.
pub(crate) fn turn_variance_across_gap(dt: f64) -> f64 {
    if dt <= MAX_STEP_S { 0.0 } else { (GAP_RATE * dt).powi(2) }
}

/// Process noise covariance of one step: white noise and bias random walk.
fn step_noise(noise: &ImuNoise, dt: f64) -> ImuMatrix {
    let mut covariance = ImuMatrix::zeros();
    let mut put = |row: usize, column: usize, value: f64| {
        for k in 0..3 {
            covariance[(row + k, column + k)] = value;
        }
    };
    // Isotropic sensor noise: its rotation into L drops out.
    let force = noise.accelerometer.powi(2);
    put(0, 0, noise.gyroscope.powi(2) * dt);
    put(VELOCITY, VELOCITY, force * dt);
    put(3, VELOCITY, force * dt * dt / 2.0);
    put(VELOCITY, 3, force * dt * dt / 2.0);
    put(3, 3, force * dt * dt * dt / 3.0);
    put(GYROSCOPE_BIAS, GYROSCOPE_BIAS, noise.gyroscope_walk.powi(2) * dt);
    put(ACCELEROMETER_BIAS, ACCELEROMETER_BIAS, noise.accelerometer_walk.powi(2) * dt);
    covariance
}

#[cfg(test)]
mod tests;
