//! Commands that are told to end while they work or wait.

use std::net::TcpListener;
use std::process::{Child, Command};
use std::time::{Duration, Instant};

use crate::scratch::{in_town, town};

/// Within this time of a signal a command has ended.
const END: Duration = Duration::from_secs(3);

/// Sends SIGTERM, and waits for the end.
fn terminate(mut running: Child, line: &str) {
    let sent = Command::new("kill").args(["-TERM", &running.id().to_string()]).status().unwrap();
    let begin = Instant::now();
    assert!(sent.success(), "{line}");
    while running.try_wait().unwrap().is_none() {
        if begin.elapsed() > END {
            running.kill().unwrap();
            panic!("{line}: it did not end");
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    assert!(!running.wait().unwrap().success(), "{line}: it was done before the signal");
}

#[test]
fn commands_that_take_long_end_at_a_signal_and_change_nothing() {
    let scratch = in_town();
    let (hall, before) = (scratch.path("hall.db"), crate::scratch::ids(&town().join("hall.db")));
    // Milliseconds after which the signal is sent: maps so small are merged in less than 100.
    for (line, after_ms) in [
        ("build-map town/live --map hall.db --force --sigma-pixel 1 --gravity 0,0,-1", 100),
        ("build-map town/live --map hall.db --extend", 100),
        ("merge-maps hall.db second.db --map hall.db --force", 15),
        ("run town/live --map whole.db --out out --realtime", 100),
        ("simulate --images --out room", 100),
        ("montecarlo --runs 1000", 100),
    ] {
        let running = scratch.start(line);
        std::thread::sleep(Duration::from_millis(after_ms));
        terminate(running, line);
        assert_eq!(crate::scratch::ids(&hall), before, "{line}");
    }
    scratch.run("map-info --map hall.db");
    assert!(scratch.left_in_temporary_folder().is_empty());
}

#[test]
fn commands_that_wait_for_somebody_end_at_a_signal() {
    let scratch = in_town();
    let nobody = TcpListener::bind("127.0.0.1:0").unwrap();
    // It takes connections and never says anything.
    let silent = format!("tcp/{}", nobody.local_addr().unwrap());
    let closed = {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        format!("tcp/{}", listener.local_addr().unwrap())
    };
    for endpoint in [&silent, &closed] {
        let live = "town/live/mav0/cam0";
        for line in [
            format!("query --map hall --features {live}/features.csv --connect {endpoint}"),
            format!("play town/live --robot r1 --connect {endpoint}"),
        ] {
            let running = scratch.start(&line);
            std::thread::sleep(Duration::from_millis(700));
            terminate(running, &line);
        }
    }
}
