//! Times for a person.

use time::OffsetDateTime;

/// A time for a person, in UTC.
///
/// # Arguments
/// * `unix_s`: seconds since 1970.
///
/// # Example
/// ```
/// assert_eq!(map::sessions::utc_time(1_700_000_000), "2023-11-14 22:13:20 UTC");
/// ```
pub fn utc_time(unix_s: u64) -> String {
    let known =
        i64::try_from(unix_s).ok().and_then(|seconds| OffsetDateTime::from_unix_timestamp(seconds).ok());
    let Some(time) = known else { return format!("{unix_s} s") };
    let (year, month, day) = (time.year(), u8::from(time.month()), time.day());
    format!("{year}-{month:02}-{day:02} {:02}:{:02}:{:02} UTC", time.hour(), time.minute(), time.second())
}
