//! Pictures in pixels, drawn from the SVG files.

use super::canvas::not_written;
use super::font::{FONT_FAMILY, FONT_FILE};
use anyhow::Context as _;
use resvg::tiny_skia::{Pixmap, Transform};
use resvg::usvg::{Options, Tree};
use std::path::{Path, PathBuf};

/// Draws an SVG file of ours into a PNG file beside it.
///
/// # Arguments
/// * `scale`: pixels a unit of the SVG.
///
/// # Errors
/// The SVG file cannot be read, or the PNG file cannot be written.
pub fn draw_png(svg: &Path, scale: f32) -> anyhow::Result<PathBuf> {
    let path = svg.with_extension("png");
    let text = ::files::read_to_string(svg).with_context(|| svg.display().to_string())?;
    let mut options = Options::default();
    options.fontdb_mut().load_font_data(FONT_FILE.to_vec());
    options.fontdb_mut().set_sans_serif_family(FONT_FAMILY);
    let tree = Tree::from_str(&text, &options).with_context(|| svg.display().to_string())?;
    let size = tree.size();
    let pixels = |length: f32| (length * scale).ceil() as u32;
    let mut picture = Pixmap::new(pixels(size.width()), pixels(size.height())).with_context(|| {
        format!("{}: a picture of {} x {} cannot be drawn", svg.display(), size.width(), size.height())
    })?;
    resvg::render(&tree, Transform::from_scale(scale, scale), &mut picture.as_mut());
    picture.save_png(&path).with_context(|| not_written(&path))?;
    Ok(path)
}
