//! One place or none, where parts of a map were searched by themselves.

use protocol::MatchOutcome;

use super::consensus::is_consistent;
use super::options::RecognitionOptions;
use super::place::RecognizedPlace;

/// What the search of one part of a map found.
#[derive(Clone, Copy, Debug)]
pub struct PartResult<'a> {
    /// Its outcome.
    pub outcome: MatchOutcome,
    /// The place, or the strongest of those that were ambiguous.
    pub place: Option<&'a RecognizedPlace>,
    /// Natural logarithm of the odds that the image is of the place, and not of a picture that repeats.
    pub log_odds: f64,
}

/// Chooses the part whose place explains most features of the image, by the rules of a search in the whole map: another place that
/// explains nearly as many and is not much less likely makes the image ambiguous. Parts that overlap may find the same place.
///
/// # Returns
/// The index of the part.
///
/// # Errors
/// The outcome of the search, where it is not [`MatchOutcome::Matched`].
pub fn choose_part(parts: &[PartResult<'_>], options: &RecognitionOptions) -> Result<usize, MatchOutcome> {
    let matched = |part: &PartResult<'_>| part.outcome == MatchOutcome::Matched;
    let places = parts.iter().enumerate().filter(|(_, part)| matched(part));
    let places = places.filter_map(|(at, part)| Some((at, part.place?)));
    // Of equal support the first.
    let winner = places.reduce(|best, next| if next.1.features > best.1.features { next } else { best });
    let Some((winner, place)) = winner else {
        let rank = |outcome: &MatchOutcome| match outcome {
            MatchOutcome::Ambiguous => 4,
            MatchOutcome::NotVerified => 3,
            MatchOutcome::NoMatch | MatchOutcome::Matched => 2,
            MatchOutcome::TooFewFeatures => 1,
            MatchOutcome::EmptyMap => 0,
        };
        let strongest = parts.iter().map(|part| part.outcome).max_by_key(rank);
        return Err(strongest.unwrap_or(MatchOutcome::NoMatch));
    };
    let least = options.ambiguity_ratio * place.features as f64;
    let is_rival = |part: &PartResult<'_>| {
        part.place.is_some_and(|other| {
            let elsewhere = !is_consistent(&other.global_from_camera, &place.global_from_camera, options);
            let is_less_likely = parts[winner].log_odds - part.log_odds >= options.min_fix_log_odds;
            let explains_as_much = other.features as f64 >= least;
            explains_as_much && !is_less_likely && (elsewhere || part.outcome == MatchOutcome::Ambiguous)
        })
    };
    if parts.iter().any(is_rival) { Err(MatchOutcome::Ambiguous) } else { Ok(winner) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::{Pose, PoseWithCovariance};
    use nalgebra::{Matrix6, Vector3};

    fn place(x: f64, features: usize) -> RecognizedPlace {
        let pose = Pose::new(nalgebra::UnitQuaternion::identity(), Vector3::new(x, 0.0, 0.0));
        let global_from_camera = PoseWithCovariance::new(pose, Matrix6::identity() * 1e-4);
        RecognizedPlace { global_from_camera, features }
    }

    fn chosen(parts: &[(MatchOutcome, Option<RecognizedPlace>)]) -> Result<usize, MatchOutcome> {
        let parts: Vec<_> = parts.iter().map(|(outcome, place)| (*outcome, place.clone(), 5.0)).collect();
        chosen_by_odds(&parts)
    }

    fn chosen_by_odds(parts: &[(MatchOutcome, Option<RecognizedPlace>, f64)]) -> Result<usize, MatchOutcome> {
        let parts: Vec<_> = parts
            .iter()
            .map(|(outcome, place, log_odds)| PartResult {
                outcome: *outcome,
                place: place.as_ref(),
                log_odds: *log_odds,
            })
            .collect();
        choose_part(&parts, &RecognitionOptions::default())
    }

    #[test]
    fn a_rival_that_is_much_less_likely_makes_nothing_ambiguous() {
        use MatchOutcome::{Ambiguous, Matched};
        let matched = |x, features, log_odds| (Matched, Some(place(x, features)), log_odds);
        assert_eq!(chosen_by_odds(&[matched(0.0, 100, 6.0), matched(50.0, 80, 4.1)]), Err(Ambiguous));
        assert_eq!(chosen_by_odds(&[matched(0.0, 100, 6.0), matched(50.0, 80, 4.0)]), Ok(0));
        assert_eq!(chosen_by_odds(&[matched(0.0, 100, 4.0), matched(50.0, 80, 6.0)]), Err(Ambiguous));
        let rival = (Ambiguous, Some(place(9.0, 80)), -3.0);
        assert_eq!(chosen_by_odds(&[matched(0.0, 100, 4.0), rival]), Ok(0));
    }

    #[test]
    fn the_strongest_place_wins_and_a_rival_elsewhere_makes_it_ambiguous() {
        use MatchOutcome::{Ambiguous, Matched, NoMatch, NotVerified, TooFewFeatures};
        let matched = |x, features| (Matched, Some(place(x, features)));
        assert_eq!(chosen(&[matched(0.0, 30), matched(0.05, 40), (NoMatch, None)]), Ok(1));
        assert_eq!(chosen(&[matched(0.0, 40), matched(0.05, 40)]), Ok(0));
        assert_eq!(chosen(&[matched(0.0, 100), matched(50.0, 40)]), Ok(0));
        assert_eq!(chosen(&[matched(0.0, 100), matched(50.0, 80)]), Err(Ambiguous));
        assert_eq!(chosen(&[matched(0.0, 100), (Ambiguous, Some(place(0.0, 80)))]), Err(Ambiguous));
        assert_eq!(chosen(&[matched(0.0, 100), (Ambiguous, Some(place(9.0, 20)))]), Ok(0));
        assert_eq!(chosen(&[(NoMatch, None), (NotVerified, None)]), Err(NotVerified));
        assert_eq!(chosen(&[(TooFewFeatures, None)]), Err(TooFewFeatures));
        assert_eq!(chosen(&[]), Err(NoMatch));
    }
}
