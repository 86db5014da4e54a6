//! The report of a review as a page; the layout is the template `templates/review.html`.

use super::figures::{ColdFigures, DriveFigures};
use super::{Refusal, Review};
use anyhow::{Context as _, Result};
use askama::Template;
use map::difference::{ChangedPlace, ElementCounts};
use std::path::Path;

/// Width of the map, px.
const WIDTH: f64 = 900.0;
/// Margin around what is drawn, px.
const MARGIN: f64 = 20.0;
/// So many places are listed; the JSON has all of them.
const MAX_PLACES: usize = 30;

/// The page.
#[derive(Template)]
#[template(path = "review.html")]
struct Page<'a> {
    live: &'a str,
    candidate: &'a str,
    refusals: &'a [Refusal],
    /// A row each: name, live, candidate.
    maps: Vec<[String; 3]>,
    drives: Vec<DriveTable<'a>>,
    /// New, gone, moved, motion.
    changes: Vec<[String; 5]>,
    plan: Plan,
}

struct DriveTable<'a> {
    recording: &'a str,
    rows: Vec<[String; 3]>,
}

/// The plan view, px.
struct Plan {
    height: f64,
    unmoved: Vec<[f64; 2]>,
    added: Vec<[f64; 2]>,
    removed: Vec<[f64; 2]>,
    motions: Vec<[[f64; 2]; 2]>,
    emptied: Vec<[f64; 2]>,
    paths: Vec<String>,
    /// Length of a bar of 10 m.
    ten_metres: f64,
}

/// Writes the report of a review.
///
/// # Errors
/// A file that cannot be written.
pub fn write_page(review: &Review, file: &Path) -> Result<()> {
    let page = Page {
        live: &review.live,
        candidate: &review.candidate,
        refusals: &review.refusals,
        maps: map_rows(review),
        drives: review
            .drives
            .iter()
            .map(|drive| DriveTable {
                recording: &drive.recording,
                rows: drive_rows(&drive.live, &drive.candidate),
            })
            .collect(),
        changes: change_rows(review),
        plan: Plan::of(review),
    };
    let text = page.render().context("the report cannot be made")?;
    files::write_whole(file, text.as_bytes()).with_context(|| format!("{} cannot be written", file.display()))
}

fn row(name: &str, live: String, candidate: String) -> [String; 3] {
    [name.to_owned(), live, candidate]
}

fn map_rows(review: &Review) -> Vec<[String; 3]> {
    let (live, candidate) = (&review.structure.live, &review.structure.candidate);
    vec![
        row("version", live.version.to_string(), candidate.version.to_string()),
        row("keyframes", live.keyframes.to_string(), candidate.keyframes.to_string()),
        row("landmarks", live.landmarks.to_string(), candidate.landmarks.to_string()),
        row("views that could be of another place", percent(live.aliased), percent(candidate.aliased)),
        row(
            "keyframes that moved beyond what the live map states",
            String::new(),
            format!("{} of {}", review.structure.unexplained.len(), review.structure.common_keyframes),
        ),
        row("places that moved so", String::new(), review.structure.moved_m.len().to_string()),
        row(
            "places without a keyframe that looks the same way",
            String::new(),
            format!("{} of {}", review.structure.emptied_m.len(), review.structure.places),
        ),
    ]
}

fn drive_rows(live: &DriveFigures, candidate: &DriveFigures) -> Vec<[String; 3]> {
    let both = |name: &str, of: &dyn Fn(&DriveFigures) -> String| row(name, of(live), of(candidate));
    let cold =
        |name: &str, of: &dyn Fn(&ColdFigures) -> String| row(name, of(&live.cold), of(&candidate.cold));
    let number = |value: Option<f64>, digits: usize| {
        value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
    };
    let is_to_truth = candidate.errors.as_ref().is_none_or(|errors| errors.is_to_truth);
    let of = if is_to_truth { "error to the truth" } else { "difference to the live map" };
    vec![
        both("answers that updated the robot", &|figures| {
            format!("{} of {}", figures.accepted, figures.queries)
        }),
        both("answers that matched", &|figures| format!("{} of {}", figures.matched, figures.queries)),
        both("part of the drive localized", &|figures| percent(figures.localized)),
        both("squared innovation a degree of freedom", &|figures| number(figures.innovation, 2)),
        both(&format!("{of}, RMS, m"), &|figures| {
            number(figures.errors.as_ref().map(|errors| errors.rmse_m), 3)
        }),
        both(&format!("{of}, largest, m"), &|figures| {
            number(figures.errors.as_ref().map(|errors| errors.largest_m), 3)
        }),
        both(&format!("{of}, RMS, deg"), &|figures| {
            number(figures.errors.as_ref().map(|errors| errors.rmse_deg), 3)
        }),
        both("NEES", &|figures| number(figures.errors.as_ref().and_then(|errors| errors.nees), 2)),
        cold("images localized by themselves", &|cold| format!("{} of {}", cold.localized, cold.images)),
        cold("in a wrong place", &|cold| cold.wrong.to_string()),
        cold("of a place that is not known (by the truth, or without one by the live map)", &|cold| {
            cold.unjudged.to_string()
        }),
        cold("ambiguous", &|cold| cold.ambiguous.to_string()),
        cold("first pose from cold, s: median, 95 %", &|cold| {
            format!("{:.1}, {:.1}", cold.map_initialization_median_s, cold.map_initialization_p95_s)
        }),
    ]
}

fn change_rows(review: &Review) -> Vec<[String; 5]> {
    let difference = &review.structure.difference;
    let mut rows = vec![
        change_row("keyframes".to_owned(), &difference.keyframes),
        change_row("landmarks".to_owned(), &difference.landmarks),
    ];
    for ChangedPlace { centre_m: [x, y, z], keyframes, landmarks } in
        difference.places.iter().take(MAX_PLACES)
    {
        let at = format!("({x:.1}, {y:.1}, {z:.1}) m");
        rows.push(change_row(format!("{at}: keyframes"), keyframes));
        rows.push(change_row(format!("{at}: landmarks"), landmarks));
    }
    rows
}

fn change_row(name: String, counts: &ElementCounts) -> [String; 5] {
    let motion = counts.motion.map(|motion| format!("{:.3}, {:.3}", motion.median_m, motion.largest_m));
    let numbers = [counts.added, counts.removed, counts.moved].map(|count| count.to_string());
    let [added, removed, moved] = numbers;
    [name, added, removed, moved, motion.unwrap_or_default()]
}

fn percent(part: f64) -> String {
    format!("{:.0} %", 100.0 * part)
}

impl Plan {
    fn of(review: &Review) -> Self {
        let structure = &review.structure;
        let ends = structure.motions.iter().flatten();
        let points = structure.unmoved.iter().chain(&structure.added).chain(&structure.removed).chain(ends);
        let (low, high) = points.fold(([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]), |(low, high), point| {
            ([0, 1].map(|axis| point[axis].min(low[axis])), [0, 1].map(|axis| point[axis].max(high[axis])))
        });
        let span = [0, 1].map(|axis| (high[axis] - low[axis]).max(1.0));
        let scale = (WIDTH - 2.0 * MARGIN) / span[0].max(span[1]);
        let height = span[1] * scale + 2.0 * MARGIN;
        let rounded = |value: f64| (value * 10.0).round() / 10.0;
        // y points up in the plan.
        let place = |point: &[f64; 2]| {
            [
                rounded(MARGIN + (point[0] - low[0]) * scale),
                rounded(height - MARGIN - (point[1] - low[1]) * scale),
            ]
        };
        let all = |points: &[[f64; 2]]| points.iter().map(place).collect::<Vec<_>>();
        let path = |points: &[[f64; 2]]| {
            all(points).iter().map(|[x, y]| format!("{x},{y}")).collect::<Vec<_>>().join(" ")
        };
        let emptied: Vec<[f64; 2]> = structure.emptied_m.iter().map(|[x, y, _]| [*x, *y]).collect();
        Self {
            height: rounded(height),
            unmoved: all(&structure.unmoved),
            added: all(&structure.added),
            removed: all(&structure.removed),
            motions: structure.motions.iter().map(|ends| [place(&ends[0]), place(&ends[1])]).collect(),
            emptied: all(&emptied),
            paths: review.drives.iter().map(|drive| path(&drive.path)).collect(),
            ten_metres: rounded(10.0 * scale),
        }
    }
}
