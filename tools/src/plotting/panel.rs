//! One set of axes with lines, bands and dots.

use super::canvas::{Area, FONT, GRID, INK};
use super::error::DrawError;
use plotters::prelude::*;
use std::ops::Range;

/// A line through points.
pub(crate) struct Line {
    pub(crate) points: Vec<(f64, f64)>,
    pub(crate) colour: RGBColor,
    pub(crate) width: u32,
}

/// Dots at points.
pub(crate) struct Dots {
    pub(crate) points: Vec<(f64, f64)>,
    pub(crate) colour: RGBColor,
    pub(crate) radius: u32,
}

/// The space between `-height` and `height`.
pub(crate) struct Band {
    pub(crate) heights: Vec<(f64, f64)>,
    pub(crate) colour: RGBColor,
}

/// Upright lines from 0 to points.
pub(crate) struct Needles {
    pub(crate) points: Vec<(f64, f64)>,
    pub(crate) colour: RGBColor,
    pub(crate) width: u32,
}

/// One set of axes. What is listed later is drawn over what is listed before.
#[derive(Default)]
pub(crate) struct Panel {
    /// Above the axes; empty for none.
    pub(crate) title: String,
    pub(crate) x_label: &'static str,
    pub(crate) y_label: String,
    pub(crate) x: Range<f64>,
    pub(crate) y: Range<f64>,
    pub(crate) bands: Vec<Band>,
    pub(crate) needles: Vec<Needles>,
    pub(crate) lines: Vec<Line>,
    pub(crate) dots: Vec<Dots>,
}

/// Room for the numbers beside and below the axes, px.
const LEFT: u32 = 74;
const BELOW: u32 = 40;
/// Room around the axes, px.
const MARGIN: u32 = 8;
const RIGHT: u32 = 18;
const LETTERS: u32 = 14;

/// Pixels of an area that are left for the axes themselves: width, height.
pub(crate) fn inner_size(area: &Area<'_>) -> (f64, f64) {
    let (width, height) = area.dim_in_pixel();
    let beside = LEFT + MARGIN + RIGHT;
    let above = BELOW + 2 * MARGIN;
    (f64::from(width.saturating_sub(beside).max(1)), f64::from(height.saturating_sub(above).max(1)))
}

impl Panel {
    /// Draws the panel into an area.
    pub(crate) fn draw(&self, area: &Area<'_>) -> Result<(), DrawError> {
        let mut builder = ChartBuilder::on(area);
        if !self.title.is_empty() {
            builder.caption(&self.title, (FONT, LETTERS).into_font().color(&INK));
        }
        let mut chart = builder
            .margin(MARGIN)
            .margin_right(RIGHT)
            .x_label_area_size(BELOW)
            .y_label_area_size(LEFT)
            .build_cartesian_2d(self.x.clone(), self.y.clone())?;
        let letters = (FONT, LETTERS).into_font().color(&INK);
        chart
            .configure_mesh()
            .x_desc(self.x_label)
            .y_desc(self.y_label.as_str())
            .axis_desc_style(letters.clone())
            .label_style(letters)
            .axis_style(RGBColor(150, 150, 155))
            .bold_line_style(GRID)
            .light_line_style(TRANSPARENT)
            .x_labels(8)
            .y_labels(6)
            .x_label_formatter(&|value| number(*value, &self.x))
            .y_label_formatter(&|value| number(*value, &self.y))
            .draw()?;
        for band in &self.bands {
            let clipped =
                |(x, height): &(f64, f64), sign: f64| (*x, (sign * height).clamp(self.y.start, self.y.end));
            let upper = band.heights.iter().map(|point| clipped(point, 1.0));
            let lower = band.heights.iter().rev().map(|point| clipped(point, -1.0));
            let polygon = Polygon::new(upper.chain(lower).collect::<Vec<_>>(), band.colour.filled());
            chart.draw_series(std::iter::once(polygon))?;
        }
        for needles in &self.needles {
            let style = needles.colour.stroke_width(needles.width);
            let lines =
                needles.points.iter().map(|(x, y)| PathElement::new(vec![(*x, 0.0), (*x, *y)], style));
            chart.draw_series(lines)?;
        }
        for line in &self.lines {
            let style = line.colour.stroke_width(line.width);
            chart.draw_series(LineSeries::new(line.points.iter().copied(), style))?;
        }
        for dots in &self.dots {
            let circles =
                dots.points.iter().map(|point| Circle::new(*point, dots.radius, dots.colour.filled()));
            chart.draw_series(circles)?;
        }
        Ok(())
    }
}

/// A number on an axis, with as many decimals as the axis needs.
fn number(value: f64, range: &Range<f64>) -> String {
    let step = (range.end - range.start) / 8.0;
    let decimals = (-step.log10()).ceil().clamp(0.0, 6.0) as usize;
    let shown = format!("{value:.decimals$}");
    let is_zero = shown.chars().all(|letter| matches!(letter, '-' | '0' | '.'));
    if is_zero { shown.trim_start_matches('-').to_owned() } else { shown }
}
