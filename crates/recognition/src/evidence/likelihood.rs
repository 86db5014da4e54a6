//! How likely a coverage is at the right place, and where a picture repeats.

/// Shapes of the beta distribution of the share of the expected parts that are confirmed at the right place: rather all of them
/// than few, where most of the place has changed since.
const SHARE_AT_THE_PLACE: [f64; 2] = [2.0, 1.0];
/// Mean number of parts that a repeated picture confirms, as a share of all parts, and the dispersion of its negative binomial
/// distribution. It confirms as many however many are expected.
const PICTURE_SHARE: f64 = 1.0 / 8.0;
const PICTURE_DISPERSION: f64 = 10.0;
/// Share of the pictures that confirm all that they fill, and the dispersion of that number: at least so many, and the more the more
/// of the image they fill, since little of their surroundings is left that could differ.
const LARGE_PICTURES: f64 = 0.1;
const LARGE_PICTURE_DISPERSION: f64 = 2.0;

/// Natural logarithm of the likelihood of the right place over that of a picture that repeats.
///
/// At the right place the *share* of the expected parts that is confirmed is a matter of what has changed; it is integrated out
/// (beta-binomial), because neighbouring parts show the same object. Where a picture repeats, the *number* is that of the
/// parts that it confirms: few whatever it fills, since its surroundings hide or shift most of it, or as many as it fills. Where
/// little is expected the two say the same, and the ratio is about one.
///
/// # Arguments
/// * `confirmed`: parts of the image in which matches confirm what the map expects.
/// * `expected`: parts in which it expects something, those included.
/// * `parts`: all parts of the image.
/// * `picture`: parts that a large picture fills where the inliers are.
pub(super) fn log_likelihood_ratio(confirmed: usize, expected: usize, parts: usize, picture: f64) -> f64 {
    let mean = (PICTURE_SHARE * parts as f64).max(1.0);
    let usual = log_of_a_picture(confirmed, expected, mean, PICTURE_DISPERSION);
    let large = log_of_a_picture(confirmed, expected, picture.max(mean), LARGE_PICTURE_DISPERSION);
    let share = share_of_large_pictures(picture / parts.max(1) as f64);
    let of_a_picture = (1.0 - share) * usual.exp() + share * large.exp();
    log_at_the_place(confirmed, expected) - of_a_picture.ln()
}

/// Of pictures that fill so much of the image, the share that confirm all of it.
fn share_of_large_pictures(filled: f64) -> f64 {
    filled.clamp(0.0, 1.0).powi(3).max(LARGE_PICTURES)
}

/// Beta-binomial.
fn log_at_the_place(confirmed: usize, expected: usize) -> f64 {
    let [a, b] = SHARE_AT_THE_PLACE;
    let missing = expected.saturating_sub(confirmed);
    log_rising(a, confirmed) + log_rising(b, missing) - log_rising(a + b, confirmed + missing)
        + log_rising(1.0 + missing as f64, confirmed)
        - log_rising(1.0, confirmed)
}

/// Negative binomial, among what the expected parts allow.
fn log_of_a_picture(confirmed: usize, expected: usize, mean: f64, dispersion: f64) -> f64 {
    let log_share = (mean / (mean + dispersion)).ln();
    let log_of =
        |count: usize| log_rising(dispersion, count) - log_rising(1.0, count) + log_share * count as f64;
    log_of(confirmed) - (0..=expected.max(confirmed)).map(|count| log_of(count).exp()).sum::<f64>().ln()
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

    /// Of a picture far away.
    fn ratio(confirmed: usize, expected: usize) -> f64 {
        log_likelihood_ratio(confirmed, expected, PARTS, 0.0)
    }

    #[test]
    fn nothing_expected_says_nothing() {
        assert!(ratio(0, 0).abs() < 1e-12);
    }

    #[test]
    fn likelihoods_of_all_outcomes_sum_to_one() {
        for expected in [1, 7, 48] {
            let sum_of = |log: &dyn Fn(usize) -> f64| -> f64 { (0..=expected).map(|k| log(k).exp()).sum() };
            let mut sums = vec![sum_of(&|confirmed| log_at_the_place(confirmed, expected))];
            for (mean, dispersion) in [(6.0, PICTURE_DISPERSION), (15.0, 2.0), (48.0, 2.0)] {
                sums.push(sum_of(&|k| log_of_a_picture(k, expected, mean, dispersion)));
            }
            assert!(sums.iter().all(|sum| (sum - 1.0).abs() < 1e-9), "{expected}: {sums:?}");
        }
    }

    #[test]
    fn beyond_the_size_of_a_picture_each_confirmed_part_speaks_for_the_place() {
        for expected in 20..=PARTS {
            for confirmed in PARTS / 8..expected {
                assert!(
                    ratio(confirmed + 1, expected) > ratio(confirmed, expected),
                    "{confirmed} of {expected}"
                );
            }
        }
    }

    #[test]
    fn a_picture_in_a_full_image_is_no_place_and_where_little_is_expected_nothing_is_known() {
        assert!(ratio(4, 40) < -2.5);
        assert!(ratio(20, 40) > 2.0);
        for expected in 0..=6 {
            assert!(
                (-0.2..1.5).contains(&ratio(expected, expected)),
                "all of {expected}: {}",
                ratio(expected, expected)
            );
        }
    }

    #[test]
    fn what_a_picture_confirms_by_itself_bounds_what_that_says() {
        for expected in [30, PARTS] {
            let at_the_place = log_at_the_place(expected, expected);
            for picture in 6..=PARTS {
                let share = share_of_large_pictures(picture as f64 / PARTS as f64);
                let large = log_of_a_picture(expected, expected, picture as f64, LARGE_PICTURE_DISPERSION);
                let found = log_likelihood_ratio(expected, expected, PARTS, picture as f64);
                assert!(found <= at_the_place - large - share.ln() + 1e-12, "{picture}");
            }
        }
    }

    #[test]
    fn a_picture_that_fills_the_image_is_as_good_as_the_place() {
        for confirmed in 20..=PARTS {
            let near = log_likelihood_ratio(confirmed, PARTS, PARTS, PARTS as f64);
            assert!(near < 1.0, "{confirmed}: {near}");
            assert!(near < 0.3 * ratio(confirmed, PARTS), "{confirmed}: {near}");
        }
    }
}
