//! One set of axes with series of points.

use super::canvas::{Area, FONT, GRID, INK};
use plotters::prelude::*;
use std::ops::Range;

/// Points, and how they are drawn.
pub(crate) struct Series {
    pub(crate) points: Vec<(f64, f64)>,
    pub(crate) colour: RGBColor,
    pub(crate) shape: Shape,
}

/// How points are drawn; sizes in px.
#[derive(Clone, Copy)]
pub(crate) enum Shape {
    /// A line of a width through them.
    Line(u32),
    /// Dots of a radius.
    Dots(u32),
    /// The space between `-y` and `y`.
    Band,
    /// Upright lines of a width from 0.
    Needles(u32),
}

impl Series {
    /// A line through points.
    pub(crate) fn line(points: Vec<(f64, f64)>, colour: RGBColor, width: u32) -> Self {
        Self { points, colour, shape: Shape::Line(width) }
    }

    /// Columns over the whole height.
    pub(crate) fn columns(stretches: &[Range<f64>], colour: RGBColor) -> impl Iterator<Item = Self> {
        stretches.iter().map(move |stretch| Self {
            points: vec![(stretch.start, f64::MAX), (stretch.end, f64::MAX)],
            colour,
            shape: Shape::Band,
        })
    }

    /// Dots at points.
    pub(crate) fn dots(points: Vec<(f64, f64)>, colour: RGBColor, radius: u32) -> Self {
        Self { points, colour, shape: Shape::Dots(radius) }
    }
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
    pub(crate) series: Vec<Series>,
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
    pub(crate) fn draw(&self, area: &Area<'_>) -> anyhow::Result<()> {
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
        for Series { points, colour, shape } in &self.series {
            match *shape {
                Shape::Line(width) => {
                    let line = LineSeries::new(points.iter().copied(), colour.stroke_width(width));
                    chart.draw_series(line)?;
                }
                Shape::Dots(radius) => {
                    chart.draw_series(points.iter().map(|at| Circle::new(*at, radius, colour.filled())))?;
                }
                Shape::Band => {
                    let clipped = |(x, y): (f64, f64)| (x, y.clamp(self.y.start, self.y.end));
                    let lower = points.iter().rev().map(|(x, y)| (*x, -y));
                    let outline = points.iter().copied().chain(lower).map(clipped);
                    chart.draw_series([Polygon::new(outline.collect::<Vec<_>>(), colour.filled())])?;
                }
                Shape::Needles(width) => {
                    let upright = |(x, y): &(f64, f64)| {
                        PathElement::new(vec![(*x, 0.0), (*x, *y)], colour.stroke_width(width))
                    };
                    chart.draw_series(points.iter().map(upright))?;
                }
            }
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
