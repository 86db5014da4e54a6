//! What somebody may try against a fleet. Whatever is forged is marked, so that it is known where it is believed.

use client::session::{CONFIG_FILE, Role, SessionOptions};
use protocol::{Format, RobotState, RobotStatus};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;
use tools::fleet::{Authority, Fleet, Validity};
use zenoh::Wait as _;
use zenoh::query::{ConsolidationMode, QueryTarget};

/// What a forged answer holds.
pub const FORGED: &[u8] = b"forged";
/// Version that a forged change states.
pub const FORGED_VERSION: u64 = u64::MAX;
/// Time that a forged status states.
pub const FORGED_STAMP: i64 = -1;

/// Keys of the map and of a robot that is not the attacker.
pub const VICTIM: &str = "ada";

/// How an attacker comes into the network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Entry {
    /// Without encryption.
    Plain,
    /// TLS without a certificate of its own.
    NoCertificate,
    /// With a certificate for the right name, by another authority.
    OtherAuthority,
    /// With a certificate of the authority that has expired.
    Expired,
    /// With a certificate of the authority for a name that the fleet does not have.
    Stranger,
    /// As a member of the fleet.
    Member(Role),
}

/// All entries that let nobody in.
pub const OUTSIDERS: [Entry; 4] = [Entry::Plain, Entry::NoCertificate, Entry::OtherAuthority, Entry::Expired];

/// Members that forge what their role does not allow.
pub const MEMBERS: [Entry; 4] = [
    Entry::Member(Role::Robot),
    Entry::Member(Role::Operator),
    Entry::Member(Role::MapServer),
    Entry::Stranger,
];

/// Makes the folders that attackers use, copies of `member`'s.
pub struct Forger<'a> {
    fleet: &'a Fleet,
    authority: Authority,
    other: Authority,
    folder: PathBuf,
    made: AtomicUsize,
}

impl<'a> Forger<'a> {
    /// Uses the real authority for expired and strange certificates.
    pub fn new(fleet: &'a Fleet, fleet_folder: &Path, folder: &Path) -> Self {
        let read = |name: &str| std::fs::read_to_string(fleet_folder.join("authority").join(name)).unwrap();
        Self {
            fleet,
            authority: Authority::read(&read("ca.pem"), &read("ca-key.pem")).unwrap(),
            other: Authority::new().unwrap().0,
            folder: folder.to_owned(),
            made: AtomicUsize::new(0),
        }
    }

    /// The configuration of an attacker who has the folder of `name` as far as the entry says.
    pub fn config(&self, entry: Entry, name: &str) -> zenoh::Config {
        let common_name = |name: &str| {
            let member = self.fleet.members().iter().find(|member| member.name == name).unwrap();
            tools::fleet::access::common_name(member)
        };
        let valid = Validity::default();
        let issued = match entry {
            Entry::OtherAuthority => Some(self.other.issue(&common_name(name), Vec::new(), valid)),
            Entry::Expired => Some(self.authority.issue(&common_name(name), Vec::new(), Validity::days(-1))),
            Entry::Stranger => {
                let made = self.made.load(Ordering::Relaxed);
                Some(self.authority.issue(&format!("robot/stranger{made}"), Vec::new(), valid))
            }
            _ => None,
        };
        let folder = self.folder.join(self.made.fetch_add(1, Ordering::Relaxed).to_string());
        std::fs::create_dir(&folder).unwrap();
        for file in [CONFIG_FILE, "ca.pem", "certificate.pem", "key.pem"] {
            std::fs::copy(self.fleet.folder_of(name).join(file), folder.join(file)).unwrap();
        }
        if let Some(issued) = issued {
            let (certificate, key) = issued.unwrap();
            std::fs::write(folder.join("certificate.pem"), certificate).unwrap();
            std::fs::write(folder.join("key.pem"), key).unwrap();
        }
        let options = SessionOptions { secure: Some(folder), ..SessionOptions::default() };
        let mut config = options.to_config().unwrap();
        // An attacker does not check what he is sent, and does not scruple to send.
        config.insert_json5("access_control", "{ enabled: false }").unwrap();
        if entry == Entry::NoCertificate {
            config.insert_json5("transport/link/tls/enable_mtls", "false").unwrap();
        }
        if entry == Entry::Plain {
            let endpoints = config.get_json("connect/endpoints").unwrap().replace("tls/", "tcp/");
            config.insert_json5("connect/endpoints", &endpoints).unwrap();
            config.insert_json5("transport/link/protocols", "['tcp']").unwrap();
        }
        config
    }
}

/// What an attacker with a session does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Forgery {
    /// Answers queries of the map, complete.
    Answers,
    /// Publishes a change of the map.
    Change,
    /// Publishes the status of another robot.
    Status,
    /// Declares the liveliness tokens of another robot and of a server.
    Tokens,
    /// Listens to what robots publish.
    Spies,
}

/// All forgeries.
pub const FORGERIES: [Forgery; 5] =
    [Forgery::Answers, Forgery::Change, Forgery::Status, Forgery::Tokens, Forgery::Spies];

/// What an attacker got: queries that he was asked, and messages that he was sent.
#[derive(Clone, Debug, Default)]
pub struct Booty {
    asked: Arc<AtomicUsize>,
    overheard: Arc<AtomicUsize>,
}

impl Booty {
    /// Queries that the attacker was asked.
    pub fn asked(&self) -> usize {
        self.asked.load(Ordering::Relaxed)
    }

    /// Messages that the attacker was sent.
    pub fn overheard(&self) -> usize {
        self.overheard.load(Ordering::Relaxed)
    }
}

impl Forgery {
    /// Does it in a session, which keeps it until it is closed.
    ///
    /// # Arguments
    /// * `variation`: chooses among the keys and wildcards that serve the purpose.
    pub async fn commit(self, session: &zenoh::Session, variation: usize, booty: &Booty) {
        let pick = |keys: &[&str]| keys[variation % keys.len()].to_owned();
        match self {
            Self::Answers => {
                let key =
                    pick(&["map/hall/info", "map/hall/match", "map/hall/*", "map/**", "map/*/info", "**"]);
                let asked = Arc::clone(&booty.asked);
                let answer = move |query: zenoh::query::Query| {
                    asked.fetch_add(1, Ordering::Relaxed);
                    let key = query.key_expr().clone();
                    query.reply(key, FORGED).wait().ok();
                };
                let queryable = session.declare_queryable(key).complete(true).callback(answer).background();
                queryable.await.unwrap();
            }
            Self::Change => {
                let key = pick(&["map/hall/changes", "map/*/changes", "map/hall/*", "map/**"]);
                let sigma = 10_f64.powi((variation % 300) as i32 - 10);
                let notice = serde_json::json!({
                    "schema": protocol::SCHEMA_VERSION, "map": "hall", "identity": "8f3c1e0a5b7d4926a1c04be2d97f6350", "from_version": 1,
                    "version": FORGED_VERSION, "moved": [],
                    "stated_change": { "sigma_theta_rad": sigma, "sigma_p_m": sigma }
                });
                let put = session.put(key, notice.to_string()).encoding(Format::Json.encoding());
                put.await.unwrap();
            }
            Self::Status => {
                let key =
                    pick(&["robot/ada/status", "robot/*/status", "robot/ada/*", "robot/**", "**/status"]);
                let put = session.put(key, status(FORGED_STAMP)).encoding(Format::Bincode.encoding());
                put.await.unwrap();
            }
            Self::Tokens => {
                let key = pick(&["robot/ada/session/forged", "map_server/forged", "robot/forged"]);
                let token = session.liveliness().declare_token(key).await.unwrap();
                // Lives as long as the session.
                std::mem::forget(token);
            }
            Self::Spies => {
                let key = pick(&["robot/ada/status", "robot/**", "robot/*/*", "**", "robot/ada/sensors/*"]);
                let overheard = Arc::clone(&booty.overheard);
                let hear = move |_: zenoh::sample::Sample| {
                    overheard.fetch_add(1, Ordering::Relaxed);
                };
                session.declare_subscriber(key).callback(hear).background().await.unwrap();
            }
        }
    }
}

/// The payload of a status of a time.
pub fn status(stamp_ns: i64) -> Vec<u8> {
    let status = RobotStatus {
        stamp_ns,
        state: RobotState::Localized,
        reason: String::new(),
        map: Some("hall".to_owned()),
        last_map_update_ns: None,
        keyframes_held: 0,
        queries_sent: 0,
        queries_answered: 0,
    };
    protocol::encode(Format::Bincode, &status).unwrap()
}

/// Answers to a query of the map, from all who answer.
pub async fn all_answers(session: &zenoh::Session, key: &str) -> Vec<Vec<u8>> {
    let query = session.get(key).target(QueryTarget::All).consolidation(ConsolidationMode::None);
    let replies = query.timeout(Duration::from_millis(500)).await.unwrap();
    let mut answers = Vec::new();
    while let Ok(reply) = replies.recv_async().await {
        if let Ok(sample) = reply.result() {
            answers.push(sample.payload().to_bytes().into_owned());
        }
    }
    answers
}
