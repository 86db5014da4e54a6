//! Readings of the IMU: rounded below their noise, as differences from reading to reading.

use nalgebra::Vector3;
use types::ImuSample;

use super::Times;
use crate::bytes::{Reader, Writer};
use crate::error::ChunkError;

/// Largest reading in steps: with steps of 1e-7 still a million rad/s.
const MOST_STEPS: f64 = 1e13;

pub(super) fn write(out: &mut Writer, readings: &[ImuSample], [gyroscope, accelerometer]: [f64; 2]) {
    out.unsigned(readings.len() as u64);
    let (mut times, mut last) = (Times(None), [0_i64; 6]);
    let round = |value: f64, step: f64| (value / step).round().clamp(-MOST_STEPS, MOST_STEPS) as i64;
    for reading in readings {
        times.write(out, reading.stamp_ns);
        let rates = reading.gyroscope.map(|value| round(value, gyroscope));
        let forces = reading.accelerometer.map(|value| round(value, accelerometer));
        let now = [rates.x, rates.y, rates.z, forces.x, forces.y, forces.z];
        now.iter().zip(&last).for_each(|(now, last)| out.signed(now - last));
        last = now;
    }
}

pub(super) fn read(
    input: &mut Reader<'_>,
    [gyroscope, accelerometer]: [f64; 2],
) -> Result<Vec<ImuSample>, ChunkError> {
    let (mut readings, count) = input.list()?;
    let (mut times, mut last) = (Times(None), [0_i64; 6]);
    for _ in 0..count {
        let stamp_ns = times.read(input)?;
        for value in &mut last {
            let next = value.checked_add(input.signed()?).ok_or(ChunkError::Range("a reading"))?;
            if next.unsigned_abs() as f64 > MOST_STEPS {
                return Err(ChunkError::Range("a reading"));
            }
            *value = next;
        }
        let [rates @ .., a, b, c] = last.map(|value| value as f64);
        readings.push(ImuSample {
            stamp_ns,
            gyroscope: Vector3::from(rates) * gyroscope,
            accelerometer: Vector3::new(a, b, c) * accelerometer,
        });
    }
    Ok(readings)
}
