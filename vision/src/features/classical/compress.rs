//! From 128 numbers to 64 signed bytes.
use super::histogram::NUMBERS;

/// Bytes a descriptor.
pub(super) const WIDTH: usize = 64;

pub(super) fn compress(numbers: &[f32; NUMBERS]) -> [u8; WIDTH] {
    let mut out = [0; WIDTH];
    for (k, o) in out.iter_mut().enumerate() {
        *o = ((numbers[2 * k] + numbers[2 * k + 1] - 0.12) * 200.0).clamp(-127.0, 127.0).round() as i8 as u8;
    }
    out
}
