//! A large map at four servers whose memory is bounded, each a process of its own: what cold cells cost.

use std::io::{Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use client::{MapClient, SessionOptions, open_session};
use protocol::MatchOutcome;
use releases::{PublishOptions, ReleaseStore, publish};
use testing::resident_mb;
use zenoh::Session;

use super::cells::town;
use super::town::{quantile_ms, setting};

struct Server {
    process: Child,
    monitoring: String,
}

impl Server {
    fn start(endpoint: &str, store: &Path, cache: &Path, name: &str, memory: &str) -> Self {
        let monitoring = format!("127.0.0.1:{}", free_port());
        let mut command = Command::new(env!("CARGO_BIN_EXE_map_server"));
        command.args(["--map", &format!("town=file://{}", store.display()), "--cells", "auto"]);
        command.args(["--name", name, "--memory", memory, "--connect", endpoint, "--log", "warn"]);
        command.args(["--monitoring", &monitoring]).arg("--cache").arg(cache.join(name));
        command.arg("--state").arg(cache.join(name).join("state"));
        let process = command.stdin(Stdio::null()).spawn().unwrap();
        Self { process, monitoring }
    }

    /// A metric of the server, 0 where it is not there yet.
    fn metric(&self, name: &str) -> f64 {
        let mut text = String::new();
        let Ok(mut stream) = TcpStream::connect(&self.monitoring) else { return 0.0 };
        let host = &self.monitoring;
        write!(stream, "GET /metrics HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n").unwrap();
        stream.read_to_string(&mut text).unwrap();
        let value = text.lines().find_map(|line| line.strip_prefix(&format!("driftless_map_server_{name} ")));
        value.map_or(0.0, |value| value.parse().unwrap())
    }

    /// Processor time of the process, seconds.
    fn processor_s(&self) -> f64 {
        let text = std::fs::read_to_string(format!("/proc/{}/stat", self.process.id())).unwrap();
        let after_name = text.rsplit(')').next().unwrap();
        let field = |at: usize| after_name.split_whitespace().nth(at).unwrap().parse::<f64>().unwrap();
        // User and system time in ticks of 10 ms.
        (field(11) + field(12)) / 100.0
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

async fn router() -> (Session, String) {
    let endpoint = format!("tcp/127.0.0.1:{}", free_port());
    let mut config = zenoh::Config::default();
    config.insert_json5("mode", "\"router\"").unwrap();
    config.insert_json5("listen/endpoints", &format!("[\"{endpoint}\"]")).unwrap();
    config.insert_json5("scouting/multicast/enabled", "false").unwrap();
    (zenoh::open(config).await.unwrap(), endpoint)
}

fn sum(servers: &[Server], value: impl Fn(&Server) -> f64) -> f64 {
    servers.iter().map(value).sum()
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "a measurement of many minutes"]
async fn a_town_at_four_servers_with_bounded_memory() {
    let (places, keyframes) = (setting("PLACES", 20), setting("KEYFRAMES", 5000));
    let memory = std::env::var("MEMORY").unwrap_or_else(|_| "1G".to_owned());
    let folder = tempfile::tempdir().unwrap();
    let city = folder.path().join("city");
    let store = ReleaseStore::open(city.to_str().unwrap()).unwrap();
    let (map, without, with) = town(places, keyframes);
    let mut options = PublishOptions::default();
    options.keyframes_a_cell = keyframes;
    publish(&store, map, &options, |_| {}).await.unwrap();
    let release = store.newest().await.unwrap().unwrap();
    println!(
        "{} keyframes in {} cells, {} MB",
        release.keyframes(),
        release.cells.len(),
        release.bytes() >> 20
    );

    let (_router, endpoint) = router().await;
    let begin = Instant::now();
    let start = |name: &&str| Server::start(&endpoint, &city, folder.path(), name, &memory);
    let servers: Vec<Server> = ["north", "south", "west", "east"].iter().map(start).collect();
    while (sum(&servers, |server| server.metric("cells")) as usize) < 2 * release.cells.len() {
        assert!(begin.elapsed() < Duration::from_mins(30));
        tokio::time::sleep(Duration::from_secs(1)).await;
    }
    println!("all cells at two of four servers after {:.0?}", begin.elapsed());

    let options = SessionOptions { connect: vec![endpoint], ..SessionOptions::default() };
    let client = MapClient::new(open_session(&options).await.unwrap(), "town").unwrap();
    for (what, requests) in [("without prior", &without), ("with prior", &with)] {
        // Place after place: cells go cold and come back. Then many of one place, whose cell stays.
        for (order, rounds) in [("all places in turn", true), ("one place at a time", false)] {
            let loads = || sum(&servers, |server| server.metric("cold_load_duration_seconds_count"));
            let load_s = || sum(&servers, |server| server.metric("cold_load_duration_seconds_sum"));
            let before = (loads(), load_s(), sum(&servers, Server::processor_s));
            let (mut warm, mut cold, mut matched, mut failed) = (Vec::new(), Vec::new(), 0, 0);
            let images = requests[0].len();
            for at in 0..images * places {
                let (place, image) =
                    if rounds { (at % places, at / places) } else { (at / images, at % images) };
                let loads_before = loads();
                let begin = Instant::now();
                let answer =
                    client.match_image(&requests[place][image], begin + Duration::from_secs(5)).await;
                let elapsed = begin.elapsed();
                match answer {
                    Ok(answer) => matched += usize::from(answer.status.outcome == MatchOutcome::Matched),
                    Err(_) => failed += 1,
                }
                if loads() > loads_before { &mut cold } else { &mut warm }.push(elapsed);
            }
            let loaded = loads() - before.0;
            let mean_ms = (load_s() - before.1) * 1e3 / loaded.max(1.0);
            let processor_ms =
                (sum(&servers, Server::processor_s) - before.2) * 1e3 / (images * places) as f64;
            println!(
                "{what}, {order}: {matched} of {} matched, {failed} failed; {loaded} cold loads of {mean_ms:.0} ms; {processor_ms:.1} ms of \
                 processors a query",
                images * places
            );
            for (kind, durations) in [("warm", &mut warm), ("cold", &mut cold)] {
                durations.sort();
                let [median, most, all] = [0.5, 0.95, 1.0].map(|part| quantile_ms(durations, part));
                println!(
                    "  {kind}: {} answers, median {median:.1} ms, 95 % below {most:.1}, all below {all:.1}",
                    durations.len()
                );
            }
        }
    }
    for server in &servers {
        let (cells, in_memory) = (server.metric("cells"), server.metric("cells_in_memory"));
        let (mb, bytes) =
            (resident_mb(server.process.id()).unwrap(), server.metric("cells_memory_bytes") / 1e6);
        println!("a server: {in_memory} of {cells} cells in memory, {bytes:.0} MB; {mb:.0} MB resident");
    }
}
