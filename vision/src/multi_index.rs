//! Near binary descriptors among hundreds of thousands without looking at all of them: multi-index hashing.
//!
//! A descriptor of `n` chunks of 16 bits is filed under each chunk's value. Two descriptors that differ in fewer than
//! `n * (r + 1)` bits have, by the pigeonhole principle, a chunk that differs in at most `r` bits: looking up every
//! chunk with up to `r` bits flipped finds all of them, and most of the farther ones. Every find is verified, so
//! nothing farther than asked for is returned.
//!
//! # Where the defaults come from
//! `r = 1` ([`MultiIndex::DEFAULT_RADIUS`]), measured on the recorded sequences, recall of pairs within 0.2 of the bits:
//!
//! | | r = 0 | r = 1 | r = 2 |
//! |---|---|---|---|
//! | `yq`, 256 bits | 0.971 | 1.0000 | 1.0000 |
//! | `walk`, 384 bits | 0.803 | 0.998 | 1.0000 |
//!
//! A lookup touches 1, 17 or 137 lists a chunk. Chunk `c` of `n` takes the bits `c, c + n, c + 2n, ..` rather than 16
//! neighbours: neighbouring bits of real descriptors are alike, and on `walk` (62,206 descriptors) neighbours made
//! lists so long that a lookup met 9,429 entries (longest list 6,540), strided chunks 351 (555). On evenly random bits
//! it makes no difference.
//!
//! Source: Norouzi, Punjani, Fleet, "Fast search in Hamming space with multi-index hashing", CVPR 2012.

use crate::descriptors::{DescriptorError, hamming};

const CHUNK_BITS: usize = 16;
const CHUNK_VALUES: usize = 1 << CHUNK_BITS;

/// A descriptor near a query.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Candidate {
    /// Bits that differ.
    pub distance: u32,
    /// What was stored with the descriptor.
    pub payload: u32,
    /// Number of the descriptor in order of insertion.
    pub entry: u32,
}

/// Binary descriptors of one width with a number each, to be searched by Hamming distance.
///
/// Costs 256 KiB a chunk, and for each descriptor its bytes, 4 bytes a chunk and 4 bytes.
///
/// ```
/// let mut index = vision::MultiIndex::new(32)?;
/// index.insert(&[0x55; 32], 7)?;
/// let found = index.query(&[0x57; 32], 40)?;
/// assert_eq!((found[0].payload, found[0].distance), (7, 32));
/// assert!(index.query(&[0xaa; 32], 40)?.is_empty());
/// # Ok::<(), vision::DescriptorError>(())
/// ```
#[derive(Clone, Debug)]
pub struct MultiIndex {
    width: usize,
    radius: u8,
    /// `heads[chunk * CHUNK_VALUES + value]`: the newest entry with that value plus one, 0 for none.
    heads: Vec<u32>,
    /// `next[entry * chunks + chunk]`: the entry before it in the same list plus one, 0 for none.
    next: Vec<u32>,
    payloads: Vec<u32>,
    bytes: Vec<u8>,
}

impl MultiIndex {
    /// Bits that may differ in a chunk that is looked up.
    pub const DEFAULT_RADIUS: u8 = 1;

    /// An empty index of descriptors of `width` bytes.
    ///
    /// # Errors
    /// [`DescriptorError::Width`] unless the width is a positive multiple of 2.
    pub fn new(width: usize) -> Result<Self, DescriptorError> {
        Self::with_radius(width, Self::DEFAULT_RADIUS)
    }

    /// Like [`Self::new`], with up to `radius` (at most 2) flipped bits in a looked-up chunk: 0 is the fastest and
    /// misses most, 2 the slowest.
    ///
    /// # Errors
    /// [`DescriptorError::Width`] unless the width is a positive multiple of 2.
    pub fn with_radius(width: usize, radius: u8) -> Result<Self, DescriptorError> {
        if width == 0 || !width.is_multiple_of(2) {
            return Err(DescriptorError::Width { width, metric: crate::Metric::Hamming });
        }
        let heads = vec![0; width / 2 * CHUNK_VALUES];
        let radius = radius.min(2);
        Ok(Self { width, radius, heads, next: Vec::new(), payloads: Vec::new(), bytes: Vec::new() })
    }

    /// Bytes a descriptor.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Number of descriptors.
    pub fn len(&self) -> usize {
        self.payloads.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.payloads.is_empty()
    }

    /// Largest distance in bits up to which [`Self::query`] misses nothing at all.
    pub fn exact_distance(&self) -> u32 {
        (self.chunks() * (usize::from(self.radius) + 1) - 1) as u32
    }

    /// The descriptor of an entry, `None` beyond the last.
    pub fn descriptor(&self, entry: u32) -> Option<&[u8]> {
        let start = entry as usize * self.width;
        self.bytes.get(start..start + self.width)
    }

    fn chunks(&self) -> usize {
        self.width / 2
    }

    /// Adds a descriptor with a number that its finders get back (not necessarily unique).
    ///
    /// # Errors
    /// [`DescriptorError::Mismatch`] for another width, [`DescriptorError::Full`] beyond 2^32 - 2 descriptors.
    pub fn insert(&mut self, descriptor: &[u8], payload: u32) -> Result<(), DescriptorError> {
        self.check_width(descriptor)?;
        let following = u32::try_from(self.len() + 1).map_err(|_| DescriptorError::Full)?;
        for (chunk, value) in chunk_values(descriptor).enumerate() {
            let head = &mut self.heads[chunk * CHUNK_VALUES + usize::from(value)];
            self.next.push(std::mem::replace(head, following));
        }
        self.payloads.push(payload);
        self.bytes.extend_from_slice(descriptor);
        Ok(())
    }

    /// Descriptors that differ in at most `max_distance` bits: all of them up to [`Self::exact_distance`], most of
    /// the farther ones.
    ///
    /// # Returns
    /// Nearest first, of equal distances by payload and order of insertion; no entry twice.
    ///
    /// # Errors
    /// [`DescriptorError::Mismatch`] for another width.
    pub fn query(&self, descriptor: &[u8], max_distance: u32) -> Result<Vec<Candidate>, DescriptorError> {
        self.check_width(descriptor)?;
        let mut found = Vec::new();
        for (chunk, value) in chunk_values(descriptor).enumerate() {
            for flips in flips_within(self.radius) {
                self.collect(chunk, value ^ flips, descriptor, max_distance, &mut found);
            }
        }
        found.sort_unstable();
        found.dedup();
        Ok(found)
    }

    /// Appends what lies near enough in one list.
    fn collect(&self, chunk: usize, value: u16, query: &[u8], max_distance: u32, found: &mut Vec<Candidate>) {
        let mut following = self.heads[chunk * CHUNK_VALUES + usize::from(value)];
        while following != 0 {
            let entry = following as usize - 1;
            let distance = hamming(query, &self.bytes[entry * self.width..(entry + 1) * self.width]);
            if distance <= max_distance {
                found.push(Candidate { distance, payload: self.payloads[entry], entry: entry as u32 });
            }
            following = self.next[entry * self.chunks() + chunk];
        }
    }

    fn check_width(&self, descriptor: &[u8]) -> Result<(), DescriptorError> {
        if descriptor.len() == self.width {
            Ok(())
        } else {
            Err(DescriptorError::Mismatch { left: descriptor.len(), right: self.width })
        }
    }
}

/// The value of every chunk: chunk `c` of `n` has bit `c + j * n` of the descriptor as its bit `j`.
fn chunk_values(descriptor: &[u8]) -> impl Iterator<Item = u16> {
    let chunks = descriptor.len() / 2;
    let bit = |position: usize| u16::from(descriptor[position / 8] >> (position % 8) & 1);
    (0..chunks).map(move |chunk| (0..CHUNK_BITS).fold(0, |value, j| value | bit(chunk + j * chunks) << j))
}

/// Every 16-bit mask with at most `radius` (0, 1 or 2) bits set.
fn flips_within(radius: u8) -> impl Iterator<Item = u16> {
    let singles = (0..CHUNK_BITS).map(|bit| 1 << bit).filter(move |_| radius >= 1);
    let pairs = (0..CHUNK_BITS).flat_map(|high| (0..high).map(move |low| 1 << high | 1 << low));
    std::iter::once(0).chain(singles).chain(pairs.filter(move |_| radius >= 2))
}
