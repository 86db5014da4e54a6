//! Loadings that wait, in 48 bits a number.
//!
//! A parked keyframe has `6 n` numbers, 1,386 with 30 landmarks and 20 clones: 11.1 kB in double precision, 8.3 kB here. The
//! sign, the exponent and 36 of 52 bits of the fraction are kept. Rounding to the nearest is off by at most `2^-37`
//! = 7.3e-12 of each number, far below what the laws of the filter ask for (1e-9), and far above single precision.

/// Bits of the fraction that are not kept.
const DROPPED: u32 = 16;
/// Half of the last bit that is kept.
const HALF: u64 = 1 << (DROPPED - 1);

/// A column-major matrix, rounded to 48 bits a number.
#[derive(Clone, Debug)]
pub struct Packed {
    rows: usize,
    high: Box<[u32]>,
    low: Box<[u16]>,
}

impl Packed {
    /// Rounds whole columns of `rows` numbers. What is not finite stays so.
    pub fn new(numbers: &[f64], rows: usize) -> Self {
        let rounded = |number: &f64| (number.to_bits().saturating_add(HALF)) >> DROPPED;
        Self {
            rows,
            high: numbers.iter().map(|number| (rounded(number) >> 16) as u32).collect(),
            low: numbers.iter().map(|number| (rounded(number) & 0xffff) as u16).collect(),
        }
    }

    /// Rows of the matrix.
    pub fn nrows(&self) -> usize {
        self.rows
    }

    /// The numbers, columns one after the other.
    pub fn numbers(&self) -> impl Iterator<Item = f64> + '_ {
        let bits = |high: u32, low: u16| (u64::from(high) << 32) | (u64::from(low) << DROPPED);
        self.high.iter().zip(&self.low).map(move |(&high, &low)| f64::from_bits(bits(high, low)))
    }

    /// Bytes that it holds beside its own size.
    pub fn heap_bytes(&self) -> usize {
        size_of_val::<[u32]>(&self.high) + size_of_val::<[u16]>(&self.low)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_comes_back_to_eleven_digits() {
        let numbers =
            [0.0, -0.0, 1.0, -1.0 / 3.0, 0.999_999_999_999_999_9, 6.02e23, -1.6e-19, f64::MIN_POSITIVE];
        let packed = Packed::new(&numbers, 2);
        for (number, back) in numbers.iter().zip(packed.numbers()) {
            assert!((number - back).abs() <= 2_f64.powi(-37) * number.abs(), "{number} came back as {back}");
            assert_eq!(number.is_sign_negative(), back.is_sign_negative());
        }
        assert_eq!(packed.heap_bytes(), 6 * numbers.len());
        assert!(Packed::new(&[f64::NAN], 1).numbers().all(f64::is_nan));
    }
}
