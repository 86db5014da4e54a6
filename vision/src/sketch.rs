//! Float descriptors as bits, so that they can be searched in a [`crate::MultiIndex`].
//!
//! Bit `i` says on which side of a random hyperplane `i` through the origin the descriptor lies. Two descriptors at the
//! angle `a` differ in each bit with probability `a / pi`: the Hamming distance of the sketches measures the angle,
//! with a standard deviation of at most 8 of 256 bits.
//!
//! Source: Charikar, "Similarity estimation techniques from rounding algorithms", STOC 2002.

use crate::descriptors::{DescriptorError, floats, signed};

/// Bytes of a sketch.
pub const SKETCH_BYTES: usize = 32;

const SKETCH_BITS: usize = 8 * SKETCH_BYTES;

/// Random hyperplanes for float descriptors of one dimension.
///
/// The same dimension and seed give the same sketches on every machine.
///
/// ```
/// let sketcher = vision::Sketcher::new(3, 1);
/// let descriptor: Vec<u8> = [1.0_f32, 2.0, -3.0].iter().flat_map(|x| x.to_le_bytes()).collect();
/// let scaled: Vec<u8> = [2.0_f32, 4.0, -6.0].iter().flat_map(|x| x.to_le_bytes()).collect();
/// assert_eq!(sketcher.sketch(&descriptor)?, sketcher.sketch(&scaled)?);
/// # Ok::<(), vision::DescriptorError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Sketcher {
    dimension: usize,
    /// 256 normals, one after the other.
    normals: Vec<f32>,
}

impl Sketcher {
    /// Draws 256 hyperplanes for descriptors of `dimension` numbers.
    pub fn new(dimension: usize, seed: u64) -> Self {
        let mut random = SplitMix64(seed);
        let normals = (0..SKETCH_BITS * dimension).map(|_| random.nearly_normal()).collect();
        Self { dimension, normals }
    }

    /// The sketch of one descriptor (little-endian `f32` numbers).
    ///
    /// # Errors
    /// [`DescriptorError::Mismatch`] for another dimension.
    pub fn sketch(&self, descriptor: &[u8]) -> Result<[u8; SKETCH_BYTES], DescriptorError> {
        if descriptor.len() != 4 * self.dimension {
            return Err(DescriptorError::Mismatch { left: descriptor.len(), right: 4 * self.dimension });
        }
        Ok(self.sketch_of(floats(descriptor)))
    }

    /// The sketch of one descriptor of signed bytes.
    ///
    /// # Errors
    /// [`DescriptorError::Mismatch`] for another dimension.
    pub fn sketch_int8(&self, descriptor: &[u8]) -> Result<[u8; SKETCH_BYTES], DescriptorError> {
        if descriptor.len() != self.dimension {
            return Err(DescriptorError::Mismatch { left: descriptor.len(), right: self.dimension });
        }
        Ok(self.sketch_of(signed(descriptor)))
    }

    fn sketch_of(&self, numbers: impl Iterator<Item = f32>) -> [u8; SKETCH_BYTES] {
        let numbers: Vec<f32> = numbers.collect();
        let mut sketch = [0; SKETCH_BYTES];
        for (bit, normal) in self.normals.chunks_exact(self.dimension.max(1)).enumerate() {
            let side: f32 = normal.iter().zip(&numbers).map(|(x, y)| x * y).sum();
            sketch[bit / 8] |= u8::from(side > 0.0) << (bit % 8);
        }
        sketch
    }

    /// Number of sketch bits in which descriptors at a cosine distance differ on average: `256 acos(1 - d) / pi`.
    ///
    /// ```
    /// assert_eq!(vision::Sketcher::expected_bits(1.0), 128.0);
    /// ```
    pub fn expected_bits(cosine_distance: f64) -> f64 {
        SKETCH_BITS as f64 * (1.0 - cosine_distance).clamp(-1.0, 1.0).acos() / std::f64::consts::PI
    }

    /// A search radius that keeps 99.8 % of the descriptors at a cosine distance: the expected bits and three
    /// standard deviations of a binomial count.
    pub fn search_bits(cosine_distance: f64) -> u32 {
        let expected = Self::expected_bits(cosine_distance);
        let sigma = (expected * (1.0 - expected / SKETCH_BITS as f64)).sqrt();
        (expected + 3.0 * sigma).ceil() as u32
    }
}

/// Steele, Lea & Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014.
struct SplitMix64(u64);

impl SplitMix64 {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut mixed = self.0;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ (mixed >> 31)
    }

    /// Sum of four centred 16-bit numbers, scaled to variance 1: near enough to a normal number for directions, and,
    /// without a logarithm, the same on every machine.
    fn nearly_normal(&mut self) -> f32 {
        let bits = self.next();
        let sum: u64 = (0..4).map(|part| bits >> (16 * part) & 0xffff).sum();
        let centred = sum as f32 / 65536.0 - 2.0;
        centred * 3.0_f32.sqrt()
    }
}
