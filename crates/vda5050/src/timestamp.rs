//! Times as VDA 5050 writes them.

use std::time::{SystemTime, UNIX_EPOCH};
use time::OffsetDateTime;

/// A time in UTC as `2017-04-15T11:40:03.12Z`; times before 1970 are written as 1970.
///
/// ```
/// use std::time::{Duration, UNIX_EPOCH};
///
/// let time = UNIX_EPOCH + Duration::from_millis(1_492_256_403_129);
/// assert_eq!(vda5050::iso_8601(time), "2017-04-15T11:40:03.12Z");
/// ```
pub fn iso_8601(time: SystemTime) -> String {
    let time = OffsetDateTime::from(time.max(UNIX_EPOCH));
    let (year, month, day) = (time.year(), u8::from(time.month()), time.day());
    let (hour, minute, second) = time.time().as_hms();
    let hundredths = time.millisecond() / 10;
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}.{hundredths:02}Z")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn days_follow_each_other_through_leap_years() {
        let is_leap =
            |year: u64| year.is_multiple_of(4) && !year.is_multiple_of(100) || year.is_multiple_of(400);
        let mut day_number = 0;
        for year in 1970..2410 {
            let february = 28 + u64::from(is_leap(year));
            for (month, days) in (1..).zip([31, february, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31]) {
                for day in 1..=days {
                    let written = iso_8601(UNIX_EPOCH + Duration::from_secs(86_400 * day_number));
                    assert_eq!(written, format!("{year:04}-{month:02}-{day:02}T00:00:00.00Z"));
                    day_number += 1;
                }
            }
        }
    }

    #[test]
    fn times_before_1970_are_written_as_1970() {
        assert_eq!(iso_8601(UNIX_EPOCH - Duration::from_secs(5)), "1970-01-01T00:00:00.00Z");
    }
}
