//! Evidence of answers for a hypothesis about `global_from_local`, by the places that they show.
//!
//! `global_from_local` is a constant as long as odometry works, so evidence for it adds up. But answers that show one thing err
//! together: a picture that repeats in another place displaces each of them by the same motion for as long as it is seen. So
//! what was seen counts once, however often it was seen.

use nalgebra::Vector3;

/// Places that are remembered, the newest: after so many different ones a state that the map contradicts without a sign of
/// failure of odometry is given up.
const MAX_PLACES: usize = 24;

/// What an answer shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeenPlace {
    /// Mean position of its landmarks in G, metres.
    centre: Vector3<f64>,
    /// Root mean square of their distances from it, metres.
    spread: f64,
    /// Logarithm of its odds, as the server states them.
    log_odds: f64,
}

impl SeenPlace {
    /// What the inliers of an answer show.
    ///
    /// # Arguments
    /// * `landmarks`: their positions in G, metres; not empty.
    /// * `log_odds`: of the answer, negative ones are evidence against it.
    pub fn of(landmarks: &[Vector3<f64>], log_odds: f64) -> Self {
        let count = landmarks.len().max(1) as f64;
        let centre = landmarks.iter().sum::<Vector3<f64>>() / count;
        let variance = landmarks.iter().map(|at| (at - centre).norm_squared()).sum::<f64>() / count;
        Self { centre, spread: variance.sqrt(), log_odds }
    }

    /// Whether it shows the same as another one: their landmarks overlap.
    fn is_same(&self, other: &Self) -> bool {
        (self.centre - other.centre).norm() <= self.spread.max(other.spread)
    }
}

/// The different places that support a hypothesis.
#[derive(Clone, Debug, Default)]
pub struct PlaceEvidence {
    places: Vec<SeenPlace>,
}

impl PlaceEvidence {
    /// Adds what an answer shows. Answers of one place err together: of them the one that shows most counts, as the robot comes
    /// nearer.
    pub fn add(&mut self, seen: SeenPlace) {
        if let Some(before) = self.places.iter_mut().find(|before| before.is_same(&seen)) {
            before.log_odds = before.log_odds.max(seen.log_odds);
            return;
        }
        if self.places.len() == MAX_PLACES {
            self.places.remove(0);
        }
        self.places.push(seen);
    }

    /// Forgets all of it: odometry failed since, or there is another hypothesis.
    pub fn clear(&mut self) {
        self.places.clear();
    }

    /// Logarithm of the odds of all of it.
    pub fn log_odds(&self) -> f64 {
        self.places.iter().map(|place| place.log_odds).sum()
    }
}

impl FromIterator<SeenPlace> for PlaceEvidence {
    fn from_iter<T: IntoIterator<Item = SeenPlace>>(seen: T) -> Self {
        let mut evidence = Self::default();
        seen.into_iter().for_each(|seen| evidence.add(seen));
        evidence
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Landmarks in rows of ten on a square of a wall, metres.
    fn wall(x: f64, width: f64, count: usize) -> SeenPlace {
        let rows = (count / 10) as f64;
        let at = |k: usize| {
            Vector3::new(x + width * (k % 10) as f64 / 9.0, 0.0, width * ((k / 10) as f64 + 0.5) / rows)
        };
        SeenPlace::of(&(0..count).map(at).collect::<Vec<_>>(), 0.02 * count as f64)
    }

    #[test]
    fn one_picture_counts_once_however_often_it_is_seen() {
        let mut evidence = PlaceEvidence::default();
        for k in 0..50 {
            evidence.add(wall(0.005 * f64::from(k), 1.0, 100));
        }
        assert!((evidence.log_odds() - wall(0.0, 1.0, 100).log_odds).abs() < 1e-12);
    }

    #[test]
    fn different_places_add_up_to_a_bound() {
        let seen =
            |places: usize| -> PlaceEvidence { (0..places).map(|k| wall(3.0 * k as f64, 1.0, 50)).collect() };
        assert!((seen(10).log_odds() - 10.0 * seen(1).log_odds()).abs() < 1e-9);
        assert!((seen(100).log_odds() - seen(MAX_PLACES).log_odds()).abs() < 1e-12);
    }

    #[test]
    fn the_best_answer_of_a_place_counts_and_negative_ones_count_against() {
        let of = |x: f64, log_odds: f64| {
            let at = Vector3::new(x, 0.0, 0.0);
            SeenPlace::of(&[at - Vector3::x(), at + Vector3::x()], log_odds)
        };
        let one_place: PlaceEvidence =
            [4.0, -1.0, 3.0].map(|log_odds| of(0.0, log_odds)).into_iter().collect();
        assert!((one_place.log_odds() - 4.0).abs() < 1e-12);
        let two_places: PlaceEvidence = [of(0.0, 4.0), of(5.0, -3.0)].into_iter().collect();
        assert!((two_places.log_odds() - 1.0).abs() < 1e-12);
    }
}
