//! A smooth motion through control poses, with exact velocities: a uniform cumulative cubic B-spline.
//!
//! Position and rotation are splined side by side (in R3 and SO(3)): the position then is an ordinary B-spline, whose
//! acceleration does not depend on the rotation, and the derivatives are short.
//!
//! Source: Sommer et al., *Efficient Derivative Computation for Cumulative B-Splines on Lie Groups*, CVPR 2020.

use geometry::pose::Pose;
use geometry::rotation;
use nalgebra::Vector3;

/// A motion as a function of time.
#[derive(Clone, Debug, PartialEq)]
pub struct Spline {
    start_ns: i64,
    knot_ns: i64,
    controls: Vec<Pose>,
}

/// Pose and derivatives of a body at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// The body in the world: `world_from_body`.
    pub pose: Pose,
    /// Velocity in the world, m/s.
    pub velocity: Vector3<f64>,
    /// Acceleration in the world, m/s^2.
    pub acceleration: Vector3<f64>,
    /// Angular velocity in the body, rad/s.
    pub angular_velocity: Vector3<f64>,
}

/// Weights of the three differences between four control poses, and their derivatives by time.
struct Basis {
    value: [f64; 3],
    first: [f64; 3],
    second: [f64; 3],
}

impl Basis {
    /// At the fraction `u` of a segment that lasts `dt` seconds.
    fn at(u: f64, dt: f64) -> Self {
        let (u2, u3, half) = (u * u, u * u * u, 0.5 / dt);
        Self {
            value: [
                (5.0 + 3.0 * u - 3.0 * u2 + u3) / 6.0,
                (1.0 + 3.0 * u + 3.0 * u2 - 2.0 * u3) / 6.0,
                u3 / 6.0,
            ],
            first: [(1.0 - 2.0 * u + u2) * half, (1.0 + 2.0 * u - 2.0 * u2) * half, u2 * half],
            second: [(u - 1.0) / (dt * dt), (1.0 - 2.0 * u) / (dt * dt), u / (dt * dt)],
        }
    }
}

impl Spline {
    /// Through (near) control poses that are `knot_ns` apart.
    ///
    /// The motion begins at `start_ns` near the second control pose and ends near the last but one. `None` for fewer
    /// than four control poses or a knot distance that is not positive.
    pub fn new(start_ns: i64, knot_ns: i64, controls: Vec<Pose>) -> Option<Self> {
        (controls.len() >= 4 && knot_ns > 0).then_some(Self { start_ns, knot_ns, controls })
    }

    /// The same motion, ended at an instant, or up to a knot later.
    pub fn until(&self, end_ns: i64) -> Self {
        let knots = ((end_ns - self.start_ns).max(0) as u64).div_ceil(self.knot_ns as u64) as usize;
        let kept = (knots + 3).clamp(4, self.controls.len());
        Self { controls: self.controls[..kept].to_vec(), ..*self }
    }

    /// When the motion begins, nanoseconds.
    pub fn start_ns(&self) -> i64 {
        self.start_ns
    }

    /// When it ends, nanoseconds.
    pub fn end_ns(&self) -> i64 {
        self.start_ns + (self.controls.len() - 3) as i64 * self.knot_ns
    }

    /// The motion at an instant; before its beginning and after its end, as at these.
    pub fn at(&self, stamp_ns: i64) -> Motion {
        let since = stamp_ns.clamp(self.start_ns, self.end_ns()) - self.start_ns;
        let segment = ((since / self.knot_ns) as usize).min(self.controls.len() - 4);
        let dt = self.knot_ns as f64 * 1e-9;
        let u = (since - segment as i64 * self.knot_ns) as f64 / self.knot_ns as f64;
        let basis = Basis::at(u, dt);
        let controls = &self.controls[segment..segment + 4];
        let mut motion = Motion {
            pose: controls[0],
            velocity: Vector3::zeros(),
            acceleration: Vector3::zeros(),
            angular_velocity: Vector3::zeros(),
        };
        for (index, pair) in controls.windows(2).enumerate() {
            let step = pair[1].translation - pair[0].translation;
            motion.pose.translation += basis.value[index] * step;
            motion.velocity += basis.first[index] * step;
            motion.acceleration += basis.second[index] * step;
            let turn = rotation::log(&(pair[0].rotation.inverse() * pair[1].rotation));
            let partial = rotation::exp(&(turn * basis.value[index]));
            motion.pose.rotation *= partial;
            motion.angular_velocity = partial.inverse() * motion.angular_velocity + turn * basis.first[index];
        }
        motion
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitQuaternion;

    fn winding() -> Spline {
        let control = |index: i32| {
            let t = f64::from(index) * 0.3;
            let position = Vector3::new(t.cos() * 4.0, 2.0 * t, (1.7 * t).sin());
            Pose::new(UnitQuaternion::from_scaled_axis(Vector3::new(t.sin(), 0.4 * t, 0.9 * t)), position)
        };
        Spline::new(1_000, 200_000_000, (0..30).map(control).collect()).unwrap()
    }

    #[test]
    fn velocities_are_the_derivatives_of_the_pose() {
        let spline = winding();
        let step = 20_000;
        for stamp in (spline.start_ns() + step..spline.end_ns() - step).step_by(37_123_457) {
            let (before, now, after) = (spline.at(stamp - step), spline.at(stamp), spline.at(stamp + step));
            let span = 2.0 * step as f64 * 1e-9;
            let velocity = (after.pose.translation - before.pose.translation) / span;
            let acceleration = (after.velocity - before.velocity) / span;
            let turn = rotation::log(&(before.pose.rotation.inverse() * after.pose.rotation)) / span;
            assert!((velocity - now.velocity).amax() < 1e-6);
            assert!((acceleration - now.acceleration).amax() < 1e-3);
            assert!((turn - now.angular_velocity).amax() < 1e-6);
        }
    }

    #[test]
    fn the_motion_is_smooth_across_knots() {
        let spline = winding();
        for knot in 1..26 {
            let stamp = spline.start_ns() + knot * 200_000_000;
            let (before, after) = (spline.at(stamp - 1), spline.at(stamp));
            assert!(before.pose.local(&after.pose).amax() < 1e-7);
            assert!((before.acceleration - after.acceleration).amax() < 1e-6);
            assert!((before.angular_velocity - after.angular_velocity).amax() < 1e-6);
        }
    }

    #[test]
    fn a_constant_velocity_is_kept() {
        let controls = (0..9).map(|i| Pose::new(UnitQuaternion::identity(), Vector3::x() * f64::from(i)));
        let spline = Spline::new(0, 1_000_000_000, controls.collect()).unwrap();
        let motion = spline.at(2_500_000_000);
        assert!((motion.pose.translation.x - 3.5).abs() < 1e-12 && (motion.velocity.x - 1.0).abs() < 1e-12);
        assert!(motion.acceleration.amax() < 1e-12);
        assert_eq!(spline.at(i64::MAX), spline.at(spline.end_ns()));
        assert!(Spline::new(0, 1, vec![Pose::identity(); 3]).is_none());
    }
}
