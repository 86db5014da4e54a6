//! Matches: the query beside a keyframe, with a line from each feature to its landmark.
//!
//! ```text
//! headline: recognized or not, counts, pose with its standard deviations
//! query image            | keyframe image         green: inliers, red: outliers, orange: no pose
//! errors in px | descriptor distances | all candidates             see `match_statistics`
//! ```
//! The images are inside the file. The pointer over a match shows its numbers. The drawing itself is the template
//! `templates/matches.svg`.

use anyhow::Context as _;
use askama::Template;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use geometry::{Camera, PoseWithCovariance};
use nalgebra::Vector3;
use recognition::{InspectedKeyframe, InspectedMatch, Inspection, KeyframeVerdict};
use std::path::{Path, PathBuf};
use vision::{GrayImage, ImageError};

use super::canvas::not_written;
use super::match_statistics::{Candidate, Histogram, describe_verdict, distances, errors, list_candidates};
use crate::server_query::describe;

/// Left sides of both images, their top and their width, px; as in the template.
const LEFT: [f64; 2] = [24.0, 762.0];
const TOP: f64 = 112.0;
const WIDTH: f64 = 714.0;
/// Height of what is written below an image, and of the statistics, px.
const CAPTION: f64 = 30.0;
const STATISTICS: f64 = 218.0;
/// Letters of a caption that fit below an image.
const CAPTION_LETTERS: usize = 96;
/// Reprojection errors are drawn so many times longer: inliers are off by a pixel or two.
const EXAGGERATION: f64 = 5.0;

/// What is drawn.
#[derive(Clone, Copy, Debug)]
pub struct MatchPicture<'a> {
    /// Name of the query.
    pub query: &'a str,
    /// The camera that took it.
    pub camera: &'a Camera,
    /// The query itself; without it the features are drawn on grey.
    pub image: Option<&'a GrayImage>,
    /// All features of the query (px).
    pub features: &'a [[f32; 2]],
    /// Name of the map.
    pub map: &'a str,
    /// The answer and its candidates.
    pub inspection: &'a Inspection,
    /// The keyframe beside the query; `None` where there was nothing to compare.
    pub keyframe: Option<&'a InspectedKeyframe>,
    /// Its image; without it the landmarks are drawn on grey.
    pub keyframe_image: Option<&'a GrayImage>,
}

/// The picture; classes are those of the template's style.
#[derive(Template)]
#[template(path = "matches.svg")]
struct Sheet {
    outcome: &'static str,
    title: String,
    detail: String,
    legend: Vec<LegendEntry>,
    query: Panel,
    keyframe: Option<Keyframe>,
    height: f64,
}

struct LegendEntry {
    class: &'static str,
    symbol: &'static str,
    text: String,
}

/// An image, with points on it.
struct Panel {
    left: f64,
    height: f64,
    /// Pixels of the sheet a pixel of the image.
    scale: f64,
    png_base64: Option<String>,
    points: Vec<(f64, f64)>,
    caption: String,
}

struct Keyframe {
    panel: Panel,
    matches: Vec<MatchLine>,
    /// Without a pose there are no reprojection errors.
    errors: Option<Histogram>,
    distances: Histogram,
    /// The class of the matches that are no inliers.
    other: &'static str,
    candidates: Vec<Candidate>,
    candidate_count: usize,
    most_matches: usize,
}

struct MatchLine {
    class: &'static str,
    hover: String,
    from: (f64, f64),
    to: (f64, f64),
    error_tip: Option<(f64, f64)>,
}

/// Draws the matches of a query with one keyframe.
///
/// # Errors
/// The plot cannot be written.
pub fn draw_matches(picture: &MatchPicture<'_>, path: &Path) -> anyhow::Result<PathBuf> {
    let text = Sheet::of(picture)?.render()?;
    std::fs::write(path, text).with_context(|| not_written(path))?;
    Ok(path.to_path_buf())
}

impl Sheet {
    fn of(picture: &MatchPicture<'_>) -> Result<Self, ImageError> {
        let caption = format!("query: {}", picture.query);
        let query = Panel::new(LEFT[0], picture.camera, picture.image, picture.features, &caption)?;
        let keyframe =
            picture.keyframe.map(|keyframe| Keyframe::of(picture, keyframe, &query)).transpose()?;
        let (outcome, title, detail) = match &picture.inspection.reply.fix {
            Some(fix) => (
                "inlier",
                format!(
                    "Recognized: {} of {} matches agree within {:.2} px on average",
                    fix.inliers, fix.matched_features, fix.mean_error_px
                ),
                pose_text(&fix.global_from_camera),
            ),
            None => (
                "outlier",
                format!("Not recognized: {}", describe(picture.inspection.reply.outcome)),
                best_match_text(picture),
            ),
        };
        let mut sheet =
            Self { outcome, title, detail, legend: legend(picture), query, keyframe, height: 0.0 };
        let statistics = if sheet.keyframe.is_some() { STATISTICS } else { 0.0 };
        sheet.height = (sheet.statistics_top() + statistics).ceil();
        Ok(sheet)
    }

    /// Where the statistics begin, px.
    fn statistics_top(&self) -> f64 {
        let beside = self.keyframe.as_ref().map_or(0.0, |keyframe| keyframe.panel.height);
        TOP + self.query.height.max(beside) + CAPTION
    }
}

impl Panel {
    fn new(
        left: f64,
        camera: &Camera,
        image: Option<&GrayImage>,
        pixels: &[[f32; 2]],
        caption: &str,
    ) -> Result<Self, ImageError> {
        let scale = WIDTH / f64::from(camera.width.max(1));
        let png = image.map(GrayImage::to_png).transpose()?;
        let mut panel = Self {
            left,
            height: rounded(scale * f64::from(camera.height)),
            scale,
            png_base64: png.map(|png| STANDARD.encode(png)),
            points: Vec::new(),
            caption: shortened(caption),
        };
        panel.points = pixels.iter().map(|pixel| panel.place(pixel.map(f64::from))).collect();
        Ok(panel)
    }

    /// Where a pixel is on the sheet; pixel (0, 0) is the centre of the first one.
    fn place(&self, pixel: [f64; 2]) -> (f64, f64) {
        let [x, y] = pixel.map(|coordinate| (coordinate + 0.5) * self.scale);
        (rounded(self.left + x), rounded(TOP + y))
    }
}

impl Keyframe {
    fn of(
        picture: &MatchPicture<'_>,
        keyframe: &InspectedKeyframe,
        query: &Panel,
    ) -> Result<Self, ImageError> {
        let caption = keyframe_text(picture, keyframe);
        let (image, pixels) = (picture.keyframe_image, &keyframe.landmark_pixels);
        let panel = Panel::new(LEFT[1], &keyframe.camera, image, pixels, &caption)?;
        let has_pose = keyframe.global_from_camera.is_some();
        let other = if has_pose { "outlier" } else { "unposed" };
        // Inliers last, on top.
        let mut matches: Vec<&InspectedMatch> = keyframe.matches.iter().collect();
        matches.sort_by_key(|found| found.inlier);
        let line = |found: &InspectedMatch| {
            let class = if found.inlier { "inlier" } else { other };
            let from = query.place(found.query_pixel.map(f64::from));
            let longer = |predicted: [f64; 2]| {
                let tip = query.place(predicted);
                (from.0 + EXAGGERATION * (tip.0 - from.0), from.1 + EXAGGERATION * (tip.1 - from.1))
            };
            MatchLine {
                class,
                hover: match_text(found, class),
                from,
                to: panel.place(found.keyframe_pixel.map(f64::from)),
                error_tip: found.predicted_pixel.filter(|_| found.inlier).map(longer),
            }
        };
        let matches = matches.into_iter().map(line).collect();
        let candidates = list_candidates(picture.inspection, keyframe);
        Ok(Self {
            panel,
            matches,
            errors: has_pose.then(|| errors(keyframe)),
            distances: distances(keyframe),
            other,
            most_matches: candidates.iter().map(|candidate| candidate.matches).max().unwrap_or(0).max(1),
            candidates,
            candidate_count: picture.inspection.keyframes.len(),
        })
    }
}

/// A pose with its standard deviations.
fn pose_text(pose: &PoseWithCovariance) -> String {
    let variance = pose.covariance.diagonal();
    let sigma = |first: usize| Vector3::from_fn(|axis, _| variance[first + axis].sqrt());
    let (theta, position, p) = (sigma(0) * 1.0_f64.to_degrees(), sigma(3), &pose.pose.translation);
    format!(
        "camera at ({:.3}, {:.3}, {:.3}) m, sigma ({:.3}, {:.3}, {:.3}) m and ({:.2}, {:.2}, {:.2}) deg",
        p.x, p.y, p.z, position.x, position.y, position.z, theta.x, theta.y, theta.z
    )
}

/// The best match of a query that was not recognized.
fn best_match_text(picture: &MatchPicture<'_>) -> String {
    let features = picture.features.len();
    let Some(keyframe) = picture.keyframe else { return format!("{features} features in the query") };
    let (id, matches) = (keyframe.id, keyframe.matches.len());
    let why = match keyframe.verdict {
        KeyframeVerdict::TooFewMatches => "too few to look for a pose".to_owned(),
        KeyframeVerdict::NoPose => "no camera pose explains enough of them".to_owned(),
        KeyframeVerdict::PoseUncertain => {
            format!("the pose of {} inliers is too uncertain", keyframe.inliers())
        }
        KeyframeVerdict::Verified => format!("{} agree on a pose", keyframe.inliers()),
    };
    format!("{features} features in the query, {matches} match keyframe {id}: {why}")
}

fn legend(picture: &MatchPicture<'_>) -> Vec<LegendEntry> {
    const LINE: &str = "\u{2501}\u{2501}";
    const DOT: &str = "\u{25cf}";
    let entry = |class, symbol, text| LegendEntry { class, symbol, text };
    let mut legend = Vec::new();
    if let Some(keyframe) = picture.keyframe {
        let (matches, inliers) = (keyframe.matches.len(), keyframe.inliers());
        if keyframe.global_from_camera.is_some() {
            let outliers =
                format!("{} outliers: off by more than {:.1} px", matches - inliers, keyframe.gate_px);
            legend.push(entry("inlier", LINE, format!("{inliers} inliers")));
            legend.push(entry("outlier", LINE, outliers));
            let error = format!("reprojection error, drawn {EXAGGERATION} times longer");
            legend.push(entry("error", LINE, error));
        } else {
            let unposed = format!("{matches} matches, without a pose to tell right from wrong");
            legend.push(entry("unposed", LINE, unposed));
        }
        let landmarks = format!("{} landmarks of the keyframe", keyframe.landmark_pixels.len());
        legend.push(entry("landmark", DOT, landmarks));
    }
    legend.push(entry("feature", DOT, format!("{} features of the query", picture.features.len())));
    legend
}

/// The caption of the keyframe.
fn keyframe_text(picture: &MatchPicture<'_>, keyframe: &InspectedKeyframe) -> String {
    let is_candidate = picture.inspection.keyframes.iter().any(|candidate| candidate.id == keyframe.id);
    let error = keyframe.mean_error_px.map_or_else(String::new, |error| format!(" within {error:.2} px"));
    format!(
        "keyframe {} of {}: {} of {} matches agree{error}, {}{}",
        keyframe.id,
        picture.map,
        keyframe.inliers(),
        keyframe.matches.len(),
        describe_verdict(keyframe),
        if is_candidate { "" } else { ", not among the candidates" }
    )
}

/// The tooltip of a match.
fn match_text(found: &InspectedMatch, class: &str) -> String {
    let error = match (found.error_px(), class) {
        (Some(error), _) => format!("reprojection error {error:.2} px"),
        (None, "outlier") => "landmark behind the camera".to_owned(),
        (None, _) => "no pose, no reprojection error".to_owned(),
    };
    format!(
        "{class}: feature {} and landmark {}\ndescriptor distance {:.3}\n{error}",
        found.feature, found.landmark, found.distance
    )
}

/// A caption that fits below an image. Of a text that is too long the end is shown: the most specific part of a path.
/// What XML cannot hold (in the name of a file) becomes the replacement character.
fn shortened(caption: &str) -> String {
    let replaced = |letter: char| letter.is_control() || matches!(letter, '\u{fffe}' | '\u{ffff}');
    let letters = caption.chars().map(|letter| if replaced(letter) { '\u{fffd}' } else { letter });
    let length = caption.chars().count();
    if length <= CAPTION_LETTERS {
        return letters.collect();
    }
    std::iter::once('\u{2026}').chain(letters.skip(length - CAPTION_LETTERS + 1)).collect()
}

/// A coordinate as precise as a picture needs it.
fn rounded(value: f64) -> f64 {
    (value * 100.0).round() / 100.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn captions_are_shortened_at_their_begin_and_hold_no_control_characters() {
        assert_eq!(shortened("a < b\u{1}"), "a < b\u{fffd}");
        let long = shortened(&format!("{}/image.png", "folder".repeat(30)));
        assert!(long.starts_with("\u{2026}") && long.ends_with("/image.png"), "{long}");
        assert_eq!(long.chars().count(), CAPTION_LETTERS);
    }

    #[test]
    fn texts_cannot_break_out_of_the_markup() {
        let camera = Camera {
            width: 4,
            height: 3,
            focal: [1.0; 2],
            centre: [1.5, 1.0],
            distortion: geometry::Distortion::None,
        };
        let query = Panel::new(LEFT[0], &camera, None, &[], "\"><script> & more").unwrap();
        let (title, detail) = ("a < b".to_owned(), String::new());
        let sheet = Sheet {
            outcome: "inlier",
            title,
            detail,
            legend: Vec::new(),
            query,
            keyframe: None,
            height: 9.0,
        };
        let text = sheet.render().unwrap();
        assert!(!text.contains("<script") && !text.contains("a < b") && text.ends_with("</svg>"), "{text}");
    }
}
