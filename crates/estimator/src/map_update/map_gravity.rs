//! The direction of gravity in G as the map states it, compared with what the images and the IMU say.
//!
//! The pose of an answer by its keyframes alone and the tilt of the state say where gravity points in G. They are compared
//! at a map initialization: afterwards the map has confirmed the tilt. A direction that contradicts both is not used: neither
//! to guide the verification of answers nor to replace a wrong state.

use nalgebra::Vector3;

/// Angle between both directions beyond which one of them is wrong, rad: 20 degrees. The tilt of a filter that was
/// initialized at rest is wrong by 3 degrees at most, that of a map by as much.
const MAX_ANGLE_RAD: f64 = 0.35;
/// Angle between the directions that two answers show, below which they agree, rad. Wrong places do not agree.
const AGREEMENT_RAD: f64 = 0.1;
/// Answers that agree with each other, from which on it is the map that is wrong, and not the answer.
const MIN_AGREEING: usize = 2;

/// A map whose direction of gravity is missing, or not that of the images and the IMU. Unit vectors in G.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "the map {}, the images and the IMU say {}: {} it with --gravity of build-map or import-map",
    .stated.as_ref().map_or_else(
        || "does not say where gravity points".to_owned(),
        |stated| format!("says that gravity points to {}", direction(stated))
    ),
    direction(.seen),
    .stated.as_ref().map_or("state", |_| "correct")
)]
pub struct GravityFault {
    /// As the map states it.
    pub stated: Option<Vector3<f64>>,
    /// According to the images and the IMU.
    pub seen: Vector3<f64>,
}

fn direction(of: &Vector3<f64>) -> String {
    // Adding zero turns -0 into 0.
    let [x, y, z] = [0, 1, 2].map(|k| (100.0 * of[k]).round() / 100.0 + 0.0);
    format!("({x:.2}, {y:.2}, {z:.2})")
}

/// What the answers have shown of the map's direction of gravity.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct MapGravity {
    fault: Option<GravityFault>,
    /// Successive answers that show it.
    agreeing: usize,
}

impl MapGravity {
    /// Compares the direction that an answer states with the one that it shows.
    ///
    /// # Errors
    /// [`GravityFault`]: they contradict each other, and it is not known yet whether the map is wrong, or the answer.
    pub(crate) fn compare(
        &mut self,
        stated: Option<Vector3<f64>>,
        seen: Vector3<f64>,
    ) -> Result<(), GravityFault> {
        let is_wrong = stated.is_none_or(|stated| stated.angle(&seen) > MAX_ANGLE_RAD);
        let agrees = self.fault.is_some_and(|last| last.seen.angle(&seen) < AGREEMENT_RAD);
        self.agreeing = if agrees { self.agreeing + 1 } else { 1 };
        self.fault = is_wrong.then_some(GravityFault { stated, seen });
        match self.fault.filter(|fault| fault.stated.is_some() && self.agreeing < MIN_AGREEING) {
            Some(unconfirmed) => Err(unconfirmed),
            None => Ok(()),
        }
    }

    /// Compares a direction that is seen with one that the map was found to state wrongly: where they agree it was the state that was wrong,
    /// and the fault ends.
    pub(crate) fn review(&mut self, seen: Vector3<f64>) {
        let stated = self.fault().and_then(|fault| fault.stated);
        if stated.is_some_and(|stated| stated.angle(&seen) <= MAX_ANGLE_RAD) {
            *self = Self::default();
        }
    }

    /// What is wrong with the map, once it is known.
    pub(crate) fn fault(&self) -> Option<GravityFault> {
        self.fault.filter(|fault| fault.stated.is_none() || self.agreeing >= MIN_AGREEING)
    }

    /// The direction that an answer states, unless it is known to be wrong. Another one ends the fault: the map was
    /// corrected.
    pub(crate) fn believed(&mut self, stated: Option<Vector3<f64>>) -> Option<Vector3<f64>> {
        let (Some(direction), Some(fault)) = (stated, self.fault()) else { return stated };
        if fault.stated.is_some_and(|wrong| wrong.angle(&direction) <= MAX_ANGLE_RAD) {
            return None;
        }
        *self = Self::default();
        stated
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tilted(angle: f64) -> Vector3<f64> {
        Vector3::new(angle.sin(), 0.0, -angle.cos())
    }

    #[test]
    fn directions_within_twenty_degrees_agree() {
        let (mut map, down) = (MapGravity::default(), Some(-Vector3::z()));
        assert_eq!(map.compare(down, tilted(0.3)), Ok(()));
        assert_eq!((map.fault(), map.believed(down)), (None, down));
    }

    #[test]
    fn a_direction_that_is_seen_after_all_was_not_wrong() {
        let (mut map, up) = (MapGravity::default(), Some(Vector3::z()));
        for seen in [tilted(0.0), tilted(0.05)] {
            let _ = map.compare(up, seen);
        }
        map.review(tilted(0.02));
        assert!(map.fault().is_some());
        map.review(-tilted(0.1));
        assert_eq!((map.fault(), map.believed(up)), (None, up));
    }

    #[test]
    fn a_wrong_direction_is_known_by_the_second_answer_that_shows_it_and_not_used_then() {
        let (mut map, up) = (MapGravity::default(), Some(Vector3::z()));
        for seen in [Vector3::x(), Vector3::y(), tilted(0.0)] {
            assert!(map.compare(up, seen).is_err());
            assert_eq!((map.fault(), map.believed(up)), (None, up));
        }
        assert_eq!(map.compare(up, tilted(0.05)), Ok(()));
        let text = map.fault().unwrap().to_string();
        assert!(text.contains("(0.00, 0.00, 1.00)") && text.contains("(0.05, 0.00, -1.00)"), "{text}");
        assert!(text.contains("correct it with --gravity"), "{text}");
        assert_eq!(map.believed(up), None);
        // The map is corrected while it is served.
        assert_eq!(map.believed(Some(-Vector3::z())), Some(-Vector3::z()));
        assert_eq!(map.fault(), None);
    }

    #[test]
    fn a_missing_direction_is_a_fault_at_once_and_refuses_no_answer() {
        let mut map = MapGravity::default();
        assert_eq!(map.compare(None, tilted(0.0)), Ok(()));
        let text = map.fault().unwrap().to_string();
        assert!(text.contains("does not say") && text.contains("state it with --gravity"), "{text}");
    }
}
