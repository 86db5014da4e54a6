//! The commands that README, book and `--help` print: each parses, and those that need nothing else run.

use crate::printed::{Printed, in_blocks, in_help, in_sentences, packages, pages, root};
use clap::CommandFactory as _;
use clap::error::ErrorKind;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// A key of minisign, from its documentation.
const PUBLIC_KEY: &str = "RWQf6LRCGA9i53mlYecO4IzT51TGPpvWucNSCh1CBM0QTaLn73Y7GFO3";

/// What may stand in the place of a word that only names a value; brackets are around what may be left out.
fn stand_in(word: &str) -> &str {
    match word.trim_matches(['[', ']', '<', '>']) {
        "RAD" | "M" => "0.1",
        "X,Y,Z" => "1,2,3",
        "FROM,UNTIL" => "1,2",
        "..." => "REC",
        // The file is read with the command line.
        "city.key.pub" => PUBLIC_KEY,
        other => other,
    }
}

/// What the program's own definition says against a command.
fn refusal(definition: clap::Command, printed: &Printed, words: &[&str]) -> Option<String> {
    let error = definition.try_get_matches_from(words).err()?;
    // A sentence leaves out what it is not about; the rest of a robot's switches may be in its settings file.
    let has_settings =
        words.contains(&"--write-config") || words[1..].first().is_some_and(|word| !word.starts_with('-'));
    let is_open = printed.block.is_none() || words[0] == "onboard" && has_settings;
    let is_accepted = match error.kind() {
        ErrorKind::DisplayHelp
        | ErrorKind::DisplayVersion
        | ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => true,
        ErrorKind::MissingRequiredArgument | ErrorKind::MissingSubcommand | ErrorKind::InvalidValue => {
            is_open
        }
        _ => false,
    };
    (!is_accepted).then(|| error.to_string())
}

/// A package, example or bench that cargo would not find.
fn missing_target(words: &[&str]) -> Option<String> {
    let after = |switch| words.iter().skip_while(|word| **word != switch).nth(1);
    let name = after("-p")?;
    let is_named = |folder: &PathBuf| {
        fs::read_to_string(folder.join("Cargo.toml")).unwrap().contains(&format!("name = \"{name}\""))
    };
    let Some(package) = packages().into_iter().find(is_named) else {
        return Some(format!("there is no package {name}"));
    };
    let missing = |(switch, folder)| {
        let name = after(switch)?;
        let is_there = |file| package.join(folder).join(file).exists();
        let exists = is_there(format!("{name}.rs")) || is_there(format!("{name}/main.rs"));
        (!exists).then(|| format!("there is no {name} in {folder} of {}", package.display()))
    };
    [("--example", "examples"), ("--bench", "benches")].into_iter().find_map(missing)
}

fn complaint(printed: &Printed) -> Option<String> {
    let words: Vec<&str> = printed.words.iter().map(|word| stand_in(word)).collect();
    match *words {
        ["driftless", "COMMAND", ..] => None,
        ["driftless", ..] => refusal(tools::cli::Cli::command(), printed, &words),
        ["cargo", "demo", ..] => {
            refusal(tools::cli::Cli::command(), printed, &[&["driftless"], &words[1..]].concat())
        }
        ["onboard", ..] => refusal(onboard::cli::Arguments::command(), printed, &words),
        ["map_server", ..] => refusal(map_server::arguments::Arguments::command(), printed, &words),
        ["cargo", ..] => missing_target(&words),
        ["just", recipe, ..] => {
            let justfile = fs::read_to_string(root().join("justfile")).unwrap();
            let begins = [format!("{recipe}:"), format!("{recipe} ")];
            let is_there = justfile.lines().any(|line| begins.iter().any(|begin| line.starts_with(begin)));
            (!is_there).then(|| format!("there is no recipe {recipe}"))
        }
        ["python", file, ..] if Path::new(file).extension().is_some() => {
            (!root().join(file).exists()).then(|| format!("there is no {file}"))
        }
        _ => None,
    }
}

#[test]
fn every_printed_command_parses() {
    let mut printed: Vec<Printed> = Vec::new();
    for (name, text) in pages() {
        printed.extend(in_blocks(&name, &text));
        printed.extend(in_sentences(&name, &text));
    }
    let pages = printed.len();
    let definitions = [
        tools::cli::Cli::command(),
        onboard::cli::Arguments::command(),
        map_server::arguments::Arguments::command(),
    ];
    printed.extend(definitions.iter().flat_map(in_help));
    println!("{pages} commands in pages, {} in --help", printed.len() - pages);
    assert!(pages > 100 && printed.len() - pages > 50);
    let wrong: Vec<String> = printed
        .iter()
        .filter_map(|printed| {
            let Printed { page, line, words, .. } = printed;
            Some(format!("{page}:{line}: {}\n{}", words.join(" "), complaint(printed)?))
        })
        .collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn a_wrong_command_is_found_where_it_is() {
    let page = "# Title\n\n```sh\ndriftless view out --map \\\n    hall.db --open   # the run\n\
                map_server --map hall=hall.db & driftless run --sequence REC --out out\n```\n\n\
                Then `driftless\nplott out`, and `plot` it, and `driftless plot`.\n";
    let printed: Vec<Printed> =
        in_blocks("page", page).into_iter().chain(in_sentences("page", page)).collect();
    let lines: Vec<(usize, bool)> =
        printed.iter().map(|printed| (printed.line, complaint(printed).is_some())).collect();
    assert_eq!(lines, [(4, false), (6, false), (6, true), (9, true), (10, false)], "{printed:?}");
}

/// Runs the blocks of a page that a newcomer can type, in order, in one folder.
fn run_blocks(page: &str, is_wanted: impl Fn(&[&Printed]) -> bool) {
    let printed = in_blocks(page, &fs::read_to_string(root().join(page)).unwrap());
    let folder = tempfile::tempdir().unwrap();
    let mut runs = 0;
    for block in printed.chunk_by(|one, next| one.block == next.block) {
        let block: Vec<&Printed> = block.iter().filter(|printed| printed.words[0] == "driftless").collect();
        if !is_wanted(&block) {
            continue;
        }
        for Printed { page, line, words, .. } in block {
            let mut command = Command::new(env!("CARGO_BIN_EXE_driftless"));
            let output = command.args(&words[1..]).current_dir(folder.path()).output().unwrap();
            let said = [output.stdout, output.stderr].concat();
            let said = String::from_utf8_lossy(&said);
            let at = format!("{page}:{line}: {}\n{said}", words.join(" "));
            println!("{at}");
            assert!(output.status.success(), "{at}");
            assert!(!said.contains("ALARM"), "{at}");
            runs += 1;
        }
    }
    assert!(runs > 2, "{page}");
}

fn has_images(block: &[&Printed]) -> bool {
    block.iter().any(|printed| printed.words.iter().any(|word| word == "--images"))
}

#[test]
fn getting_started_runs_as_it_is_printed() {
    run_blocks("docs/src/getting-started.md", |block| !has_images(block));
}

#[test]
fn the_map_of_nav2_is_made_as_it_is_printed() {
    let is_of_map =
        |block: &[&Printed]| block.iter().any(|printed| printed.words.iter().any(|word| word == "simulate"));
    run_blocks("docs/src/nav2.md", is_of_map);
}

#[test]
#[ignore = "renders 45 s of images twice, some minutes; `just nightly` runs it"]
fn getting_started_with_images_runs_as_it_is_printed() {
    run_blocks("docs/src/getting-started.md", has_images);
    run_blocks("README.md", has_images);
}
