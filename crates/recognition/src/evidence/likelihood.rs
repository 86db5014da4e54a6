//! How likely a coverage is at the right place, and where a picture repeats.

use super::coverage::{Coverage, PartCounts};

/// Shapes of the beta distribution of the share of the expected parts that are confirmed at the right place: rather all of them
/// than few, where most of the place has changed since.
const SHARE_AT_THE_PLACE: [f64; 2] = [2.0, 1.0];
/// The same of the parts beyond the picture in which most inliers are: any share.
const SHARE_BEYOND: [f64; 2] = [1.0, 1.0];
/// Mean number of parts that a repeated picture confirms, as a share of all parts, and the dispersion of its negative binomial
/// distribution. It confirms as many however many are expected.
const PICTURE_SHARE: f64 = 1.0 / 8.0;
const PICTURE_DISPERSION: f64 = 10.0;
/// Share of the pictures that confirm all that they fill, and the dispersion of that number: at least so many, and the more the more
/// of the image they fill, since little of their surroundings is left that could differ.
const LARGE_PICTURES: f64 = 0.1;
const LARGE_PICTURE_DISPERSION: f64 = 2.0;
/// Parts that any of them fills: it lies across the border of two.
const LEAST_LARGE_PICTURE: f64 = 2.0;

/// Natural logarithm of the likelihood of the right place over that of a picture that repeats.
///
/// Most inliers may be of one picture, at either place. At the right one the *share* of the expected parts that is confirmed is a
/// matter of what has changed; it is integrated out (beta-binomial), because neighbouring parts show the same object, for the parts of
/// the picture and for those beyond it, which change independently. Where a picture repeats, the *number* is that of the
/// parts that it confirms: few whatever it fills, since its surroundings hide or shift most of it, and hardly any beyond it; or it is
/// large and confirms as many as it fills, wherever these are. Where little is expected the two say the same, and the ratio is about
/// one.
pub(super) fn log_likelihood_ratio(coverage: &Coverage) -> f64 {
    let Coverage { within_picture, beyond_picture, parts, picture, chance_beyond } = *coverage;
    let mean = (PICTURE_SHARE * parts as f64).max(1.0);
    let over_usual = log_at_the_place(within_picture, SHARE_AT_THE_PLACE)
        - log_of_a_picture(within_picture, mean, PICTURE_DISPERSION)
        + log_at_the_place(beyond_picture, SHARE_BEYOND)
        - log_beyond_a_picture(beyond_picture, chance_beyond);
    let whole = coverage.of_image();
    let over_large = log_at_the_place(whole, SHARE_AT_THE_PLACE)
        - log_of_a_picture(whole, picture.max(LEAST_LARGE_PICTURE), LARGE_PICTURE_DISPERSION);
    let share = share_of_large_pictures(picture / parts.max(1) as f64);
    -((1.0 - share) * (-over_usual).exp() + share * (-over_large).exp()).ln()
}

/// Of pictures that fill so much of the image, the share that confirm all of it.
fn share_of_large_pictures(filled: f64) -> f64 {
    filled.clamp(0.0, 1.0).powi(3).max(LARGE_PICTURES)
}

/// Beta-binomial.
fn log_at_the_place(counts: PartCounts, [a, b]: [f64; 2]) -> f64 {
    let missing = counts.expected.saturating_sub(counts.confirmed);
    log_rising(a, counts.confirmed) + log_rising(b, missing) - log_rising(a + b, counts.confirmed + missing)
        + log_rising(1.0 + missing as f64, counts.confirmed)
        - log_rising(1.0, counts.confirmed)
}

/// Negative binomial, among what the expected parts allow.
fn log_of_a_picture(counts: PartCounts, mean: f64, dispersion: f64) -> f64 {
    let log_share = (mean / (mean + dispersion)).ln();
    let log_of =
        |count: usize| log_rising(dispersion, count) - log_rising(1.0, count) + log_share * count as f64;
    log_among_expected(counts, log_of)
}

/// Geometric, among what the expected parts allow.
fn log_beyond_a_picture(counts: PartCounts, chance: f64) -> f64 {
    log_among_expected(counts, |count| chance.powi(count as i32).ln())
}

/// A distribution of the number of confirmed parts, among what the expected parts allow.
///
/// # Arguments
/// * `log_of`: the logarithm of the probability of a number, up to a constant.
fn log_among_expected(counts: PartCounts, log_of: impl Fn(usize) -> f64) -> f64 {
    let all = 0..=counts.expected.max(counts.confirmed);
    log_of(counts.confirmed) - all.map(|count| log_of(count).exp()).sum::<f64>().ln()
}

/// Logarithm of `from (from + 1) ... (from + count - 1)`.
fn log_rising(from: f64, count: usize) -> f64 {
    (0..count).map(|k| (from + k as f64).ln()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Those of the finest grid.
    const PARTS: usize = 48;
    const CHANCE: f64 = 0.3;

    fn counts(confirmed: usize, expected: usize) -> PartCounts {
        PartCounts { expected, confirmed }
    }

    /// Confirmed and expected parts of a picture, of the rest, and parts that two square metres fill.
    fn ratio(within: [usize; 2], beyond: [usize; 2], picture: f64) -> f64 {
        let [within_picture, beyond_picture] =
            [within, beyond].map(|[confirmed, expected]| counts(confirmed, expected));
        let coverage =
            Coverage { within_picture, beyond_picture, parts: PARTS, picture, chance_beyond: CHANCE };
        log_likelihood_ratio(&coverage)
    }

    #[test]
    fn nothing_expected_says_nothing() {
        assert!(ratio([0, 0], [0, 0], 0.0).abs() < 1e-12);
    }

    #[test]
    fn likelihoods_of_all_outcomes_sum_to_one() {
        for expected in [1, 7, 48] {
            let sum_of = |log: &dyn Fn(PartCounts) -> f64| -> f64 {
                (0..=expected).map(|k| log(counts(k, expected)).exp()).sum()
            };
            let mut sums = vec![sum_of(&|counts| log_beyond_a_picture(counts, CHANCE))];
            for shapes in [SHARE_AT_THE_PLACE, SHARE_BEYOND] {
                sums.push(sum_of(&|counts| log_at_the_place(counts, shapes)));
            }
            for (mean, dispersion) in [(6.0, PICTURE_DISPERSION), (15.0, 2.0), (48.0, 2.0)] {
                sums.push(sum_of(&|counts| log_of_a_picture(counts, mean, dispersion)));
            }
            assert!(sums.iter().all(|sum| (sum - 1.0).abs() < 1e-9), "{expected}: {sums:?}");
        }
    }

    #[test]
    fn each_confirmed_part_beyond_the_picture_speaks_for_the_place() {
        for expected in 10..=40 {
            for confirmed in 0..expected {
                let of = |confirmed| ratio([4, 5], [confirmed, expected], 3.0);
                assert!(of(confirmed + 1) > of(confirmed), "{confirmed} of {expected}");
            }
        }
    }

    #[test]
    fn parts_of_several_things_are_a_place_though_most_has_changed_and_those_of_one_are_none() {
        assert!(ratio([4, 6], [8, 34], 3.0) > 1.5);
        assert!(ratio([6, 6], [0, 34], 3.0) < -1.0);
        assert!(ratio([4, 6], [1, 34], 3.0) < -1.0);
        for expected in 0..=6 {
            let all = ratio([expected, expected], [0, 0], 0.0);
            assert!((-0.2..1.5).contains(&all), "all of {expected}: {all}");
        }
    }

    #[test]
    fn what_a_large_picture_confirms_bounds_what_that_says() {
        for expected in [30, PARTS] {
            let whole = counts(expected, expected);
            let at_the_place = log_at_the_place(whole, SHARE_AT_THE_PLACE);
            for picture in 2..=PARTS {
                let share = share_of_large_pictures(picture as f64 / PARTS as f64);
                let large = log_of_a_picture(whole, picture as f64, LARGE_PICTURE_DISPERSION);
                let found = ratio([6, 6], [expected - 6, expected - 6], picture as f64);
                assert!(found <= at_the_place - large - share.ln() + 1e-12, "{picture}");
            }
        }
    }

    #[test]
    fn a_picture_that_fills_the_image_is_as_good_as_the_place() {
        for confirmed in 20..=PARTS {
            let near = ratio([confirmed, PARTS], [0, 0], PARTS as f64);
            assert!(near < 1.0, "{confirmed}: {near}");
        }
        assert!(ratio([30, 40], [5, 8], PARTS as f64) < 1.0);
    }
}
