//! A fleet that `driftless fleet` secured: its members work together, and others, or members that overstep their role,
//! are neither served nor believed.

use client::session::{CONFIG_FILE, Role, SessionMode, SessionOptions, close_session, open_session};
use map_server::{CellService, CellServiceOptions, MapServer, ServerOptions};
use protocol::{Format, MatchOutcome};
use rand::SeedableRng as _;
use rand::rngs::StdRng;
use releases::{PublishOptions, ReleaseStore, publish};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use testing::{Place, PlaceOptions};
use tests::attack::{
    Booty, Entry, FORGED, FORGED_STAMP, FORGED_VERSION, FORGERIES, Forger, Forgery, MEMBERS, OUTSIDERS,
    VICTIM, all_answers, status,
};
use tests::fleet::{
    FleetOperator, FleetRobot, FleetServer, MAP, PATIENCE, assert_works, member, secured, session,
};
use tools::fleet::{Fleet, Validity};
use tools::in_process::free_endpoint;

/// Variations in CI; [`thousand`] is run by hand.
const VARIATIONS: usize = 100;
/// Time that a forgery is given to spread before the witnesses are asked.
const ARRIVAL: Duration = Duration::from_millis(100);

/// The router of a fleet that has one.
async fn router_of(fleet: &Fleet, folder: &Path) -> Option<zenoh::Session> {
    match fleet.hub().role {
        Role::Router => Some(open_session(&member(folder, &fleet.hub().name)).await.unwrap()),
        _ => None,
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn members_work_together_and_new_and_renewed_ones_too() {
    for router in [false, true] {
        let folder = tempfile::tempdir().unwrap();
        let place = folder.path().join("fleet");
        let mut fleet = secured(&place, router);
        fleet.add(Role::Robot, "cy", Validity::default()).unwrap();
        fleet.renew(Some(VICTIM), Validity::default()).unwrap();
        let between = router_of(&fleet, &place).await;
        let mut server = FleetServer::start(&member(&place, "south")).await;
        let operator = FleetOperator::start(&member(&place, "ann")).await;
        for name in [VICTIM, "bo", "cy"] {
            let mut robot = FleetRobot::start(name, &member(&place, name)).await;
            assert_works(&mut server, &mut robot, &operator).await;
            close_session(&robot.session).await;
        }
        server.stop().await;
        if let Some(between) = between {
            close_session(&between).await;
        }
    }
}

/// Servers ask each other for cells, and robots ask for none.
#[tokio::test(flavor = "multi_thread")]
async fn servers_share_the_cells_of_a_map() {
    let folder = tempfile::tempdir().unwrap();
    let secure = folder.path().join("fleet");
    let mut fleet = secured(&secure, true);
    fleet.add(Role::MapServer, "north", Validity::default()).unwrap();
    let between = router_of(&fleet, &secure).await;

    let place = Place::new(&PlaceOptions { keyframes: 24, landmarks: 1200, ..PlaceOptions::default() });
    let store = ReleaseStore::open(folder.path().join("city").to_str().unwrap()).unwrap();
    let mut options = PublishOptions::default();
    options.keyframes_a_cell = 6;
    publish(&store, place.map.clone(), &options, |_| {}).await.unwrap();
    let cells = store.newest().await.unwrap().unwrap().cells.len();

    let mut servers = Vec::new();
    for name in ["north", "south"] {
        let session = open_session(&member(&secure, name)).await.unwrap();
        let mut options = ServerOptions::default();
        options.name = Some(name.to_owned());
        let server = MapServer::start(session.clone(), Vec::new(), options).await.unwrap();
        let mut options = CellServiceOptions::new(folder.path().join(name));
        options.replicas = 1;
        let service = CellService::start(&server, MAP, store.clone(), options).await.unwrap();
        servers.push((session, server, service));
    }
    let operator = open_session(&member(&secure, "ann")).await.unwrap();
    let begin = Instant::now();
    while all_tokens(&operator, "map/hall/cell/*/server/*").await.len() != cells {
        assert!(begin.elapsed() < PATIENCE);
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    let holders = all_tokens(&operator, "map/hall/cell/*/server/*").await;
    assert!(
        ["north", "south"].iter().all(|name| holders.iter().any(|key| key.ends_with(name))),
        "{holders:?}"
    );

    let robot = FleetRobot::start(VICTIM, &member(&secure, VICTIM)).await;
    let mut rng = StdRng::seed_from_u64(5);
    for pose in place.path.iter().step_by(4) {
        let request = place.request(pose, 4, &mut rng);
        let answer = robot.map.match_image(&request, Instant::now() + PATIENCE).await.unwrap();
        assert_eq!(answer.status.outcome, MatchOutcome::Matched);
        let payload = protocol::encode(Format::Bincode, &request).unwrap();
        for cell in 0..cells {
            let key = format!("map/hall/cell/{cell}/match");
            let replies =
                robot.session.get(key).payload(payload.clone()).encoding(Format::Bincode.encoding());
            let replies = replies.timeout(Duration::from_millis(300)).await.unwrap();
            let reply = replies.recv_async().await;
            assert!(reply.is_err() || reply.unwrap().result().is_err(), "a robot was answered by a cell");
        }
    }
    for (session, server, service) in servers {
        service.stop().await;
        server.stop().await.unwrap();
        close_session(&session).await;
    }
    drop(between);
}

async fn all_tokens(session: &zenoh::Session, keys: &str) -> Vec<String> {
    let tokens = session.liveliness().get(keys).await.unwrap();
    let mut found = Vec::new();
    while let Ok(token) = tokens.recv_async().await {
        found.extend(token.result().ok().map(|sample| sample.key_expr().as_str().to_owned()));
    }
    found
}

/// Honest members of a running fleet, who notice what is forged.
struct Witnesses {
    robot: FleetRobot,
    operator: zenoh::Session,
    heard: zenoh::pubsub::Subscriber<zenoh::handlers::FifoChannelHandler<zenoh::sample::Sample>>,
    published: i64,
}

impl Witnesses {
    async fn start(robot: &SessionOptions, operator: &SessionOptions) -> Self {
        let robot = FleetRobot::start(VICTIM, robot).await;
        let operator = open_session(operator).await.unwrap();
        let heard = operator.declare_subscriber("robot/**").await.unwrap();
        Self { robot, operator, heard, published: 0 }
    }

    /// Waits until what the hub took before is here: an honest status has the same way.
    ///
    /// # Returns
    /// Forged statuses.
    async fn forged_statuses(&mut self) -> usize {
        self.published += 1;
        let honest = status(self.published);
        self.robot.publish(self.published).await;
        let mut forged = 0;
        let end = Instant::now() + Duration::from_secs(20);
        loop {
            let wait = end.saturating_duration_since(Instant::now());
            let sample = tokio::time::timeout(wait, self.heard.recv_async()).await;
            let payload =
                sample.expect("the honest robot is heard").unwrap().payload().to_bytes().into_owned();
            forged += usize::from(payload == status(FORGED_STAMP));
            if payload == honest {
                return forged;
            }
        }
    }

    /// What was believed of all that was forged.
    async fn believed(&mut self) -> Vec<String> {
        let mut believed = Vec::new();
        if self.forged_statuses().await > 0 {
            believed.push("a forged status was heard".to_owned());
        }
        if self.robot.told_version() == Some(FORGED_VERSION) {
            believed.push("a forged change of the map was heard".to_owned());
        }
        let answers = all_answers(&self.robot.session, "map/hall/info").await;
        if answers.iter().any(|answer| answer == FORGED) {
            believed.push("a forged answer was taken".to_owned());
        }
        if !answers.iter().any(|answer| answer != FORGED) {
            believed.push("the map server does not answer any more".to_owned());
        }
        let tokens = self.operator.liveliness().get("**").timeout(Duration::from_millis(500)).await.unwrap();
        while let Ok(token) = tokens.recv_async().await {
            let key = token.result().map(|sample| sample.key_expr().to_string()).unwrap_or_default();
            if key.contains("forged") {
                believed.push(format!("the forged token {key} was seen"));
            }
        }
        believed
    }
}

/// One attacker after another, of all kinds.
async fn attack(fleet: &Fleet, place: &Path, variations: usize, witnesses: &mut Witnesses) {
    let folder = tempfile::tempdir().unwrap();
    let forger = Forger::new(fleet, place, folder.path());
    let mut entered = 0;
    for variation in 0..variations {
        let forgery = FORGERIES[variation / 2 % FORGERIES.len()];
        // Half of the attackers are members or have a valid certificate.
        let which = variation / 10;
        let entry = if variation % 2 == 0 { OUTSIDERS[which % 4] } else { MEMBERS[which % 4] };
        let name = match entry {
            Entry::Member(Role::Operator) => "ann",
            Entry::Member(Role::MapServer) if fleet.hub().role == Role::Router => "south",
            _ => "bo",
        };
        // A server may answer and publish changes, an operator may listen.
        let allowed = matches!(
            (name, entry, forgery),
            ("south", Entry::Member(_), Forgery::Answers | Forgery::Change) | ("ann", _, Forgery::Spies)
        );
        let forgery = if allowed { Forgery::Status } else { forgery };
        let said = format!("variation {variation}: {entry:?} as {name}, {forgery:?}");
        let mut config = forger.config(entry, name);
        // All attackers are clients of the hub, one attempt.
        config.insert_json5("connect/timeout_ms", "0").unwrap();
        let Ok(session) = zenoh::open(config).await else {
            assert!(OUTSIDERS.contains(&entry), "{said}: could not connect, and proved nothing");
            continue;
        };
        assert!(!OUTSIDERS.contains(&entry), "{said}: was let in");
        entered += 1;
        if entry == Entry::Stranger {
            // Before the forgery: one who forges answers would get them from itself.
            assert!(all_answers(&session, "map/hall/info").await.is_empty(), "{said}: served");
        }
        let booty = Booty::default();
        forgery.commit(&session, variation, &booty).await;
        tokio::time::sleep(ARRIVAL).await;
        let believed = witnesses.believed().await;
        assert!(believed.is_empty(), "{said}: {believed:?}");
        assert_eq!((booty.asked(), booty.overheard()), (0, 0), "{said}: was asked, overheard");
        close_session(&session).await;
    }
    println!("{variations} variations, {entered} with a session: 0 served, 0 believed");
}

async fn attack_both_layouts(variations: usize) {
    for router in [false, true] {
        let folder = tempfile::tempdir().unwrap();
        let place = folder.path().join("fleet");
        let fleet = secured(&place, router);
        let between = router_of(&fleet, &place).await;
        let server = FleetServer::start(&member(&place, "south")).await;
        let mut witnesses = Witnesses::start(&member(&place, VICTIM), &member(&place, "ann")).await;
        attack(&fleet, &place, variations / 2, &mut witnesses).await;
        server.stop().await;
        drop(between);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn nobody_else_is_served_or_believed() {
    attack_both_layouts(VARIATIONS).await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "a thousand variations take minutes"]
async fn thousand() {
    attack_both_layouts(1000).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn whoever_answers_before_the_server_is_not_believed() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("fleet");
    let fleet = secured(&place, true);
    let between = router_of(&fleet, &place).await;
    let forger = Forger::new(&fleet, &place, folder.path());
    let attacker = zenoh::open(forger.config(Entry::Member(Role::Robot), "bo")).await.unwrap();
    let booty = Booty::default();
    Forgery::Answers.commit(&attacker, 0, &booty).await;
    let mut witnesses = Witnesses::start(&member(&place, VICTIM), &member(&place, "ann")).await;
    assert!(all_answers(&witnesses.robot.session, "map/hall/info").await.is_empty());
    let server = FleetServer::start(&member(&place, "south")).await;
    witnesses.robot.first_answer().await;
    assert_eq!(witnesses.believed().await, Vec::<String>::new());
    assert_eq!(booty.asked(), 0);
    server.stop().await;
    drop(between);
}

/// Publishes until somebody hears it.
async fn heard(
    publisher: &zenoh::Session,
    key: &str,
    payload: &str,
    listener: &zenoh::pubsub::Subscriber<zenoh::handlers::FifoChannelHandler<zenoh::sample::Sample>>,
) -> Vec<String> {
    let (begin, mut heard) = (Instant::now(), Vec::new());
    while !heard.iter().any(|text| text == payload) {
        assert!(begin.elapsed() < PATIENCE, "{payload} on {key} is not heard: {heard:?}");
        publisher.put(key, payload).await.unwrap();
        tokio::time::sleep(Duration::from_millis(20)).await;
        let text = |sample: zenoh::sample::Sample| sample.payload().try_to_string().unwrap().into_owned();
        heard.extend(listener.drain().map(text));
    }
    heard
}

#[tokio::test(flavor = "multi_thread")]
async fn drivers_reach_their_own_robot_and_no_other() {
    for router in [false, true] {
        let folder = tempfile::tempdir().unwrap();
        let place = folder.path().join("fleet");
        let fleet = secured(&place, router);
        let between = router_of(&fleet, &place).await;
        let server = FleetServer::start(&member(&place, "south")).await;
        let robot = open_session(&member(&place, VICTIM)).await.unwrap();
        // The drivers have the folder of their robot.
        let driver = open_session(&member(&place, VICTIM)).await.unwrap();
        let operator = open_session(&member(&place, "ann")).await.unwrap();
        let watched = operator.declare_subscriber("robot/*/sensors/*").await.unwrap();
        // Another robot's, which does not check what it sends.
        let forger = Forger::new(&fleet, &place, folder.path());
        let other = zenoh::open(forger.config(Entry::Member(Role::Robot), "bo")).await.unwrap();
        let spied = other.declare_subscriber("robot/ada/sensors/*").await.unwrap();
        let spied_all = other.declare_subscriber("robot/**").await.unwrap();
        for stream in ["imu", "cam0", "cam1", "tracks"] {
            let key = format!("robot/{VICTIM}/sensors/{stream}");
            let sensors = robot.declare_subscriber(key.clone()).await.unwrap();
            heard(&driver, &key, "honest", &sensors).await;
            for forged in [key.as_str(), "robot/*/sensors/*", "robot/**", "**"] {
                other.put(forged, "forged").await.unwrap();
            }
            tokio::time::sleep(ARRIVAL).await;
            let all = heard(&driver, &key, "honest again", &sensors).await;
            assert!(!all.iter().any(|text| text == "forged"), "{key}: {all:?}");
        }
        let of_bo = open_session(&member(&place, "bo")).await.unwrap();
        let listener = of_bo.declare_subscriber("robot/bo/sensors/imu").await.unwrap();
        heard(&other, "robot/bo/sensors/imu", "its own", &listener).await;
        // What the other one published itself it hears, of course.
        let is_honest = |sample: zenoh::sample::Sample| sample.payload().to_bytes().starts_with(b"honest");
        assert!(!spied.drain().chain(spied_all.drain()).any(is_honest), "overheard");
        assert!(watched.drain().any(is_honest), "an operator sees them");
        for session in [driver, robot, operator, other, of_bo] {
            close_session(&session).await;
        }
        server.stop().await;
        drop(between);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn without_security_every_forgery_is_believed() {
    let at = free_endpoint().unwrap();
    let server = FleetServer::start(&session(&[&at], &[])).await;
    let options = session(&[], &[&at]);
    let mut witnesses = Witnesses::start(&options, &options).await;
    witnesses.robot.first_answer().await;
    for forgery in FORGERIES {
        let attacker = open_session(&options).await.unwrap();
        let booty = Booty::default();
        let (begin, mut believed) = (Instant::now(), Vec::new());
        forgery.commit(&attacker, 0, &booty).await;
        while believed.is_empty() && booty.overheard() == 0 {
            assert!(begin.elapsed() < PATIENCE, "{forgery:?} proves nothing: it does not work");
            believed = witnesses.believed().await;
        }
        close_session(&attacker).await;
    }
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_does_not_connect_to_somebody_else_at_the_address() {
    let folder = tempfile::tempdir().unwrap();
    let (place, elsewhere) = (folder.path().join("fleet"), folder.path().join("other"));
    let honest = secured(&place, false);
    let other = secured(&elsewhere, false);
    let (port, other_port) = (port(&honest), port(&other));
    // The server of another fleet, and a member with its own certificate, which is for connecting only.
    let mut foreign = member(&elsewhere, "south");
    foreign.listen = vec![format!("tls/127.0.0.1:{port}")];
    let impostor = folder.path().join("impostor");
    std::fs::create_dir(&impostor).unwrap();
    for file in ["ca.pem", "certificate.pem", "key.pem"] {
        std::fs::copy(place.join("bo").join(file), impostor.join(file)).unwrap();
    }
    let config = std::fs::read_to_string(place.join("south").join(CONFIG_FILE)).unwrap();
    std::fs::write(impostor.join(CONFIG_FILE), config).unwrap();
    let impostor = SessionOptions { secure: Some(impostor), ..SessionOptions::default() };
    for listener in [foreign, impostor] {
        let session = listening(&listener).await;
        let mut config = member(&place, VICTIM).to_config().unwrap();
        config.insert_json5("connect/timeout_ms", "0").unwrap();
        assert!(zenoh::open(config).await.is_err(), "connected to {listener:?}");
        close_session(&session).await;
    }
    assert_ne!(port, other_port);
}

/// A session that listens where another one did: the address is free some time after that one was closed.
async fn listening(options: &SessionOptions) -> zenoh::Session {
    let begin = Instant::now();
    loop {
        match open_session(options).await {
            Ok(session) => return session,
            Err(error) => assert!(begin.elapsed() < PATIENCE, "{error}"),
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

fn port(fleet: &Fleet) -> String {
    let config = std::fs::read_to_string(fleet.folder_of("south").join(CONFIG_FILE)).unwrap();
    let at = config.find("tls/127.0.0.1:").unwrap() + "tls/127.0.0.1:".len();
    config[at..].chars().take_while(char::is_ascii_digit).collect()
}

/// Writes a configuration, as the documentation shows it.
fn written(folder: &Path, name: &str, text: &str) -> SessionOptions {
    let path: PathBuf = folder.join(name);
    std::fs::write(&path, text).unwrap();
    SessionOptions { config_file: Some(path), ..SessionOptions::default() }
}

#[tokio::test(flavor = "multi_thread")]
async fn users_need_their_password() {
    let folder = tempfile::tempdir().unwrap();
    let users = folder.path().join("users.txt");
    std::fs::write(&users, "r1:rosebud\ns1:xanadu\n").unwrap();
    let at = free_endpoint().unwrap();
    let listening = format!(
        "{{ mode: 'router', listen: {{ endpoints: ['{at}'] }}, transport: {{ auth: {{ usrpwd: {{ dictionary_file: '{}' }} }} }} }}",
        users.display()
    );
    let between = open_session(&written(folder.path(), "router.json5", &listening)).await.unwrap();
    let user = |user: &str, password: &str| {
        let text = format!(
            "{{ connect: {{ endpoints: ['{at}'] }}, transport: {{ auth: {{ usrpwd: {{ user: '{user}', password: '{password}' }} }} }} }}"
        );
        written(folder.path(), &format!("{user}{password}.json5"), &text)
    };
    let server = FleetServer::start(&user("s1", "xanadu")).await;
    let robot = FleetRobot::start("r1", &user("r1", "rosebud")).await;
    robot.first_answer().await;
    for options in [user("r1", "xanadu"), user("r1", ""), user("nobody", "rosebud"), session(&[], &[&at])] {
        let mut config = options.to_config().unwrap();
        config.insert_json5("connect/timeout_ms", "0").unwrap();
        assert!(zenoh::open(config).await.is_err(), "{options:?}");
    }
    server.stop().await;
    close_session(&between).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn tls_serves_whoever_trusts_the_authority() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("fleet");
    secured(&place, false);
    let at = free_endpoint().unwrap().replace("tcp/", "tls/");
    let (ca, own) = (place.join("south/ca.pem"), place.join("south"));
    let serving = format!(
        "{{ listen: {{ endpoints: ['{at}'] }}, transport: {{ link: {{ tls: {{ listen_certificate: '{}', listen_private_key: '{}' }} }} }} }}",
        own.join("certificate.pem").display(),
        own.join("key.pem").display()
    );
    let server = FleetServer::start(&written(folder.path(), "server.json5", &serving)).await;
    let robot = format!(
        "{{ connect: {{ endpoints: ['{at}'] }}, transport: {{ link: {{ tls: {{ root_ca_certificate: '{}' }} }} }} }}",
        ca.display()
    );
    let robot = FleetRobot::start("r1", &written(folder.path(), "robot.json5", &robot)).await;
    robot.first_answer().await;
    server.stop().await;
}

#[test]
fn a_member_folder_is_for_its_role_and_for_tls_only() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("fleet");
    secured(&place, false);
    let expect = |name: &str, role, given| {
        client::session::Member::expect(&place.join(name), role, ("--robot", given))
            .map_err(|error| error.to_string())
    };
    assert_eq!(expect("ada", Role::Robot, None).unwrap(), "ada");
    assert!(expect("south", Role::Robot, None).unwrap_err().contains("map server south"));
    assert!(expect("ada", Role::Robot, Some("bo")).unwrap_err().contains("leave --robot out"));
    assert!(expect("nobody", Role::Robot, None).unwrap_err().contains("driftless fleet init"));
    let mut options = member(&place, VICTIM);
    options.connect = vec!["tcp/127.0.0.1:7447".to_owned()];
    assert!(options.to_config().unwrap_err().to_string().contains("not encrypted"));
    options.connect = Vec::new();
    options.mode = Some(SessionMode::Client);
    assert!(options.to_config().is_ok());
}
