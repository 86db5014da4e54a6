//! Times as decimal numbers, to the nanosecond: a double cannot hold a time of day that exactly.

const NANOSECONDS: i64 = 1_000_000_000;

/// Nanoseconds as seconds with 9 decimals.
pub fn seconds(stamp_ns: i64) -> String {
    let sign = if stamp_ns < 0 { "-" } else { "" };
    let magnitude = stamp_ns.unsigned_abs();
    let nanoseconds = NANOSECONDS.unsigned_abs();
    format!("{sign}{}.{:09}", magnitude / nanoseconds, magnitude % nanoseconds)
}

/// Seconds in decimal, with or without exponent, as nanoseconds; what lies below a nanosecond is rounded.
pub fn nanoseconds(text: &str) -> Option<i64> {
    decimal(text, 9)
}

/// A decimal number times a power of ten, rounded to a whole number.
pub(super) fn decimal(text: &str, places: i32) -> Option<i64> {
    let (mantissa, exponent) = match text.split_once(['e', 'E']) {
        Some((mantissa, exponent)) => (mantissa, exponent.parse::<i32>().ok()?),
        None => (text, 0),
    };
    let (negative, mantissa) = match mantissa.strip_prefix('-') {
        Some(rest) => (true, rest),
        None => (false, mantissa.strip_prefix('+').unwrap_or(mantissa)),
    };
    let (whole, fraction) = mantissa.split_once('.').unwrap_or((mantissa, ""));
    if whole.is_empty() && fraction.is_empty() {
        return None;
    }
    // The number is 0.d1 d2 d3 ... times 10^point.
    let point = i32::try_from(whole.len()).ok()?.checked_add(exponent)?;
    let last = point.checked_add(places)?;
    let mut value: i64 = 0;
    let mut digits = whole.bytes().chain(fraction.bytes());
    for _ in 0..last.clamp(0, 400) {
        let digit = digits.next().unwrap_or(b'0');
        if !digit.is_ascii_digit() {
            return None;
        }
        value = value.checked_mul(10)?.checked_add(i64::from(digit - b'0'))?;
    }
    let rest: Vec<u8> = digits.collect();
    if !rest.iter().all(u8::is_ascii_digit) {
        return None;
    }
    if last >= 0 && rest.first().is_some_and(|digit| *digit >= b'5') {
        value = value.checked_add(1)?;
    }
    Some(if negative { -value } else { value })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn no_nanosecond_is_lost(stamp_ns in any::<i64>()) {
            prop_assume!(stamp_ns != i64::MIN);
            prop_assert_eq!(nanoseconds(&seconds(stamp_ns)), Some(stamp_ns));
        }

        #[test]
        fn no_text_makes_it_panic(text in "[-+0-9.eE]{0,24}") {
            let _ = nanoseconds(&text);
        }
    }

    #[test]
    fn every_spelling_of_a_time_is_understood() {
        for (text, expected) in [
            ("1403636580.838555574", Some(1_403_636_580_838_555_574)),
            ("1.403636580838555574e+09", Some(1_403_636_580_838_555_574)),
            ("1403636580.83855", Some(1_403_636_580_838_550_000)),
            ("12", Some(12_000_000_000)),
            (".5", Some(500_000_000)),
            ("1e-9", Some(1)),
            ("0.0000000015", Some(2)),
            ("1e-12", Some(0)),
            ("-1.5", Some(-1_500_000_000)),
            ("1e99", None),
            ("", None),
            (".", None),
            ("abc", None),
            ("1.2.3", None),
            ("nan", None),
        ] {
            assert_eq!(nanoseconds(text), expected, "{text}");
        }
    }

    #[test]
    fn other_units_are_shifted() {
        for (text, places, expected) in [
            ("1403636584788560000.000000", 0, Some(1_403_636_584_788_560_000)),
            ("1.403636584788559872e+18", 0, Some(1_403_636_584_788_559_872)),
            ("1403636584788560", 3, Some(1_403_636_584_788_560_000)),
            ("1403636584788.56", 6, Some(1_403_636_584_788_560_000)),
        ] {
            assert_eq!(decimal(text, places), expected, "{text}");
        }
    }
}
