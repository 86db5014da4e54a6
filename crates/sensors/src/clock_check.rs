//! Whether images and readings are stamped by one clock, in nanoseconds.

use crate::SequenceError;
use std::path::Path;

/// No IMU reads more often, nanoseconds: 50 kHz.
const MIN_INTERVAL_NS: i64 = 20_000;
/// Fewer readings tell nothing.
const MIN_READINGS: i64 = 10;
/// Images so long before the first or after the last reading may be of the same clock, nanoseconds.
const AROUND_NS: i64 = 10_000_000_000;

/// Looks at the stamps of a recording.
#[derive(Debug, Default)]
pub(crate) struct ClockCheck {
    images: Option<Span>,
    readings: Option<Span>,
}

#[derive(Clone, Copy, Debug)]
struct Span {
    first_ns: i64,
    last_ns: i64,
    count: i64,
}

impl Span {
    fn add(span: &mut Option<Self>, stamp_ns: i64) {
        let span = span.get_or_insert(Self { first_ns: stamp_ns, last_ns: stamp_ns, count: 0 });
        span.last_ns = stamp_ns;
        span.count += 1;
    }

    fn describe(&self) -> String {
        let seconds = |ns: i64| ns as f64 * 1e-9;
        format!("from {:.3} to {:.3} s", seconds(self.first_ns), seconds(self.last_ns))
    }
}

impl ClockCheck {
    /// Adds an image; in order of time.
    pub(crate) fn add_image(&mut self, stamp_ns: i64) {
        Span::add(&mut self.images, stamp_ns);
    }

    /// Adds a reading; in order of time.
    pub(crate) fn add_reading(&mut self, stamp_ns: i64) {
        Span::add(&mut self.readings, stamp_ns);
    }

    /// Checks a recording that was read to its end.
    ///
    /// # Errors
    /// [`SequenceError::Clocks`]: stamps in another unit, or of two clocks.
    pub(crate) fn finish(&self, root: &Path) -> Result<(), SequenceError> {
        let Some(readings) = self.readings.filter(|readings| readings.count >= MIN_READINGS) else {
            return Ok(());
        };
        let wrong = |problem: String| SequenceError::Clocks { path: root.to_path_buf(), problem };
        let interval_ns =
            readings.last_ns.saturating_sub(readings.first_ns) / readings.count.saturating_sub(1).max(1);
        if interval_ns < MIN_INTERVAL_NS {
            return Err(wrong(format!(
                "the readings of the IMU are {interval_ns} ns apart by their stamps, which no IMU is: the stamps are in another unit \
                 (microseconds?); write them in nanoseconds"
            )));
        }
        let Some(images) = self.images else { return Ok(()) };
        let is_apart = images.first_ns.saturating_sub(readings.last_ns) > AROUND_NS
            || readings.first_ns.saturating_sub(images.last_ns) > AROUND_NS;
        if is_apart {
            return Err(wrong(format!(
                "images and readings are stamped by clocks of different epochs: images {}, readings of the IMU {}; stamp both by \
                 one clock",
                images.describe(),
                readings.describe()
            )));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const START_NS: i64 = 1_403_636_580_000_000_000;

    /// Ten seconds at 200 readings and 20 images a second.
    fn refusal(images_from_ns: i64, readings_from_ns: i64, unit_ns: i64) -> Option<String> {
        let mut check = ClockCheck::default();
        (0..2000).for_each(|k| check.add_reading((readings_from_ns + k * 5_000_000) / unit_ns));
        (0..200).for_each(|k| check.add_image((images_from_ns + k * 50_000_000) / unit_ns));
        check.finish(Path::new("drive")).err().map(|error| error.to_string())
    }

    #[test]
    fn stamps_of_other_units_and_of_two_clocks_are_named() {
        for (images, readings, unit_ns, said) in [
            (START_NS, START_NS, 1, None),
            (START_NS, START_NS + 19_000_000_000, 1, None),
            (START_NS, 5_000_000_000, 1, Some("different epochs")),
            (7_000_000_000, START_NS, 1, Some("different epochs")),
            (START_NS, START_NS, 1_000, Some("another unit")),
            (START_NS, START_NS, 1_000_000, Some("another unit")),
        ] {
            let found = refusal(images, readings, unit_ns);
            let is_right = match (&found, said) {
                (Some(found), Some(said)) => found.contains(said),
                (found, said) => found.is_none() && said.is_none(),
            };
            assert!(is_right, "{images} {readings} {unit_ns}: {found:?}");
        }
    }
}
