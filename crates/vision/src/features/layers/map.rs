//! Feature maps with a border of zeros.

/// Rows and columns of zeros on each side: what a kernel reaches at most.
pub const BORDER: usize = 8;
/// Columns are computed in blocks of this many.
pub const BLOCK: usize = 24;

/// Numbers by row, channel and column, with zeros around, which convolutions read as their padding.
///
/// A row holds all channels one after the other, so that what a row of a convolution reads is close together in memory.
/// Above and below are eight rows of zeros, to the left eight columns; to the right as many after the last whole block.
#[derive(Debug, Default, PartialEq)]
pub struct Map {
    channels: usize,
    rows: usize,
    columns: usize,
    stride: usize,
    data: Vec<f32>,
}

impl Clone for Map {
    fn clone(&self) -> Self {
        Self { data: self.data.clone(), ..*self }
    }

    /// Reuses the memory.
    fn clone_from(&mut self, other: &Self) {
        let mut data = std::mem::take(&mut self.data);
        data.clone_from(&other.data);
        *self = Self { data, ..*other };
    }
}

impl Map {
    /// A map of zeros.
    pub fn zeros(channels: usize, rows: usize, columns: usize) -> Self {
        let data = vec![0.0; Self::count(channels, rows, columns)];
        Self { channels, rows, columns, stride: Self::stride(columns), data }
    }

    /// Distance between the rows of two channels.
    fn stride(columns: usize) -> usize {
        BORDER + columns.div_ceil(BLOCK) * BLOCK + BORDER
    }

    /// Numbers with the border.
    fn count(channels: usize, rows: usize, columns: usize) -> usize {
        (rows + 2 * BORDER) * channels * Self::stride(columns)
    }

    /// Gives it another shape, filled with zeros, unless it has that shape already.
    pub fn reshape(&mut self, channels: usize, rows: usize, columns: usize) {
        if [self.channels, self.rows, self.columns] != [channels, rows, columns] {
            let mut data = std::mem::take(&mut self.data);
            data.clear();
            data.resize(Self::count(channels, rows, columns), 0.0);
            *self = Self { channels, rows, columns, stride: Self::stride(columns), data };
        }
    }

    /// Number of channels.
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Number of columns.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// A row of a channel.
    pub fn row(&self, channel: usize, y: usize) -> &[f32] {
        let start = self.start(channel, y);
        &self.data[start..start + self.columns]
    }

    /// A row of a channel.
    pub fn row_mut(&mut self, channel: usize, y: usize) -> &mut [f32] {
        let start = self.start(channel, y);
        &mut self.data[start..start + self.columns]
    }

    /// Index of the first number of a row of a channel.
    fn start(&self, channel: usize, y: usize) -> usize {
        ((y + BORDER) * self.channels + channel) * self.stride + BORDER
    }

    /// Everything that a convolution may read for the outputs of row `y`, from the rows above on.
    pub(super) fn around_row(&self, y: usize) -> &[f32] {
        &self.data[y * self.channels * self.stride..]
    }

    /// Where in [`Map::around_row`] the neighbour at `[rows, columns]` (at most 8 each) of the row's first pixel is.
    pub(super) fn offset(&self, channel: usize, [down, right]: [isize; 2]) -> usize {
        let [row, column] = [down, right].map(|step| BORDER.wrapping_add_signed(step));
        (row * self.channels + channel) * self.stride + column
    }

    /// The row of each channel with the columns up to the end of the last block, and the distance between channels.
    pub(super) fn blocks_of_row(&self, y: usize) -> (&[f32], usize) {
        let start = self.start(0, y);
        (&self.data[start..start + self.channels * self.stride - BORDER], self.stride)
    }

    /// As [`Map::blocks_of_row`], to write to.
    pub(super) fn blocks_of_row_mut(&mut self, y: usize) -> (&mut [f32], usize) {
        let start = self.start(0, y);
        (&mut self.data[start..start + self.channels * self.stride - BORDER], self.stride)
    }

    /// Sets all numbers to zero.
    pub fn clear(&mut self) {
        self.data.fill(0.0);
    }

    /// Replaces every number.
    pub fn apply(&mut self, f: impl Fn(f32) -> f32) {
        for y in 0..self.rows {
            for channel in 0..self.channels {
                for number in self.row_mut(channel, y) {
                    *number = f(*number);
                }
            }
        }
    }

    /// Sets to zero what blocks wrote to the right of the last column of a row.
    pub(super) fn clear_right(&mut self, y: usize) {
        for channel in 0..self.channels {
            let start = self.start(channel, y);
            self.data[start + self.columns..start + self.stride - BORDER].fill(0.0);
        }
    }
}
