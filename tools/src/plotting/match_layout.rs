//! Sizes of the plot of matches.

/// Width of the plot, px.
pub(super) const WIDTH: f64 = 1500.0;
/// Space at the border and between panels, px.
pub(super) const MARGIN: f64 = 24.0;
