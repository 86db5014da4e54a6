//! Man pages and completions of shells.

use clap::CommandFactory as _;
use tools::cli::Cli;

use crate::scratch::Scratch;

#[test]
fn every_command_has_a_page_and_every_program_completions() {
    let scratch = Scratch::new();
    scratch.run("manual --out share");
    let page =
        |name: &str| std::fs::read_to_string(scratch.path(&format!("share/man/man1/{name}.1"))).expect(name);
    for command in Cli::command().get_subcommands().filter(|command| command.get_name() != "help") {
        let name = format!("driftless-{}", command.get_name());
        assert!(page(&name).contains(&name.replace('-', "\\-")), "{name}");
    }
    for program in ["driftless", "map_server", "onboard"] {
        assert!(page(program).contains("SYNOPSIS"), "{program}");
        for completion in [format!("{program}.bash"), format!("{program}.fish"), format!("_{program}")] {
            let path = scratch.path(&format!("share/completions/{completion}"));
            assert!(std::fs::read_to_string(path).unwrap().contains(program), "{completion}");
        }
    }
}
