//! Evidence of answers for a hypothesis about `global_from_local`, by the places that they show.
//!
//! `global_from_local` is a constant as long as odometry works, so evidence for it adds up. But answers that show one thing err
//! together: a picture that repeats in another place displaces each of them by the same motion for as long as it is seen. So
//! what was seen counts once, however often it was seen.

use nalgebra::Vector3;

/// Places that are remembered, the newest: after so many different ones a state that the map contradicts without a sign of
/// failure of odometry is given up.
const MAX_PLACES: usize = 24;
/// Size of a thing that a building has more than once, metres: what is nearer to each other may be one.
const PICTURE_M: f64 = 2.0;

/// What an answer shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeenPlace {
    /// Mean position of its landmarks in G, metres.
    centre: Vector3<f64>,
    /// Root mean square of their distances from it, metres.
    spread: f64,
    /// Logarithm of the likelihood ratio of what is seen there.
    log_ratio: f64,
    /// Answers whose mean that is.
    answers: f64,
    /// Logarithm of the odds before it is seen.
    log_prior_odds: f64,
}

impl SeenPlace {
    /// What the inliers of an answer show.
    ///
    /// # Arguments
    /// * `landmarks`: their positions in G, metres; not empty.
    /// * `log_ratio`: of the answer, negative ones are evidence against it.
    /// * `log_prior_odds`: those of the map.
    pub fn of(landmarks: &[Vector3<f64>], log_ratio: f64, log_prior_odds: f64) -> Self {
        let count = landmarks.len().max(1) as f64;
        let centre = landmarks.iter().sum::<Vector3<f64>>() / count;
        let variance = landmarks.iter().map(|at| (at - centre).norm_squared()).sum::<f64>() / count;
        Self { centre, spread: variance.sqrt(), log_ratio, answers: 1.0, log_prior_odds }
    }

    /// The same with a likelihood ratio that is smaller by a factor.
    ///
    /// # Arguments
    /// * `log_factor`: its natural logarithm.
    pub fn less_likely_by(self, log_factor: f64) -> Self {
        Self { log_ratio: self.log_ratio - log_factor, ..self }
    }

    /// Whether it shows the same as another one: their landmarks overlap, or may be those of one picture.
    fn is_same(&self, other: &Self) -> bool {
        (self.centre - other.centre).norm() <= self.spread.max(other.spread).max(PICTURE_M)
    }
}

/// The different places that support a hypothesis.
#[derive(Clone, Debug, Default)]
pub struct PlaceEvidence {
    places: Vec<SeenPlace>,
}

impl PlaceEvidence {
    /// Adds what an answer shows. The errors of answers of one place are correlated: of them the mean counts. The best of many would be
    /// large by chance, however likely a picture that repeats is.
    pub fn add(&mut self, seen: SeenPlace) {
        if let Some(before) = self.places.iter_mut().find(|before| before.is_same(&seen)) {
            before.answers += 1.0;
            before.log_ratio += (seen.log_ratio - before.log_ratio) / before.answers;
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

    /// Logarithm of the odds of all of it. Those before anything is seen count once: what repeats in a building often does so side by
    /// side, at one displacement.
    pub fn log_odds(&self) -> f64 {
        let prior = self.places.last().map_or(0.0, |place| place.log_prior_odds);
        prior + self.places.iter().map(|place| place.log_ratio).sum::<f64>()
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
        SeenPlace::of(&(0..count).map(at).collect::<Vec<_>>(), 0.02 * count as f64, 0.0)
    }

    #[test]
    fn one_picture_counts_once_however_often_it_is_seen() {
        let mut evidence = PlaceEvidence::default();
        for k in 0..50 {
            evidence.add(wall(0.005 * f64::from(k), 1.0, 100));
        }
        assert!((evidence.log_odds() - wall(0.0, 1.0, 100).log_ratio).abs() < 1e-12);
    }

    #[test]
    fn different_places_add_up_to_a_bound() {
        let seen =
            |places: usize| -> PlaceEvidence { (0..places).map(|k| wall(3.0 * k as f64, 1.0, 50)).collect() };
        assert!((seen(10).log_odds() - 10.0 * seen(1).log_odds()).abs() < 1e-9);
        assert!((seen(100).log_odds() - seen(MAX_PLACES).log_odds()).abs() < 1e-12);
    }

    #[test]
    fn the_mean_of_the_answers_of_a_place_counts_and_negative_ones_count_against() {
        let of = |x: f64, log_odds: f64| {
            let at = Vector3::new(x, 0.0, 0.0);
            SeenPlace::of(&[at - Vector3::x(), at + Vector3::x()], log_odds, 0.0)
        };
        let one_place: PlaceEvidence =
            [4.0, -1.0, 3.0].map(|log_odds| of(0.0, log_odds)).into_iter().collect();
        assert!((one_place.log_odds() - 2.0).abs() < 1e-12);
        let two_places: PlaceEvidence = [of(0.0, 4.0), of(5.0, -3.0)].into_iter().collect();
        assert!((two_places.log_odds() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn the_odds_of_the_map_count_once() {
        let of = |x: f64| SeenPlace::of(&[Vector3::new(x, 0.0, 0.0), Vector3::new(x, 1.0, 0.0)], 0.5, 1.5);
        let three: PlaceEvidence = [0.0, 5.0, 10.0].map(of).into_iter().collect();
        assert!((three.log_odds() - 3.0).abs() < 1e-12);
        assert!(PlaceEvidence::default().log_odds().abs() < 1e-12);
    }
}
