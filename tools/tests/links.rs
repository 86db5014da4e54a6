//! What the pages refer to is there: source files, other pages, and headings in them.

use crate::printed::{files_below, packages, pages, root};
use std::fs;
use std::path::{Path, PathBuf};

/// The anchor that mdBook and code hosts make of a heading.
fn anchor(heading: &str) -> String {
    let kept = |c: &char| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_');
    heading
        .trim_start_matches('#')
        .trim()
        .to_lowercase()
        .chars()
        .filter(kept)
        .collect::<String>()
        .replace(' ', "-")
}

fn has_anchor(page: &Path, wanted: &str) -> bool {
    let text = fs::read_to_string(page).unwrap();
    text.lines().filter(|line| line.starts_with('#')).any(|line| anchor(line) == wanted)
}

/// The targets of links, without those into the web.
fn links(text: &str) -> Vec<String> {
    let targets = text.split("](").skip(1).filter_map(|rest| rest.split(')').next());
    targets.filter(|target| !target.contains("://")).map(str::to_owned).collect()
}

/// The source files that are named in code spans; `a/{b,c}.rs` are two.
fn sources(text: &str) -> Vec<String> {
    let is_source = |span: &&str| Path::new(span).extension().is_some_and(|extension| extension == "rs");
    let is_path =
        |span: &&str| is_source(span) && !span.contains(|c: char| c.is_whitespace() || "*<(".contains(c));
    let alternatives = |span: &str| match (span.split_once('{'), span.split_once('}')) {
        (Some((before, _)), Some((choices, after))) => {
            let choices = choices.rsplit('{').next().unwrap_or_default();
            choices.split(',').map(|choice| format!("{before}{choice}{after}")).collect()
        }
        _ => vec![span.to_owned()],
    };
    text.split('`').skip(1).step_by(2).filter(is_path).flat_map(alternatives).collect()
}

/// What is wrong with a link of a page.
fn broken(page: &Path, target: &str) -> Option<String> {
    let (path, wanted) = target.split_once('#').unwrap_or((target, ""));
    let file = if path.is_empty() { page.to_owned() } else { page.parent().unwrap().join(path) };
    if !file.exists() {
        return Some(format!("{}: {target} is not there", page.display()));
    }
    let is_found = wanted.is_empty() || has_anchor(&file, wanted);
    (!is_found).then(|| format!("{}: {target} has no such heading", page.display()))
}

#[test]
fn every_link_leads_to_a_page_and_a_heading() {
    let mut faults = Vec::new();
    let mut count = 0;
    for (name, text) in pages() {
        let page = root().join(&name);
        let links = links(&text);
        count += links.len();
        faults.extend(links.iter().filter_map(|target| broken(&page, target)));
    }
    assert!(count > 50, "{count} links were found");
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    let readme = root().join("README.md");
    assert!(broken(&readme, "docs/src/no-page.md").is_some());
    assert!(broken(&readme, "ARCHITECTURE.md#no-such-heading").is_some());
}

#[test]
fn every_source_file_that_a_page_names_exists() {
    let folders = packages()
        .into_iter()
        .flat_map(|package| ["src", "tests", "examples", "benches"].map(|folder| package.join(folder)));
    let files: Vec<PathBuf> =
        folders.filter(|folder| folder.exists()).flat_map(|folder| files_below(&folder)).collect();
    let mut missing = Vec::new();
    let mut count = 0;
    for (name, text) in pages() {
        let named = sources(&text);
        count += named.len();
        let is_missing = |source: &&String| !files.iter().any(|file| file.ends_with(source));
        missing.extend(named.iter().filter(is_missing).map(|source| format!("{name}: {source}")));
    }
    assert!(count > 20, "{count} source files were found");
    assert!(missing.is_empty(), "{}", missing.join("\n"));
}

#[test]
fn code_spans_and_headings_are_read_as_they_are_shown() {
    assert_eq!(sources("`a/{b,c}.rs`, `d.rs` and `x *.rs`"), ["a/b.rs", "a/c.rs", "d.rs"]);
    assert_eq!(anchor("## What an answer costs, in `ms`"), "what-an-answer-costs-in-ms");
}
