//! The page of this program in the system's browser.

use crate::in_process::LocalServer;
use onboard::StopSignal;
use std::path::Path;

/// Prints the address of a page and opens it.
pub fn announce(url: &str) {
    println!("{url}");
    open_page(url);
}

/// Shows a run that has ended, and leaves the page until the signal is raised. A run that cannot be shown is reported.
pub fn stay(server: &LocalServer, run: &Path, stop: &StopSignal) {
    if let Err(error) = server.show_run(run) {
        eprintln!("{error:#}");
    }
    eprintln!("the page stays until Ctrl-C");
    stop.wait();
}

/// Opens a page in the system's browser; where there is none, prints what to do instead.
pub fn open_page(url: &str) {
    let problem = match missing_display() {
        Some(problem) => Some(problem.to_owned()),
        None => open::that_detached(url).err().map(|error| error.to_string()),
    };
    if let Some(problem) = problem {
        eprintln!("{}", without_browser(url, &problem));
    }
}

/// What to do where no browser can be opened.
fn without_browser(url: &str, problem: &str) -> String {
    format!(
        "no browser was opened ({problem}): open {url} here, or from another machine after `ssh -L 8080:{} HOST` as \
         http://127.0.0.1:8080",
        url.trim_start_matches("http://").trim_end_matches('/')
    )
}

/// Why no browser has a screen. Without this look, a text browser might take the terminal.
#[cfg(all(unix, not(target_os = "macos")))]
fn missing_display() -> Option<&'static str> {
    let is_set = |name| std::env::var_os(name).is_some_and(|value| !value.is_empty());
    (!is_set("DISPLAY") && !is_set("WAYLAND_DISPLAY")).then_some("this machine has no display")
}

#[cfg(not(all(unix, not(target_os = "macos"))))]
fn missing_display() -> Option<&'static str> {
    None
}

#[cfg(test)]
mod tests {
    use super::without_browser;

    #[test]
    fn a_headless_machine_gets_a_sentence_with_the_address() {
        let sentence = without_browser("http://127.0.0.1:9090", "this machine has no display");
        assert!(sentence.contains("open http://127.0.0.1:9090 here"), "{sentence}");
        assert!(sentence.contains("ssh -L 8080:127.0.0.1:9090 HOST"), "{sentence}");
    }
}
