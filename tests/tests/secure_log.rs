//! What the log of a hub says of those who are refused.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Child, Command};
use std::time::{Duration, Instant};

use clap::Parser as _;
use client::session::close_session;
use client::without_secrets;
use map_server::arguments::Arguments;
use monitoring::{LogFormat, start_log};
use tests::attack::{Entry, Forger, OUTSIDERS, all_answers};
use tests::fleet::{FleetRobot, FleetServer, PATIENCE, member, secured};
use tracing_subscriber::EnvFilter;

/// What the hub says of whoever comes in so, as the book's page on security has it.
const REFUSALS: [(Entry, &str); 5] = [
    (Entry::Plain, "received corrupt message"),
    (Entry::NoCertificate, "peer sent no certificates"),
    (Entry::OtherAuthority, "invalid peer certificate: BadSignature"),
    (Entry::Expired, "invalid peer certificate: certificate expired"),
    (Entry::Stranger, "did not match any configured ACL subject"),
];
/// Attempts of each.
const ATTEMPTS: usize = 3;
/// Page that names them.
const PAGE: &str = include_str!("../../docs/src/security.md");

/// The folder of the fleet whose hub the child process is.
const FLEET: &str = "FLEET";

/// A hub in a process of its own, which has a log of its own.
struct Hub {
    child: Child,
    log: PathBuf,
}

impl Hub {
    fn start(fleet: &Path, log: PathBuf) -> Self {
        let child = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "secure_log::hub", "--ignored", "--nocapture"])
            .env(FLEET, fleet)
            .stderr(File::create(&log).unwrap())
            .spawn()
            .unwrap();
        Self { child, log }
    }

    /// The lines of the log that hold a text.
    fn lines_with(&self, text: &str) -> Vec<String> {
        let log = std::fs::read_to_string(&self.log).unwrap();
        log.lines().filter(|line| line.contains(text)).map(str::to_owned).collect()
    }

    /// The log without the lines of those who were let in.
    fn refusals(&self) -> usize {
        self.lines_with("zenoh").len() - self.lines_with("Accepted TLS connection").len()
    }

    /// Waits for so many lines.
    async fn wait_for_refusals(&self, count: usize) {
        let begin = Instant::now();
        while self.refusals() < count {
            assert!(begin.elapsed() < PATIENCE, "{} refusals of {count}", self.refusals());
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    }
}

impl Drop for Hub {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
#[ignore = "a part of a test, in a process of its own"]
fn hub() {
    let Ok(fleet) = std::env::var(FLEET) else { return };
    // As the program does it without switches.
    let arguments = Arguments::parse_from(["map_server", "--map", "hall=hall.db"]);
    start_log(without_secrets(EnvFilter::new(arguments.log)), LogFormat::Text);
    tests::network::runtime().block_on(async {
        let _server = FleetServer::start(&member(Path::new(&fleet), "south")).await;
        std::future::pending::<()>().await;
    });
}

#[tokio::test(flavor = "multi_thread")]
async fn each_refusal_is_logged_once() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("fleet");
    let fleet = secured(&place, false);
    let hub = Hub::start(&place, folder.path().join("log"));
    let robot = FleetRobot::start("bo", &member(&place, "bo")).await;
    robot.first_answer().await;

    let attackers = tempfile::tempdir().unwrap();
    let forger = Forger::new(&fleet, &place, attackers.path());
    let of_members = hub.refusals();
    for (kind, (entry, _)) in REFUSALS.into_iter().enumerate() {
        for attempt in 1..=ATTEMPTS {
            let mut config = forger.config(entry, "bo");
            config.insert_json5("connect/timeout_ms", "0").unwrap();
            let session = zenoh::open(config).await;
            assert_eq!(session.is_err(), OUTSIDERS.contains(&entry), "{entry:?}");
            if let Ok(session) = session {
                assert!(all_answers(&session, "map/hall/info").await.is_empty(), "served");
                close_session(&session).await;
            }
            hub.wait_for_refusals(of_members + kind * ATTEMPTS + attempt).await;
        }
    }
    // What comes late would be here by now.
    robot.first_answer().await;
    for (entry, words) in REFUSALS {
        let said = hub.lines_with(words);
        assert_eq!(said.len(), ATTEMPTS, "{entry:?}: {said:#?}");
        assert!(PAGE.contains(words), "the book does not say that {entry:?} is logged as {words:?}");
    }
    assert_eq!(hub.refusals(), of_members + REFUSALS.len() * ATTEMPTS, "each is said once");
    assert_eq!(hub.lines_with("Common Name: robot/bo.").len(), 1);
}
