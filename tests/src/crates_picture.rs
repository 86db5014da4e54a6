//! Draws the crates of the workspace and their dependencies as an SVG.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;

/// A crate.
#[derive(Clone, Debug, Default)]
pub struct Crate {
    /// What it is, one sentence.
    pub description: String,
    /// Whether it has a program.
    pub is_program: bool,
    /// The crates of the workspace that it depends on, without those of tests.
    pub dependencies: BTreeSet<String>,
}

/// Width, height and distances of the boxes, pixels.
const BOX: [f64; 2] = [176.0, 66.0];
const GAP: [f64; 2] = [18.0, 46.0];
const MARGIN: f64 = 20.0;
/// Characters of a line of a description, and how many lines there are.
const LINE: [usize; 2] = [29, 3];
/// Rounds in which crates move towards those that they depend on and those that depend on them.
const ROUNDS: usize = 24;

/// Each crate is drawn above all that it depends on. Dependencies that follow from others have no arrow.
///
/// # Errors
/// The names of crates that depend on each other in a circle.
pub fn draw(crates: &BTreeMap<String, Crate>) -> Result<String, Vec<String>> {
    let rows = rows(crates)?;
    let arrows = direct(crates);
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0) as f64;
    let width = 2.0 * MARGIN + columns * (BOX[0] + GAP[0]) - GAP[0];
    let height = 2.0 * MARGIN + rows.len() as f64 * (BOX[1] + GAP[1]) - GAP[1];
    let places = places(&rows, &arrows, width);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" font-family=\"sans-serif\" font-size=\"10.5\">\n\
         <!-- Drawn from the manifests of the crates: UPDATE=1 cargo test -p driftless-tests crates_picture -->\n\
         <rect width=\"{width}\" height=\"{height}\" fill=\"#ffffff\"/>\n\
         <defs><marker id=\"a\" viewBox=\"0 0 10 10\" refX=\"9\" refY=\"5\" markerWidth=\"7\" markerHeight=\"7\" orient=\"auto\">\
         <path d=\"M0 0L10 5L0 10z\" fill=\"#8a94a0\"/></marker></defs>\n"
    );
    for (from, to) in &arrows {
        draw_arrow(&mut svg, places[from], places[to]);
    }
    for (name, at) in &places {
        draw_box(&mut svg, name, &crates[name], *at);
    }
    svg.push_str("</svg>\n");
    Ok(svg)
}

/// The crates by rows, the upper first: each row depends on lower ones only.
fn rows(crates: &BTreeMap<String, Crate>) -> Result<Vec<Vec<String>>, Vec<String>> {
    let mut rows: Vec<Vec<String>> = Vec::new();
    let mut below = BTreeSet::new();
    while below.len() < crates.len() {
        let is_next = |name: &&String| !below.contains(*name) && crates[*name].dependencies.is_subset(&below);
        let row: Vec<String> = crates.keys().filter(is_next).cloned().collect();
        if row.is_empty() {
            return Err(crates.keys().filter(|name| !below.contains(*name)).cloned().collect());
        }
        below.extend(row.iter().cloned());
        rows.push(row);
    }
    rows.reverse();
    Ok(rows)
}

/// The dependencies that do not follow from others.
fn direct(crates: &BTreeMap<String, Crate>) -> Vec<(String, String)> {
    let reaches = |from: &str, to: &str| {
        let (mut open, mut seen) = (vec![from], BTreeSet::new());
        while let Some(name) = open.pop() {
            if name == to {
                return true;
            }
            if seen.insert(name) {
                open.extend(crates[name].dependencies.iter().map(String::as_str));
            }
        }
        false
    };
    let mut arrows = Vec::new();
    for (from, Crate { dependencies, .. }) in crates {
        for to in dependencies {
            if !dependencies.iter().any(|other| other != to && reaches(other, to)) {
                arrows.push((from.clone(), to.clone()));
            }
        }
    }
    arrows
}

/// The upper left corner of each box: rows are ordered by where their neighbours are.
fn places(rows: &[Vec<String>], arrows: &[(String, String)], width: f64) -> BTreeMap<String, [f64; 2]> {
    let mut rows = rows.to_vec();
    let mut centres: BTreeMap<String, f64> = BTreeMap::new();
    for round in 0..=ROUNDS {
        for row in &mut rows {
            if round > 0 {
                let wanted = |name: &String| {
                    let neighbours =
                        arrows.iter().filter_map(|(from, to)| match (from == name, to == name) {
                            (true, _) => Some(to),
                            (_, true) => Some(from),
                            _ => None,
                        });
                    let (sum, count) = neighbours
                        .fold((0.0, 0.0), |(sum, count), other| (sum + centres[other], count + 1.0));
                    if count > 0.0 { sum / count } else { centres[name] }
                };
                row.sort_by(|a, b| wanted(a).total_cmp(&wanted(b)).then_with(|| a.cmp(b)));
            }
            let step = (width - 2.0 * MARGIN + GAP[0]) / row.len() as f64;
            for (k, name) in row.iter().enumerate() {
                centres.insert(name.clone(), MARGIN - 0.5 * GAP[0] + (k as f64 + 0.5) * step);
            }
        }
    }
    let place = |(k, row): (usize, &Vec<String>)| {
        let top = MARGIN + k as f64 * (BOX[1] + GAP[1]);
        row.iter().map(|name| (name.clone(), [centres[name] - 0.5 * BOX[0], top])).collect::<Vec<_>>()
    };
    rows.iter().enumerate().flat_map(place).collect()
}

fn draw_arrow(svg: &mut String, from: [f64; 2], to: [f64; 2]) {
    // Arrows leave and arrive on the side of where they go to and come from.
    let aside = (0.28 * (to[0] - from[0])).clamp(-0.36 * BOX[0], 0.36 * BOX[0]);
    let (x, y) = (from[0] + 0.5 * BOX[0] + aside, from[1] + BOX[1]);
    let (to_x, to_y) = (to[0] + 0.5 * BOX[0] - aside, to[1] - 2.0);
    let middle = 0.5 * (y + to_y);
    let _ = writeln!(
        svg,
        "<path d=\"M{x:.0} {y:.0}C{x:.0} {middle:.0} {to_x:.0} {middle:.0} {to_x:.0} {to_y:.0}\" fill=\"none\" stroke=\"#8a94a0\" \
         stroke-width=\"1.1\" marker-end=\"url(#a)\"/>"
    );
}

fn draw_box(svg: &mut String, name: &str, what: &Crate, at: [f64; 2]) {
    let fill = if what.is_program { "#dbe9f6" } else { "#eef1e6" };
    let middle = at[0] + 0.5 * BOX[0];
    let _ = writeln!(
        svg,
        "<rect x=\"{:.0}\" y=\"{:.0}\" width=\"{}\" height=\"{}\" rx=\"6\" fill=\"{fill}\" stroke=\"#4a5560\"/>\n\
         <text x=\"{middle:.0}\" y=\"{:.0}\" text-anchor=\"middle\" font-size=\"14\" font-weight=\"bold\">{name}</text>",
        at[0],
        at[1],
        BOX[0],
        BOX[1],
        at[1] + 18.0
    );
    for (k, line) in lines(&what.description).iter().enumerate() {
        let line = line.replace('&', "&amp;").replace('<', "&lt;");
        let _ = writeln!(
            svg,
            "<text x=\"{middle:.0}\" y=\"{:.0}\" text-anchor=\"middle\" fill=\"#3f4650\">{line}</text>",
            at[1] + 33.0 + 13.0 * k as f64
        );
    }
}

/// The first words of a text that fit into a box.
fn lines(text: &str) -> Vec<String> {
    let mut lines = Vec::new();
    let mut line = String::new();
    for word in text.trim_end_matches('.').split_whitespace() {
        if !line.is_empty() && line.len() + word.len() >= LINE[0] {
            lines.push(std::mem::take(&mut line));
            if lines.len() == LINE[1] {
                break;
            }
        }
        if !line.is_empty() {
            line.push(' ');
        }
        line.push_str(word);
    }
    if lines.len() < LINE[1] {
        lines.push(line);
    } else if let Some(last) = lines.last_mut() {
        last.push('…');
    }
    lines
}
