//! Readings of the wheels as they are taken in, be it from a folder or live: speeds, or counts that become speeds.

use crate::{CalibrationFiles, WheelReading, WheelSensor};
use types::{BaseKind, Encoder, EncoderCounts};

/// Why a row cannot be taken in.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum WheelProblem {
    /// There are fewer numbers than wheels.
    #[error(
        "{found} numbers, but a {base} base has {expected}: write {columns}, or name the base (base of wheels0/sensor.yaml, or --wheel-base)"
    )]
    Columns {
        /// How many.
        found: usize,
        /// As many as the base has.
        expected: usize,
        /// Their names.
        columns: String,
        /// The base.
        base: BaseKind,
    },
}

/// From numbers as they are recorded or come to readings.
#[derive(Clone, Debug)]
pub struct WheelIntake {
    base: BaseKind,
    counts: Option<EncoderCounts>,
}

impl WheelIntake {
    /// Of a base whose kind and encoders `files` name, else the calibration.
    pub fn new(wheels: Option<&WheelSensor>, files: &CalibrationFiles) -> Self {
        let stated = wheels.map(|wheels| wheels.base.kind());
        let base = files.wheel_base.or(stated).unwrap_or_default();
        let encoder = files.wheel_encoder.or_else(|| wheels?.encoder);
        Self::of(base, encoder)
    }

    /// Of a base.
    ///
    /// # Arguments
    /// * `encoder`: where the numbers are counts.
    pub fn of(base: BaseKind, encoder: Option<Encoder>) -> Self {
        Self { base, counts: encoder.map(|encoder| EncoderCounts::new(encoder, base.wheels())) }
    }

    /// # Arguments
    /// * `values`: of the wheels; further ones are not used.
    ///
    /// # Returns
    /// `None` of the first counts: there is no speed yet.
    ///
    /// # Errors
    /// [`WheelProblem`].
    pub fn take(&mut self, stamp_ns: i64, values: &[f64]) -> Result<Option<WheelReading>, WheelProblem> {
        let columns = self.base.columns();
        let Some(values) = values.get(..columns.len()) else {
            let (found, expected) = (values.len(), columns.len());
            return Err(WheelProblem::Columns {
                found,
                expected,
                columns: columns.join(", "),
                base: self.base,
            });
        };
        Ok(match &mut self.counts {
            Some(counts) => counts.reading(stamp_ns, values),
            None => Some(WheelReading::of_slice(stamp_ns, values)),
        })
    }
}
