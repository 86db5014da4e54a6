//! Matches: the query beside a keyframe, with a line from each feature to its landmark.
//!
//! ```text
//! headline: recognized or not, counts, pose with its standard deviations
//! query image            | keyframe image         green: inliers, red: outliers, orange: no pose
//! errors in px | descriptor distances | all candidates             see `match_statistics`
//! ```
//! The images are inside the file. The pointer over a match shows its numbers.

use geometry::{Camera, PoseWithCovariance};
use nalgebra::Vector3;
use plotters::style::RGBColor;
use recognition::{InspectedKeyframe, InspectedMatch, Inspection, KeyframeVerdict};
use std::path::{Path, PathBuf};
use vision::{GrayImage, ImageError};

use super::canvas::{BAD, GOOD, GRID, INK, MAP, ODOMETRY, TRUTH};
use super::error::PlotError;
use super::match_layout::{MARGIN, WIDTH};
use super::match_statistics::{describe_verdict, draw_statistics};
use super::svg::{Anchor, Attribute, Svg, css};
use crate::server_query::describe;

/// Height of headline and legend, px.
const HEADER: f64 = 112.0;
/// Height of what is written below an image, px.
const CAPTION: f64 = 30.0;
/// Height of the letters there, px.
const CAPTION_SIZE: f64 = 14.0;
/// Height of the statistics, px.
const FOOTER: f64 = 218.0;
/// Reprojection errors are drawn so many times longer: inliers are off by a pixel or two.
const EXAGGERATION: f64 = 5.0;
/// Mean width of a letter as a share of its height.
const LETTER_WIDTH: f64 = 0.53;
/// The lines stand out from a paler image.
const STYLE: &str = ".photo{opacity:.76}.match line{stroke-width:1.3;stroke-opacity:.75}.match .error{stroke-width:1.8;\
    stroke-opacity:1}.match circle{stroke:white;stroke-width:.8}.match:hover line{stroke-width:3.5;stroke-opacity:1}";

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

/// An image on the sheet.
struct Panel {
    left: f64,
    top: f64,
    scale: f64,
    size: (f64, f64),
}

impl Panel {
    fn new(left: f64, width: f64, camera: &Camera) -> Self {
        let scale = width / f64::from(camera.width.max(1));
        Self { left, top: HEADER, scale, size: (width, scale * f64::from(camera.height)) }
    }

    /// Where a pixel is on the sheet; pixel (0, 0) is the centre of the first one.
    fn place(&self, pixel: [f64; 2]) -> (f64, f64) {
        (self.left + (pixel[0] + 0.5) * self.scale, self.top + (pixel[1] + 0.5) * self.scale)
    }

    fn bottom(&self) -> f64 {
        self.top + self.size.1
    }
}

/// Draws the matches of a query with one keyframe.
///
/// # Errors
/// [`PlotError::Draw`] where the plot cannot be written.
pub fn draw_matches(picture: &MatchPicture<'_>, path: &Path) -> Result<PathBuf, PlotError> {
    let text = paint(picture).map_err(|error| PlotError::draw(path, error))?;
    std::fs::write(path, text).map_err(|error| PlotError::draw(path, error))?;
    Ok(path.to_path_buf())
}

fn paint(picture: &MatchPicture<'_>) -> Result<String, ImageError> {
    let width = (WIDTH - 3.0 * MARGIN) / 2.0;
    let left = Panel::new(MARGIN, width, picture.camera);
    let right_camera = picture.keyframe.map_or(picture.camera, |keyframe| &keyframe.camera);
    let right = Panel::new(2.0 * MARGIN + width, width, right_camera);
    let footer_top = left.bottom().max(right.bottom()) + CAPTION;
    let has_statistics = picture.keyframe.is_some();
    let height = footer_top + if has_statistics { FOOTER } else { 0.0 };

    let mut svg = Svg::new((WIDTH, height.ceil()), STYLE);
    draw_header(&mut svg, picture);
    draw_image(&mut svg, &left, picture.image, picture.features, TRUTH)?;
    caption(&mut svg, &left, &format!("query: {}", picture.query));
    if let Some(keyframe) = picture.keyframe {
        draw_image(&mut svg, &right, picture.keyframe_image, &keyframe.landmark_pixels, MAP)?;
        caption(&mut svg, &right, &keyframe_text(picture, keyframe));
        // Inliers last, on top.
        for inliers in [false, true] {
            for found in keyframe.matches.iter().filter(|found| found.inlier == inliers) {
                draw_match(&mut svg, found, keyframe, (&left, &right));
            }
        }
        draw_statistics(&mut svg, picture.inspection, keyframe, footer_top);
    } else {
        svg.rectangle((right.left, right.top), right.size, &[("fill", &css(GRID))]);
        let middle = (right.left + right.size.0 / 2.0, right.top + right.size.1 / 2.0);
        svg.words(middle, 18.0, Anchor::Middle, INK, "no keyframe to compare with");
    }
    Ok(svg.finish())
}

fn draw_header(svg: &mut Svg, picture: &MatchPicture<'_>) {
    let reply = &picture.inspection.reply;
    let (colour, title, detail) = match &reply.fix {
        Some(fix) => (
            GOOD,
            format!(
                "Recognized: {} of {} matches agree within {:.2} px on average",
                fix.inliers, fix.matched_features, fix.mean_error_px
            ),
            pose_text(&fix.global_from_camera),
        ),
        None => (BAD, format!("Not recognized: {}", describe(reply.outcome)), best_match_text(picture)),
    };
    svg.rectangle((MARGIN, 16.0), (6.0, 48.0), &[("fill", &css(colour))]);
    svg.words((MARGIN + 18.0, 35.0), 22.0, Anchor::Start, INK, &title);
    svg.words((MARGIN + 18.0, 60.0), 15.0, Anchor::Start, INK, &detail);
    draw_legend(svg, picture);
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

fn draw_legend(svg: &mut Svg, picture: &MatchPicture<'_>) {
    let (mut x, middle) = (MARGIN + 18.0, 89.0);
    let mut entry = |svg: &mut Svg, colour: RGBColor, is_line: bool, text: &str| {
        let colour = css(colour);
        if is_line {
            let stroke: [Attribute<'_>; 2] = [("stroke", &colour), ("stroke-width", &3)];
            svg.line((x, middle), (x + 24.0, middle), &stroke);
        } else {
            svg.dot((x + 12.0, middle), 4.0, &[("fill", &colour)]);
        }
        svg.words((x + 31.0, middle + 5.0), 14.0, Anchor::Start, INK, text);
        x += 31.0 + text.chars().count() as f64 * 14.0 * LETTER_WIDTH + 24.0;
    };
    if let Some(keyframe) = picture.keyframe {
        let (matches, inliers) = (keyframe.matches.len(), keyframe.inliers());
        if keyframe.global_from_camera.is_some() {
            entry(svg, GOOD, true, &format!("{inliers} inliers"));
            let outliers =
                format!("{} outliers: off by more than {:.1} px", matches - inliers, keyframe.gate_px);
            entry(svg, BAD, true, &outliers);
            let error = format!("reprojection error, drawn {EXAGGERATION} times longer");
            entry(svg, ODOMETRY, true, &error);
        } else {
            entry(
                svg,
                ODOMETRY,
                true,
                &format!("{matches} matches, without a pose to tell right from wrong"),
            );
        }
        let landmarks = format!("{} landmarks of the keyframe", keyframe.landmark_pixels.len());
        entry(svg, MAP, false, &landmarks);
    }
    entry(svg, TRUTH, false, &format!("{} features of the query", picture.features.len()));
}

fn draw_image(
    svg: &mut Svg,
    panel: &Panel,
    image: Option<&GrayImage>,
    pixels: &[[f32; 2]],
    colour: RGBColor,
) -> Result<(), ImageError> {
    match image {
        Some(image) => svg.image(image, (panel.left, panel.top), panel.size)?,
        None => svg.rectangle((panel.left, panel.top), panel.size, &[("fill", &css(GRID))]),
    }
    svg.open("g", &[("fill", &css(colour)), ("fill-opacity", &0.9)]);
    for pixel in pixels {
        svg.dot(panel.place(pixel.map(f64::from)), 1.9, &[]);
    }
    svg.close();
    Ok(())
}

/// Writes below an image. Of a text that is too long the end is shown: the most specific part of a path.
fn caption(svg: &mut Svg, panel: &Panel, text: &str) {
    let fitting = (panel.size.0 / (CAPTION_SIZE * LETTER_WIDTH)) as usize;
    let length = text.chars().count();
    let text = if length > fitting {
        "\u{2026}".chars().chain(text.chars().skip(length - fitting + 1)).collect()
    } else {
        text.to_owned()
    };
    svg.words((panel.left, panel.bottom() + 20.0), CAPTION_SIZE, Anchor::Start, INK, &text);
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

fn draw_match(
    svg: &mut Svg,
    found: &InspectedMatch,
    keyframe: &InspectedKeyframe,
    (left, right): (&Panel, &Panel),
) {
    let (class, colour) = match (found.inlier, keyframe.global_from_camera.is_some()) {
        (true, _) => ("inlier", GOOD),
        (false, true) => ("outlier", BAD),
        (false, false) => ("unposed", ODOMETRY),
    };
    let colour = css(colour);
    let from = left.place(found.query_pixel.map(f64::from));
    let to = right.place(found.keyframe_pixel.map(f64::from));
    svg.open("g", &[("class", &"match")]);
    svg.hover(&match_text(found, class));
    svg.line(from, to, &[("class", &class), ("stroke", &colour)]);
    if let (true, Some(predicted)) = (found.inlier, found.predicted_pixel) {
        let tip = left.place(predicted);
        let longer = (from.0 + EXAGGERATION * (tip.0 - from.0), from.1 + EXAGGERATION * (tip.1 - from.1));
        svg.line(from, longer, &[("class", &"error"), ("stroke", &css(ODOMETRY))]);
    }
    for end in [from, to] {
        svg.dot(end, 3.0, &[("fill", &colour)]);
    }
    svg.close();
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
