//! The commands that README, book and `--help` print, and where.

use std::fs;
use std::path::{Path, PathBuf};

/// What a block of commands is marked with.
const SHELL: [&str; 3] = ["sh", "bash", "console"];
/// The programs whose commands are checked.
const PROGRAMS: [&str; 6] = ["driftless", "onboard", "map_server", "cargo", "just", "python"];

/// A command, and where it is printed.
#[derive(Debug)]
pub struct Printed {
    pub page: String,
    pub line: usize,
    /// Number of its block in the page; `None` within a sentence, where a command may leave out what the sentence is not about.
    pub block: Option<usize>,
    pub words: Vec<String>,
}

pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// The files of a folder and its subfolders.
pub fn files_below(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    entries.flat_map(|path| if path.is_dir() { files_below(&path) } else { vec![path] }).collect()
}

/// The folders of the packages of the workspace.
pub fn packages() -> Vec<PathBuf> {
    let folders = [root(), root().join("crates")].map(|folder| fs::read_dir(folder).unwrap());
    let paths = folders.into_iter().flatten().map(|entry| entry.unwrap().path());
    paths.filter(|path| path.join("Cargo.toml").exists()).collect()
}

/// The pages: those at the root of the repository, the book, and what each package says of itself.
pub fn pages() -> Vec<(String, String)> {
    let mut paths =
        ["README.md", "ARCHITECTURE.md", "CONTRIBUTING.md"].map(|name| root().join(name)).to_vec();
    paths.extend(files_below(&root().join("docs/src")));
    paths
        .extend(packages().into_iter().chain([root().join("python")]).map(|folder| folder.join("README.md")));
    paths.retain(|path| path.extension().is_some_and(|extension| extension == "md") && path.exists());
    let read = |path: PathBuf| {
        let name = path.strip_prefix(root()).unwrap().display().to_string();
        (name, fs::read_to_string(&path).unwrap())
    };
    paths.into_iter().map(read).collect()
}

/// A line as a shell splits it: commands of words, without comments; a redirection ends a command.
fn split(line: &str) -> Vec<Vec<String>> {
    let (mut commands, mut word, mut quote) = (vec![Vec::new()], None::<String>, None);
    for character in line.chars().chain([' ']) {
        match (quote, character) {
            (Some(open), _) if character == open => quote = None,
            (None, '\'' | '"') => {
                quote = Some(character);
                word.get_or_insert_default();
            }
            (None, '#') if word.is_none() => break,
            (None, '>' | '<') if word.is_none() => commands.push(Vec::new()),
            (None, ' ' | ';' | '&' | '|') => {
                commands.last_mut().unwrap().extend(word.take());
                if character != ' ' {
                    commands.push(Vec::new());
                }
            }
            _ => word.get_or_insert_default().push(character),
        }
    }
    commands.retain(|words| words.first().is_some_and(|first| PROGRAMS.contains(&first.as_str())));
    commands
}

/// The commands in the blocks of a page, each with the line where it begins.
pub fn in_blocks(page: &str, text: &str) -> Vec<Printed> {
    let (mut found, mut fences, mut is_shell) = (Vec::new(), 0, false);
    let (mut command, mut begin) = (String::new(), 0);
    for (row, line) in text.lines().zip(1..) {
        if let Some(info) = row.trim_start().strip_prefix("```") {
            fences += 1;
            is_shell = fences % 2 == 1 && SHELL.contains(&info.trim());
        } else if is_shell {
            begin = if command.is_empty() { line } else { begin };
            command += row;
            if command.ends_with('\\') {
                command.pop();
                continue;
            }
            let of = |words| Printed { page: page.to_owned(), line: begin, block: Some(fences), words };
            found.extend(split(&std::mem::take(&mut command)).into_iter().map(of));
        }
    }
    found
}

/// The commands in the sentences of a page, between backticks.
pub fn in_sentences(page: &str, text: &str) -> Vec<Printed> {
    let (mut found, mut is_fenced, mut is_code) = (Vec::new(), false, false);
    let mut span = (0, String::new());
    for (row, line) in text.lines().zip(1..) {
        let is_fence = row.trim_start().starts_with("```");
        is_fenced ^= is_fence;
        if is_fenced || is_fence || row.trim().is_empty() {
            is_code = false;
            continue;
        }
        for (index, part) in row.split('`').enumerate() {
            if index > 0 {
                is_code = !is_code;
                if is_code {
                    span = (line, String::new());
                } else {
                    let of = |words| Printed { page: page.to_owned(), line: span.0, block: None, words };
                    found.extend(split(&span.1).into_iter().take(1).map(of));
                }
            }
            span.1 += part;
        }
        span.1.push(' ');
    }
    found
}

/// The commands in the help of a command and its subcommands.
pub fn in_help(command: &clap::Command) -> Vec<Printed> {
    let page = format!("{} --help", command.get_name());
    let mut found = Vec::new();
    for text in [command.get_after_help(), command.get_after_long_help()].into_iter().flatten() {
        let text = text.to_string();
        for (row, line) in text.lines().zip(1..) {
            // What follows two blanks explains the command.
            let example = row.trim().split("  ").next().unwrap_or_default();
            let of = |words| Printed { page: page.clone(), line, block: Some(0), words };
            found.extend(split(example).into_iter().map(of));
        }
        found.extend(in_sentences(&page, &text));
    }
    found.extend(command.get_subcommands().flat_map(in_help));
    found
}
