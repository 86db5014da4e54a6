//! The sheet of a plot: title, legend, and the area below for panels.

use super::font::Letters;
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
/// Height of the title, and of a line of the legend, px.
const TITLE_LINE: i32 = 40;
const LEGEND_LINE: i32 = 24;
/// Room below the legend, px.
const BELOW_LEGEND: i32 = 4;
/// Room at the left and the right of texts, px.
const SIDE: i32 = 22;
/// Height of a line of the caption, px, and of its letters.
const CAPTION_LINE: i32 = 20;
const CAPTION_SIZE: i32 = 14;
const TITLE_SIZE: i32 = 21;
const LEGEND_SIZE: i32 = 15;
/// From the left of a mark to its text, and from the end of a text to the next mark, px.
const BESIDE_MARK: i32 = 31;
const BETWEEN_ENTRIES: i32 = 26;
/// Grey bands, where there is no map.
pub(crate) const SHADE: RGBColor = RGBColor(232, 232, 228);

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

/// Height of title, caption and legend above a picture of a width, px.
pub(crate) fn header_height(width: u32, caption: &[String], legend: &[LegendEntry]) -> i32 {
    let lines = caption_lines(width, caption).len() as i32;
    TITLE_LINE + CAPTION_LINE * lines + LEGEND_LINE * places(width, legend).rows + BELOW_LEGEND
}

/// Draws a picture: title, lines of a caption, legend, and what `fill` puts below. Texts that are too long are broken; the
/// title is cut.
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
        let lines = caption_lines(size.0, caption);
        let (header, body) = sheet.split_vertically(header_height(size.0, caption, legend));
        let style = TextStyle::from((FONT, TITLE_SIZE).into_font()).color(&INK);
        let title = Letters::of_size(TITLE_SIZE).cut(title, size.0 as i32 - 2 * SIDE);
        header.draw(&Text::new(title, (20, 12), style))?;
        let style = TextStyle::from((FONT, CAPTION_SIZE).into_font()).color(&INK);
        for (line, top) in lines.iter().zip((0..).map(|line| TITLE_LINE + 2 + CAPTION_LINE * line)) {
            header.draw(&Text::new(line.as_str(), (SIDE, top), style.clone()))?;
        }
        let middle = TITLE_LINE + CAPTION_LINE * lines.len() as i32 + LEGEND_LINE / 2;
        draw_legend(&header, legend, &places(size.0, legend), middle)?;
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

fn caption_lines(width: u32, caption: &[String]) -> Vec<String> {
    let letters = Letters::of_size(CAPTION_SIZE);
    caption.iter().flat_map(|line| letters.lines(line, width as i32 - 2 * SIDE)).collect()
}

/// Where the entries of a legend are.
struct Places {
    /// Left end, px, and line of each.
    entries: Vec<(i32, i32)>,
    /// Number of lines.
    rows: i32,
}

/// Sets the entries of a legend one after the other, on as many lines as they need.
fn places(width: u32, legend: &[LegendEntry]) -> Places {
    let letters = Letters::of_size(LEGEND_SIZE);
    let (mut x, mut row) = (SIDE, 0);
    let mut entries = Vec::with_capacity(legend.len());
    for entry in legend {
        let taken = BESIDE_MARK + letters.width(&entry.text);
        if x > SIDE && x + taken > width as i32 - SIDE {
            (x, row) = (SIDE, row + 1);
        }
        entries.push((x, row));
        x += taken + BETWEEN_ENTRIES;
    }
    Places { entries, rows: if legend.is_empty() { 0 } else { row + 1 } }
}

fn draw_legend(header: &Area<'_>, legend: &[LegendEntry], places: &Places, first: i32) -> anyhow::Result<()> {
    let style = TextStyle::from((FONT, LEGEND_SIZE).into_font()).color(&INK);
    for (entry, &(x, row)) in legend.iter().zip(&places.entries) {
        let (colour, middle) = (entry.colour, first + row * LEGEND_LINE);
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
        let at = (x + BESIDE_MARK, middle - LEGEND_SIZE / 2);
        header.draw(&Text::new(entry.text.as_str(), at, style.clone()))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entries_of_a_legend_stay_on_the_sheet_and_apart() {
        let names = [
            "truth",
            "pose in G",
            "3 standard deviations, by the filter",
            "no map",
            "answer used",
            "answer refused",
        ];
        let legend: Vec<_> = names.iter().map(|name| entry(Mark::Line, TRUTH, name)).collect();
        let letters = Letters::of_size(LEGEND_SIZE);
        for width in [400, 700, 2000] {
            let placed = places(width, &legend);
            let ends: Vec<i32> = placed
                .entries
                .iter()
                .zip(&legend)
                .map(|((x, _), entry)| x + BESIDE_MARK + letters.width(&entry.text))
                .collect();
            assert!(ends.iter().all(|end| *end <= width as i32 - SIDE), "{width}: {ends:?}");
            for (pair, end) in placed.entries.windows(2).zip(&ends) {
                assert!(pair[0].1 < pair[1].1 || *end < pair[1].0, "{width}");
            }
            assert_eq!(placed.rows, placed.entries[5].1 + 1);
        }
        assert_eq!(places(2000, &legend).rows, 1);
        assert!(places(400, &legend).rows > 1);
    }
}
