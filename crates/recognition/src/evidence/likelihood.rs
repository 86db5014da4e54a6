//! How likely a coverage is at the right place, and where a picture repeats.

/// Shapes of the beta distribution of the share of the expected parts that are confirmed at the right place: rather all of them
/// than few, where most of the place has changed since.
const SHARE_AT_THE_PLACE: [f64; 2] = [2.0, 1.0];
/// Number of parts of an image that a repeated picture fills, negative binomial: the least mean as a share of all parts, and its
/// dispersion. It confirms as many however many are expected.
const PICTURE_SHARE: f64 = 1.0 / 12.0;
const PICTURE_DISPERSION: f64 = 2.0;

/// Natural logarithm of the likelihood of the right place over that of a picture that repeats.
///
/// At the right place the *share* of the expected parts that is confirmed is a matter of what has changed; it is integrated out
/// (beta-binomial), because neighbouring parts show the same object. Where a picture repeats, the *number* is that of the
/// parts that the picture fills. Where little is expected the two say the same, and the ratio is about one.
///
/// # Arguments
/// * `confirmed`: parts of the image in which matches confirm what the map expects.
/// * `expected`: parts in which it expects something, those included.
/// * `least_picture`: parts that a picture fills in the mean that is far away.
/// * `picture`: parts that it fills where the inliers are.
pub(super) fn log_likelihood_ratio(
    confirmed: usize,
    expected: usize,
    least_picture: f64,
    picture: f64,
) -> f64 {
    let at_the_place = log_at_the_place(confirmed, expected);
    let against = |picture: f64| at_the_place - log_of_a_picture(confirmed, expected, picture);
    // A large picture explains many parts as well as the place does. That is no evidence for it: few parts fit into both.
    let against_least = against(least_picture);
    if against_least <= 0.0 {
        against_least
    } else {
        against(picture.max(least_picture)).clamp(0.0, against_least)
    }
}

/// The least mean number of parts, of so many, that a picture fills.
pub(super) fn least_picture(parts: usize) -> f64 {
    (PICTURE_SHARE * parts as f64).max(1.0)
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
fn log_of_a_picture(confirmed: usize, expected: usize, picture: f64) -> f64 {
    let log_share = (picture / (picture + PICTURE_DISPERSION)).ln();
    let log_of = |count: usize| {
        log_rising(PICTURE_DISPERSION, count) - log_rising(1.0, count) + log_share * count as f64
    };
    log_of(confirmed) - (0..=expected.max(confirmed)).map(|count| log_of(count).exp()).sum::<f64>().ln()
}

/// Logarithm of `from (from + 1) ... (from + count - 1)`.
fn log_rising(from: f64, count: usize) -> f64 {
    (0..count).map(|k| (from + k as f64).ln()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// That of the finest grid.
    const LEAST_PICTURE: f64 = 4.0;

    #[test]
    fn nothing_expected_says_nothing() {
        assert!(log_likelihood_ratio(0, 0, LEAST_PICTURE, LEAST_PICTURE).abs() < 1e-12);
    }

    #[test]
    fn likelihoods_of_all_outcomes_sum_to_one() {
        for expected in [1, 7, 48] {
            let sum_of = |log: &dyn Fn(usize) -> f64| -> f64 { (0..=expected).map(|k| log(k).exp()).sum() };
            let mut sums = vec![sum_of(&|confirmed| log_at_the_place(confirmed, expected))];
            sums.extend([4.0, 15.0, 48.0].map(|picture| sum_of(&|k| log_of_a_picture(k, expected, picture))));
            assert!(sums.iter().all(|sum| (sum - 1.0).abs() < 1e-9), "{expected}: {sums:?}");
        }
    }

    #[test]
    fn beyond_the_size_of_a_picture_each_confirmed_part_speaks_for_the_place() {
        for expected in 20..=48 {
            for confirmed in LEAST_PICTURE as usize..expected {
                let ratio = log_likelihood_ratio(confirmed, expected, LEAST_PICTURE, LEAST_PICTURE);
                assert!(
                    log_likelihood_ratio(confirmed + 1, expected, LEAST_PICTURE, LEAST_PICTURE) > ratio,
                    "{confirmed} of {expected}"
                );
            }
        }
    }

    #[test]
    fn a_picture_in_a_full_image_is_no_place_and_where_little_is_expected_nothing_is_known() {
        assert!(log_likelihood_ratio(4, 40, LEAST_PICTURE, LEAST_PICTURE) < -2.5);
        assert!(log_likelihood_ratio(20, 40, LEAST_PICTURE, LEAST_PICTURE) > 3.0);
        for expected in 0..=6 {
            assert!(
                (0.0..1.5).contains(&log_likelihood_ratio(expected, expected, LEAST_PICTURE, LEAST_PICTURE)),
                "all of {expected}"
            );
        }
    }

    #[test]
    fn the_nearer_a_picture_the_less_what_it_fills_says() {
        for picture in 4..40 {
            let of = |picture: i32| log_likelihood_ratio(24, 30, LEAST_PICTURE, f64::from(picture));
            assert!(of(picture + 1) <= of(picture) && of(picture) >= 0.0, "{picture}");
        }
        assert!(
            log_likelihood_ratio(24, 30, LEAST_PICTURE, 40.0)
                < 0.2 * log_likelihood_ratio(24, 30, LEAST_PICTURE, LEAST_PICTURE)
        );
    }
}
