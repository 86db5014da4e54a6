//! Links with TLS carry what is sent both ways at once, to its last byte.

use client::session::close_session;
use std::path::Path;
use std::time::Duration;
use tests::fleet::{PATIENCE, secured};
use tests::network::runtime;
use tools::in_process::free_endpoint;
use zenoh::Wait as _;
use zenoh::handlers::FifoChannelHandler;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::qos::CongestionControl;
use zenoh::sample::Sample;

/// Keys to which the listening and the connecting side publish.
const KEYS: [&str; 2] = ["from/listening", "from/connecting"];
/// Bytes of a message: several batches.
const MESSAGE_BYTES: usize = 1 << 20;
/// So long nothing is sent to keep a link alive, which would send what was left of a message, too.
const LEASE_MS: u64 = 600_000;

/// Two sessions with one link, the sockets of which are smaller than a batch.
async fn linked(folder: &Path, endpoint: &str) -> [zenoh::Session; 2] {
    secured(folder, false);
    let tls = |endpoint: &str| endpoint.replace("tcp/", "tls/");
    let member = |side: &str, endpoint: &str, keys: [(&str, &str); 3]| {
        let mut config = zenoh::Config::default();
        config.insert_json5("scouting/multicast/enabled", "false").unwrap();
        config.insert_json5("listen/endpoints", "[]").unwrap();
        config.insert_json5("transport/link/tx/lease", &LEASE_MS.to_string()).unwrap();
        config
            .insert_json5(&format!("{side}/endpoints"), &format!("['{}#so_sndbuf=16384']", tls(endpoint)))
            .unwrap();
        for (key, file) in keys {
            let path = folder.join(file);
            config
                .insert_json5(&format!("transport/link/tls/{key}"), &format!("'{}'", path.display()))
                .unwrap();
        }
        config
    };
    let trusted = ("root_ca_certificate", "south/ca.pem");
    let serving =
        [trusted, ("listen_certificate", "south/certificate.pem"), ("listen_private_key", "south/key.pem")];
    let asking =
        [trusted, ("connect_certificate", "ada/certificate.pem"), ("connect_private_key", "ada/key.pem")];
    let listening = zenoh::open(member("listen", endpoint, serving)).await.unwrap();
    let connecting = zenoh::open(member("connect", endpoint, asking)).await.unwrap();
    [listening, connecting]
}

/// Publishes messages as soon as somebody listens. The end of a publisher would be another message. Waiting for the link takes the thread.
///
/// # Arguments
/// * `alone`: each message is sent by itself.
fn publish(
    session: &zenoh::Session,
    key: &'static str,
    messages: u64,
    alone: bool,
    payload: fn(u64) -> Vec<u8>,
) -> Publisher<'static> {
    let publisher =
        session.declare_publisher(key).congestion_control(CongestionControl::Block).express(alone);
    let publisher = publisher.wait().unwrap();
    while !publisher.matching_status().wait().unwrap().matching() {
        std::thread::sleep(Duration::from_millis(10));
    }
    for number in 0..messages {
        publisher.put(payload(number)).wait().unwrap();
    }
    publisher
}

/// Waits for these messages, in their order.
async fn receive(
    session: zenoh::Session,
    key: &'static str,
    messages: u64,
    payload: fn(u64) -> Vec<u8>,
) -> Subscriber<FifoChannelHandler<Sample>> {
    let subscriber = session.declare_subscriber(key).await.unwrap();
    for number in 0..messages {
        let sample = tokio::time::timeout(PATIENCE, subscriber.recv_async()).await;
        let sample = sample.unwrap_or_else(|_| panic!("message {number} does not end")).unwrap();
        assert!(*sample.payload().to_bytes() == payload(number), "message {number}");
    }
    subscriber
}

/// Both ends of a link send at once.
fn exchange(messages: u64, alone: bool, payload: fn(u64) -> Vec<u8>) {
    let folder = tempfile::tempdir().unwrap();
    let endpoint = free_endpoint().unwrap();
    runtime().block_on(async {
        let [listening, connecting] = linked(&folder.path().join("fleet"), &endpoint).await;
        let sending = [(&listening, KEYS[0]), (&connecting, KEYS[1])].map(|(session, key)| {
            let session = session.clone();
            tokio::task::spawn_blocking(move || publish(&session, key, messages, alone, payload))
        });
        let receiving = [(&connecting, KEYS[0]), (&listening, KEYS[1])]
            .map(|(session, key)| tokio::spawn(receive(session.clone(), key, messages, payload)));
        let mut received = Vec::new();
        for task in receiving {
            received.push(task.await.unwrap());
        }
        for task in sending {
            task.await.unwrap();
        }
        drop(received);
        close_session(&connecting).await;
        close_session(&listening).await;
    });
}

#[test]
fn both_ends_send_at_once_and_messages_end() {
    exchange(50, false, |number| vec![number as u8; MESSAGE_BYTES]);
}

/// A TLS connection takes new keys after so many records of one direction: 2^23 with AES-GCM.
const RECORDS_OF_A_KEY: u64 = 1 << 23;

#[test]
#[ignore = "minutes"]
fn both_ends_take_new_keys_while_they_send() {
    let records = std::env::var("RECORDS").map_or(RECORDS_OF_A_KEY * 9 / 8, |text| text.parse().unwrap());
    exchange(records, true, |number| number.to_le_bytes().into());
}

/// Zenoh's own crate for these links lets two threads change one TLS connection at once.
#[test]
fn the_crate_without_a_data_race_is_built() {
    let lock = include_str!("../../Cargo.lock");
    let entry = lock.split("[[package]]").find(|entry| entry.contains("name = \"zenoh-link-tls\"")).unwrap();
    assert!(!entry.contains("source = "), "zenoh-link-tls is taken from the registry:{entry}");
}
