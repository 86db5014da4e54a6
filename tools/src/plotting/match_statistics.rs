//! Below the images of [`super::matches`]: histograms of reprojection errors and descriptor distances, and the other
//! candidates.

use plotters::style::RGBColor;
use recognition::{InspectedKeyframe, InspectedMatch, Inspection, KeyframeVerdict};

use super::canvas::{BAD, GOOD, GRID, INK, MAP, ODOMETRY, TRUTH};
use super::match_layout::{MARGIN, WIDTH};
use super::svg::{Anchor, Attribute, Svg, css};

/// Height of the bars, px.
const BARS: f64 = 136.0;
/// Space for the heading, px.
const HEADING: f64 = 40.0;
/// Bars of a histogram.
const BINS: usize = 24;
/// Candidates that are listed.
const LISTED: usize = 7;
/// Height of a candidate's line, px.
const LINE: f64 = 23.0;
/// The histogram of errors ends at this multiple of the gate; what is beyond counts in the last bar.
const GATES: f64 = 2.0;

/// Draws the row of statistics.
///
/// # Arguments
/// * `keyframe`: the one in the picture.
/// * `top`: where the row begins (px).
pub(super) fn draw_statistics(
    svg: &mut Svg,
    inspection: &Inspection,
    keyframe: &InspectedKeyframe,
    top: f64,
) {
    let width = (WIDTH - 4.0 * MARGIN) / 3.6;
    let (first, second) = (MARGIN, 2.0 * MARGIN + width);
    let has_pose = keyframe.global_from_camera.is_some();
    let other = if has_pose { BAD } else { ODOMETRY };

    let reach = GATES * keyframe.gate_px;
    let error = |found: &InspectedMatch| found.error_px().unwrap_or(f64::INFINITY);
    let mut errors = Histogram::new(first, top, width, reach, other);
    if has_pose {
        errors.fill(keyframe, error);
        errors.draw(svg, "reprojection error of the matches, px", &format!("\u{2265} {reach:.0}"), |value| {
            format!("{value:.0}")
        });
        errors.mark(svg, keyframe.gate_px, "gate");
    } else {
        errors.heading(svg, "no pose, so no reprojection errors");
    }

    let largest = keyframe.matches.iter().map(|found| f64::from(found.distance)).fold(0.0, f64::max);
    let mut distances = Histogram::new(second, top, width, if largest > 0.0 { largest } else { 1.0 }, other);
    distances.fill(keyframe, |found| f64::from(found.distance));
    let end = format!("{:.2}", distances.reach);
    distances.draw(svg, "descriptor distance of the matches", &end, |value| format!("{value:.2}"));

    let third = second + width + MARGIN;
    list_candidates(svg, inspection, keyframe, (third, top), WIDTH - MARGIN - third);
}

/// Inliers and the other matches by some quantity, stacked.
struct Histogram {
    left: f64,
    top: f64,
    width: f64,
    reach: f64,
    other: RGBColor,
    inliers: [usize; BINS],
    others: [usize; BINS],
}

impl Histogram {
    fn new(left: f64, top: f64, width: f64, reach: f64, other: RGBColor) -> Self {
        Self { left, top, width, reach, other, inliers: [0; BINS], others: [0; BINS] }
    }

    fn fill(&mut self, keyframe: &InspectedKeyframe, value: impl Fn(&InspectedMatch) -> f64) {
        for found in &keyframe.matches {
            // An infinite value is cast to the largest number, and falls into the last bin.
            let bin = (value(found) / self.reach * BINS as f64) as usize;
            let bins = if found.inlier { &mut self.inliers } else { &mut self.others };
            bins[bin.min(BINS - 1)] += 1;
        }
    }

    fn x(&self, value: f64) -> f64 {
        self.left + self.width * value / self.reach
    }

    fn floor(&self) -> f64 {
        self.top + HEADING + BARS
    }

    fn heading(&self, svg: &mut Svg, words: &str) {
        svg.words((self.left, self.top + 22.0), 15.0, Anchor::Start, INK, words);
    }

    fn draw(&self, svg: &mut Svg, heading: &str, end: &str, label: impl Fn(f64) -> String) {
        self.heading(svg, heading);
        let floor = self.floor();
        let counts = self.inliers.iter().zip(&self.others);
        let highest = counts.map(|(inliers, others)| inliers + others).max().unwrap_or(0).max(1);
        let height = |count: usize| BARS * count as f64 / highest as f64;
        let step = self.width / BINS as f64;
        for (bin, (&inliers, &others)) in self.inliers.iter().zip(&self.others).enumerate() {
            let x = self.left + step * bin as f64;
            let mut bar = |from: f64, count: usize, colour: RGBColor| {
                if count > 0 {
                    let (at, size) = ((x + 0.5, from - height(count)), (step - 1.0, height(count)));
                    svg.rectangle(at, size, &[("fill", &css(colour))]);
                }
            };
            bar(floor, inliers, GOOD);
            bar(floor - height(inliers), others, self.other);
            if inliers + others == highest {
                let above = (x + step / 2.0, floor - BARS - 3.0);
                svg.words(above, 11.0, Anchor::Middle, INK, &highest.to_string());
            }
        }
        let axis: [Attribute<'_>; 1] = [("stroke", &css(TRUTH))];
        svg.line((self.left, floor), (self.left + self.width, floor), &axis);
        for quarter in 0..4 {
            let value = self.reach * f64::from(quarter) / 4.0;
            let anchor = if quarter == 0 { Anchor::Start } else { Anchor::Middle };
            svg.words((self.x(value), floor + 18.0), 12.5, anchor, INK, &label(value));
        }
        svg.words((self.left + self.width, floor + 18.0), 12.5, Anchor::End, INK, end);
    }

    fn mark(&self, svg: &mut Svg, value: f64, name: &str) {
        let (x, top) = (self.x(value), self.top + HEADING);
        let stroke: [Attribute<'_>; 2] = [("stroke", &css(INK)), ("stroke-dasharray", &"5 4")];
        svg.line((x, top), (x, self.floor()), &stroke);
        svg.words((x + 6.0, top + 12.0), 12.5, Anchor::Start, INK, name);
    }
}

/// The result of the comparison with a keyframe.
pub fn describe_verdict(keyframe: &InspectedKeyframe) -> &'static str {
    match (keyframe.verdict, keyframe.in_answer) {
        (KeyframeVerdict::Verified, true) => "part of the answer",
        (KeyframeVerdict::Verified, false) => "verified",
        (KeyframeVerdict::PoseUncertain, _) => "pose too uncertain",
        (KeyframeVerdict::NoPose, _) => "no pose fits",
        (KeyframeVerdict::TooFewMatches, _) => "too few matches",
    }
}

/// Matches and inliers of the candidates as bars, the keyframe of the picture in bold.
fn list_candidates(
    svg: &mut Svg,
    inspection: &Inspection,
    shown: &InspectedKeyframe,
    (left, top): (f64, f64),
    width: f64,
) {
    let listed = &inspection.keyframes[..inspection.keyframes.len().min(LISTED)];
    let heading =
        format!("best {} of {} candidates: inliers of matches", listed.len(), inspection.keyframes.len());
    svg.words((left, top + 22.0), 15.0, Anchor::Start, INK, &heading);
    let most = listed.iter().map(|keyframe| keyframe.matches.len()).max().unwrap_or(0).max(1);
    let (bar_left, bar_width) = (left + 112.0, width - 112.0 - 208.0);
    for (line, keyframe) in listed.iter().enumerate() {
        let y = top + HEADING + LINE * line as f64;
        if keyframe.id == shown.id {
            let place = ((left - 6.0, y), (width + 6.0, LINE - 2.0));
            svg.rectangle(place.0, place.1, &[("fill", &css(GRID)), ("rx", &3)]);
        }
        let base = y + 15.0;
        svg.words((left, base), 13.0, Anchor::Start, INK, &format!("keyframe {}", keyframe.id));
        let (matches, inliers) = (keyframe.matches.len(), keyframe.inliers());
        let long = |count: usize| bar_width * count as f64 / most as f64;
        svg.rectangle((bar_left, y + 4.0), (long(matches), LINE - 10.0), &[("fill", &css(MAP))]);
        svg.rectangle((bar_left, y + 4.0), (long(inliers), LINE - 10.0), &[("fill", &css(GOOD))]);
        let numbers = format!("{inliers} of {matches}");
        svg.words((bar_left + bar_width + 72.0, base), 13.0, Anchor::End, INK, &numbers);
        let verdict = describe_verdict(keyframe);
        svg.words((bar_left + bar_width + 84.0, base), 13.0, Anchor::Start, INK, verdict);
    }
}
