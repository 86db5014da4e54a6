//! The sheet of a plot: title, legend, and the area below for panels.

use anyhow::Context as _;
use plotters::coord::Shift;
use plotters::prelude::*;
use std::path::{Path, PathBuf};

/// Where plots are drawn.
pub(crate) type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// Ground truth.
pub(crate) const TRUTH: RGBColor = RGBColor(165, 165, 168);
/// The estimate.
pub(crate) const ESTIMATE: RGBColor = RGBColor(31, 101, 173);
/// Odometry, and what is to be distinguished from the estimate.
pub(crate) const ODOMETRY: RGBColor = RGBColor(222, 125, 32);
/// Used matches, inliers.
pub(crate) const GOOD: RGBColor = RGBColor(38, 140, 88);
/// Rejected matches, outliers.
pub(crate) const BAD: RGBColor = RGBColor(200, 55, 60);
/// One colour a run or a filter of a comparison; a fifth and more share the last.
pub(crate) const COLOURS: [RGBColor; 4] = [ODOMETRY, ESTIMATE, GOOD, BAD];
/// The map.
pub(crate) const MAP: RGBColor = RGBColor(150, 120, 190);
/// Bounds.
pub(crate) const BAND: RGBColor = RGBColor(205, 222, 240);
/// Text.
pub(crate) const INK: RGBColor = RGBColor(45, 45, 50);
/// Grid lines.
pub(crate) const GRID: RGBColor = RGBColor(228, 228, 232);

/// The font of all text, by its generic name: the viewer chooses it.
pub(crate) const FONT: &str = "sans-serif";
/// Height of title and legend, px.
const HEADER: i32 = 68;
/// Height of a line of the caption, px, and of its letters.
const CAPTION_LINE: i32 = 20;
const CAPTION_SIZE: i32 = 14;
const TITLE_SIZE: i32 = 21;
const LEGEND_SIZE: i32 = 15;
/// Mean width of a letter as a fraction of its height; no font is loaded to measure it.
const LETTER_WIDTH: f64 = 0.44;

/// Symbol of an entry of the legend.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Mark {
    Line,
    Patch,
    Dot,
}

/// An entry of the legend.
pub(crate) struct LegendEntry {
    pub(crate) mark: Mark,
    pub(crate) colour: RGBColor,
    pub(crate) text: String,
}

/// Shorthand for a [`LegendEntry`].
pub(crate) fn entry(mark: Mark, colour: RGBColor, text: &str) -> LegendEntry {
    LegendEntry { mark, colour, text: text.to_owned() }
}

/// Draws a picture: title, legend, and what `fill` puts below.
pub(crate) fn draw(
    path: &Path,
    size: (u32, u32),
    title: &str,
    legend: &[LegendEntry],
    fill: impl FnOnce(&Area<'_>) -> anyhow::Result<()>,
) -> anyhow::Result<PathBuf> {
    draw_with_caption(path, size, title, &[], legend, fill)
}

/// Draws a picture: title, lines of a caption, legend, and what `fill` puts below.
pub(crate) fn draw_with_caption(
    path: &Path,
    size: (u32, u32),
    title: &str,
    caption: &[String],
    legend: &[LegendEntry],
    fill: impl FnOnce(&Area<'_>) -> anyhow::Result<()>,
) -> anyhow::Result<PathBuf> {
    let paint = || {
        let sheet = SVGBackend::new(path, size).into_drawing_area();
        sheet.fill(&WHITE)?;
        let caption_height = CAPTION_LINE * caption.len() as i32;
        let (header, body) = sheet.split_vertically(HEADER + caption_height);
        let style = TextStyle::from((FONT, TITLE_SIZE).into_font()).color(&INK);
        header.draw(&Text::new(title, (20, 12), style))?;
        let style = TextStyle::from((FONT, CAPTION_SIZE).into_font()).color(&INK);
        for (line, top) in caption.iter().zip((0..).map(|line| 42 + CAPTION_LINE * line)) {
            header.draw(&Text::new(line.as_str(), (22, top), style.clone()))?;
        }
        draw_legend(&header, legend, 52 + caption_height)?;
        fill(&body)?;
        anyhow::Ok(sheet.present()?)
    };
    paint().with_context(|| not_written(path))?;
    Ok(path.to_path_buf())
}

/// What could not be done, for an error.
pub(crate) fn not_written(path: &Path) -> String {
    format!("the plot {} was not written", path.display())
}

fn draw_legend(header: &Area<'_>, legend: &[LegendEntry], middle: i32) -> anyhow::Result<()> {
    let style = TextStyle::from((FONT, LEGEND_SIZE).into_font()).color(&INK);
    let mut x = 22;
    for entry in legend {
        let colour = entry.colour;
        match entry.mark {
            Mark::Line => {
                let line = PathElement::new(vec![(x, middle), (x + 24, middle)], colour.stroke_width(3));
                header.draw(&line)?;
            }
            Mark::Patch => {
                let patch = Rectangle::new([(x, middle - 6), (x + 24, middle + 6)], colour.filled());
                header.draw(&patch)?;
            }
            Mark::Dot => {
                header.draw(&Circle::new((x + 12, middle), 5, colour.filled()))?;
            }
        }
        let label = Text::new(entry.text.as_str(), (x + 31, middle - LEGEND_SIZE / 2), style.clone());
        header.draw(&label)?;
        let width = entry.text.chars().count() as f64 * f64::from(LEGEND_SIZE) * LETTER_WIDTH;
        x += 31 + width as i32 + 26;
    }
    Ok(())
}
