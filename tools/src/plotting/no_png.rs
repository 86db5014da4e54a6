//! In place of pictures in pixels, in a build without them.

use anyhow::bail;
use std::path::{Path, PathBuf};

/// Refuses to draw a PNG file.
///
/// # Errors
/// Always, naming the feature.
pub fn draw_png(svg: &Path, _: f32) -> anyhow::Result<PathBuf> {
    bail!(
        "{}: this program was built without the feature `png`: build it with `cargo build --release -p driftless-tools`",
        svg.display()
    )
}
