//! Servers that are killed, each a process of its own.

use std::path::Path;
use std::time::{Duration, Instant};

use client::MapClient;

use super::servers::{hub, session, wait_for_cells, wait_for_members};
use super::town::{Town, requests};

/// A server of its own process, killed when it is dropped.
struct Process(std::process::Child);

impl Process {
    fn start(endpoint: &str, name: &str, store: &Path, cache: &Path) -> Process {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_map_server"));
        command.args([
            "--map",
            &format!("city=file://{}", store.display()),
            "--cells",
            "auto",
            "--name",
            name,
        ]);
        command.args(["--connect", endpoint, "--watch-releases", "2", "--log", "warn"]);
        command.arg("--cache").arg(cache.join(name)).arg("--state").arg(cache.join(name).join("state"));
        Process(command.spawn().unwrap())
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // SIGKILL.
        self.0.kill().unwrap();
        self.0.wait().unwrap();
    }
}

/// Four servers of which some are killed at once, again and again, while a robot asks.
async fn kills(rounds: usize, at_once: usize, deadline: Duration) {
    let Town { place, folder, city, release, .. } = Town::new().await;
    let cells = release.cells.len();
    let (_hub, endpoint) = hub().await;
    let names = ["north", "south", "west", "east"];
    let start = |name: &str| Process::start(&endpoint, name, &city, folder.path());
    let mut servers: Vec<Process> = names.iter().map(|name| start(name)).collect();
    let robot = session(&endpoint).await;
    wait_for_members(&robot, 4).await;
    wait_for_cells(&robot, 2 * cells).await;

    let (stop, mut stopped) = tokio::sync::oneshot::channel::<()>();
    let asking = {
        let (client, requests) = (MapClient::new(robot.clone(), "city").unwrap(), requests(&place));
        tokio::spawn(async move {
            let (mut answered, mut lost, mut slowest) = (0, Vec::new(), Duration::ZERO);
            let mut is_stopped = false;
            for request in requests.iter().cycle() {
                is_stopped |= stopped.try_recv().is_ok();
                // A slow machine goes on until there is enough to judge by.
                if is_stopped && answered + lost.len() >= 10 * rounds {
                    break;
                }
                let begin = Instant::now();
                match client.match_image(request, begin + deadline).await {
                    Ok(_) => answered += 1,
                    Err(error) => lost.push(error.to_string()),
                }
                slowest = slowest.max(begin.elapsed());
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
            (answered, lost, slowest)
        })
    };
    let mut settled = Duration::ZERO;
    for round in 0..rounds {
        let killed: Vec<usize> = (0..at_once).map(|next| (round + next) % 4).collect();
        let begin = Instant::now();
        for at in &killed {
            // The new process is started once the other one is gone.
            servers[*at].0.kill().unwrap();
        }
        wait_for_members(&robot, 4 - at_once).await;
        wait_for_cells(&robot, 2 * cells).await;
        settled = settled.max(begin.elapsed());
        for at in killed {
            servers[at] = start(names[at]);
        }
        wait_for_members(&robot, 4).await;
        wait_for_cells(&robot, 2 * cells).await;
    }
    stop.send(()).unwrap();
    let (answered, lost, slowest) = asking.await.unwrap();
    println!("{answered} answers, the slowest after {slowest:?}; cells assigned anew within {settled:?}");
    assert!(lost.is_empty(), "{} of {answered} queries were lost: {:?}", lost.len(), lost[0]);
}

#[tokio::test(flavor = "multi_thread")]
async fn no_answer_is_lost_when_a_server_is_killed() {
    kills(1, 1, Duration::from_secs(2)).await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "takes ten minutes"]
async fn no_answer_is_lost_when_servers_are_killed_fifty_times() {
    kills(50, 1, Duration::from_secs(2)).await;
    kills(10, 2, Duration::from_secs(5)).await;
}
