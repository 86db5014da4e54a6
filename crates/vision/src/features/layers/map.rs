//! Feature maps with a border of zeros.

/// Columns of zeros to the left of a row: a vector, so that all rows start alike.
const LEFT: usize = 8;
/// Columns are computed in blocks of this many.
pub const BLOCK: usize = 24;

/// Numbers by row, channel and column, with zeros around, which convolutions read as their padding.
///
/// A row holds all channels one after the other, so that what a row of a convolution reads is close together in memory.
/// One row of zeros is above and one below, eight columns to the left; to the right at least one column after the last
/// whole block.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Map {
    channels: usize,
    rows: usize,
    columns: usize,
    stride: usize,
    data: Vec<f32>,
}

impl Map {
    /// A map of zeros.
    pub fn zeros(channels: usize, rows: usize, columns: usize) -> Self {
        let stride = LEFT + columns.div_ceil(BLOCK) * BLOCK + LEFT;
        let data = vec![0.0; (rows + 2) * channels * stride];
        Self { channels, rows, columns, stride, data }
    }

    /// Gives it another shape, filled with zeros, unless it has that shape already.
    pub fn reshape(&mut self, channels: usize, rows: usize, columns: usize) {
        if [self.channels, self.rows, self.columns] != [channels, rows, columns] {
            *self = Self::zeros(channels, rows, columns);
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
        ((y + 1) * self.channels + channel) * self.stride + LEFT
    }

    /// Everything that a convolution may read for the outputs of row `y`: from one row above and one column to the left.
    pub(super) fn around_row(&self, y: usize) -> &[f32] {
        &self.data[y * self.channels * self.stride + LEFT - 1..]
    }

    /// Where in [`Map::around_row`] the neighbour at `[rows, columns]` (-1, 0 or 1 each) of the row's first pixel is.
    pub(super) fn offset(&self, channel: usize, [down, right]: [isize; 2]) -> usize {
        let row = down.wrapping_add(1).cast_unsigned();
        (row * self.channels + channel) * self.stride + right.wrapping_add(1).cast_unsigned()
    }

    /// The row of each channel with the columns up to the end of the last block, and the distance between channels.
    pub(super) fn blocks_of_row(&self, y: usize) -> (&[f32], usize) {
        let start = self.start(0, y);
        (&self.data[start..start + self.channels * self.stride - LEFT], self.stride)
    }

    /// As [`Map::blocks_of_row`], to write to.
    pub(super) fn blocks_of_row_mut(&mut self, y: usize) -> (&mut [f32], usize) {
        let start = self.start(0, y);
        (&mut self.data[start..start + self.channels * self.stride - LEFT], self.stride)
    }

    /// Sets all numbers to zero.
    pub fn clear(&mut self) {
        self.data.fill(0.0);
    }

    /// Sets to zero what blocks wrote to the right of the last column of a row.
    pub(super) fn clear_right(&mut self, y: usize) {
        for channel in 0..self.channels {
            let start = self.start(channel, y);
            self.data[start + self.columns..start + self.stride - LEFT].fill(0.0);
        }
    }
}
