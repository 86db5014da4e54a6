//! A grey bitmap and its halved copies.

/// Fewest columns and rows of a level: texels are interpolated between neighbours.
const MIN_SIDE: usize = 2;
/// Less of the coarser level is not looked up.
const MIN_PART: f32 = 1e-3;

/// A mip-mapped grey bitmap: level 0 is the finest, and each further level averages two by two texels of the one before.
///
/// # Coordinate systems
/// `u` runs along the rows and `v` down, in texels of level 0 from the bitmap's corner: the centre of the first texel is
/// `(0.5, 0.5)`, on every level.
///
/// # Example
/// ```
/// let ramp = rendering::Texture::from_fn([64, 64], |u, _| 2.0 * u as f32);
/// assert_eq!(ramp.sample(10.5, 20.0, 0.0), 20.0);
/// assert!((ramp.sample(32.0, 20.0, 2.0) - 63.0).abs() < 0.5);
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Texture {
    levels: Vec<Level>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
struct Level {
    width: usize,
    height: usize,
    texels: Vec<u8>,
}

impl Texture {
    /// A bitmap of `[columns, rows]` whose texel in column `u` and row `v` is `value(u, v)`, rounded to 0 to 255.
    ///
    /// # Panics
    /// If a side is shorter than two texels.
    pub fn from_fn(size: [usize; 2], mut value: impl FnMut(usize, usize) -> f32) -> Self {
        let [width, height] = size;
        let mut texels = Vec::with_capacity(width * height);
        for v in 0..height {
            texels.extend((0..width).map(|u| value(u, v).round().clamp(0.0, 255.0) as u8));
        }
        Self::from_texels(size, texels)
    }

    /// A bitmap from its texels, row after row.
    pub(crate) fn from_texels([width, height]: [usize; 2], texels: Vec<u8>) -> Self {
        assert!(width.min(height) >= MIN_SIDE && texels.len() == width * height, "a bitmap has texels");
        let mut levels = vec![Level { width, height, texels }];
        while let Some(halved) = levels.last().and_then(Level::halved) {
            levels.push(halved);
        }
        Self { levels }
    }

    /// Columns and rows.
    pub fn size(&self) -> [usize; 2] {
        [self.levels[0].width, self.levels[0].height]
    }

    /// The grey level at a point, interpolated within two levels and between them.
    ///
    /// # Arguments
    /// * `level`: binary logarithm of the number of texels that a pixel covers.
    pub fn sample(&self, u: f32, v: f32, level: f32) -> f32 {
        self.at_level(level).grey(u, v)
    }

    /// The bitmap as it looks where a pixel covers some texels; for many points.
    pub(crate) fn at_level(&self, level: f32) -> SmoothedTexture<'_> {
        let level = level.clamp(0.0, (self.levels.len() - 1) as f32);
        let finer = level as usize;
        let coarser = (finer + 1).min(self.levels.len() - 1);
        SmoothedTexture {
            levels: [finer, coarser].map(|level| Lattice::new(&self.levels[level], level)),
            part: level - finer as f32,
        }
    }
}

/// A bitmap between two of its levels.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SmoothedTexture<'a> {
    levels: [Lattice<'a>; 2],
    /// How much of the second level.
    part: f32,
}

/// The centres of a level's texels, with what many points need of it.
#[derive(Clone, Copy, Debug)]
struct Lattice<'a> {
    texels: &'a [u8],
    width: usize,
    /// Texels of this level in one of level 0.
    scale: f32,
    /// The last column and row, as coordinates and of the cells between four centres.
    last: [f32; 2],
    last_cell: [i32; 2],
}

impl SmoothedTexture<'_> {
    #[inline]
    pub(crate) fn grey(&self, u: f32, v: f32) -> f32 {
        let fine = self.levels[0].grey(u, v);
        if self.part < MIN_PART {
            return fine;
        }
        let coarse = self.levels[1].grey(u, v);
        fine + self.part * (coarse - fine)
    }
}

impl Level {
    /// The next level; `None` where it would have fewer than two columns or rows.
    fn halved(&self) -> Option<Self> {
        if self.width.min(self.height) <= MIN_SIDE {
            return None;
        }
        let (width, height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let mut texels = Vec::with_capacity(width * height);
        for v in 0..height {
            let rows = [2 * v, (2 * v + 1).min(self.height - 1)].map(|row| {
                let begin = row * self.width;
                &self.texels[begin..begin + self.width]
            });
            for u in 0..width {
                let (left, right) = (2 * u, (2 * u + 1).min(self.width - 1));
                let sum: u16 = rows.iter().map(|row| u16::from(row[left]) + u16::from(row[right])).sum();
                texels.push(((sum + 2) / 4) as u8);
            }
        }
        Some(Self { width, height, texels })
    }
}

impl<'a> Lattice<'a> {
    fn new(level: &'a Level, index: usize) -> Self {
        let sides = [level.width, level.height];
        Self {
            texels: &level.texels,
            width: level.width,
            scale: 1.0 / (1_u32 << index) as f32,
            last: sides.map(|side| (side - 1) as f32),
            last_cell: sides.map(|side| (side - 2) as i32),
        }
    }

    /// Interpolated between the centres of four texels; beyond the border as on it.
    ///
    /// # Arguments
    /// * `u`, `v`: in texels of level 0.
    #[inline]
    fn grey(&self, u: f32, v: f32) -> f32 {
        let x = (u * self.scale - 0.5).max(0.0).min(self.last[0]);
        let y = (v * self.scale - 0.5).max(0.0).min(self.last[1]);
        let (column, row) = ((x as i32).min(self.last_cell[0]), (y as i32).min(self.last_cell[1]));
        let (s, t) = (x - column as f32, y - row as f32);
        let begin = row as usize * self.width + column as usize;
        let texels = &self.texels[begin..begin + self.width + 2];
        let [upper_left, upper_right] = [f32::from(texels[0]), f32::from(texels[1])];
        let [lower_left, lower_right] = [f32::from(texels[self.width]), f32::from(texels[self.width + 1])];
        let upper = upper_left + s * (upper_right - upper_left);
        let lower = lower_left + s * (lower_right - lower_left);
        upper + t * (lower - upper)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ramp_is_the_same_on_all_levels() {
        let ramp = Texture::from_fn([101, 67], |u, v| (u + v) as f32);
        for level in [0.0, 0.5, 1.0, 2.0, 2.7] {
            for (u, v) in [(30.0, 40.0), (51.3, 20.2), (60.0, 33.0)] {
                let found = ramp.sample(u, v, level);
                assert!((found - (u + v - 1.0)).abs() < 0.6, "{found} at {u} {v} of level {level}");
            }
        }
    }

    #[test]
    fn stripes_of_single_texels_are_grey_from_afar() {
        let stripes = Texture::from_fn([64, 64], |u, _| if u % 2 == 0 { 0.0 } else { 200.0 });
        assert!((stripes.sample(10.5, 9.0, 0.0) - 0.0).abs() < 1.0);
        assert!((stripes.sample(10.5, 9.0, 2.0) - 100.0).abs() < 1.0);
        assert!((stripes.sample(-5.0, 900.0, 99.0) - 100.0).abs() < 1.0);
    }
}
