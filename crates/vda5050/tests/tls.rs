//! Brokers that are reached by TLS: one of this test, and mosquitto where it is installed (`apt-get install mosquitto`).

use crate::bridge::{Running, start};
use crate::broker::{Broker, Received};
use rcgen::{BasicConstraints, CertificateParams, DnType, IsCa, Issuer, KeyPair};
use rustls::pki_types::pem::PemObject as _;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use rustls::server::WebPkiClientVerifier;
use rustls::{RootCertStore, ServerConfig};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncBufReadExt as _, AsyncWriteExt as _, BufReader};
use tokio::process::{Child, Command};
use vda5050::{
    BridgeError, BridgeEvent, BridgeSettings, BrokerTls, BrokerTlsError, BrokerUser, CertificateOf,
    ClientIdentity,
};

/// An authority that signs certificates.
struct Authority {
    pem: String,
    issuer: Issuer<'static, KeyPair>,
}

/// Certificate and key, PEM.
struct Member {
    certificate: String,
    key: String,
}

impl Authority {
    fn new(name: &str) -> Self {
        let key = KeyPair::generate().unwrap();
        let mut params = CertificateParams::new(Vec::new()).unwrap();
        params.distinguished_name.push(DnType::CommonName, name);
        params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
        let pem = params.self_signed(&key).unwrap().pem();
        Self { pem, issuer: Issuer::new(params, key) }
    }

    fn sign(&self, name: &str) -> Member {
        let key = KeyPair::generate().unwrap();
        let mut params = CertificateParams::new(vec![name.to_owned()]).unwrap();
        params.distinguished_name.push(DnType::CommonName, name);
        let certificate = params.signed_by(&key, &self.issuer).unwrap().pem();
        Member { certificate, key: key.serialize_pem() }
    }

    /// TLS of a broker that asks for a certificate of this authority.
    fn server(&self, broker: &Member) -> ServerConfig {
        let mut roots = RootCertStore::empty();
        roots.add(CertificateDer::from_pem_slice(self.pem.as_bytes()).unwrap()).unwrap();
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let clients =
            WebPkiClientVerifier::builder_with_provider(roots.into(), provider.clone()).build().unwrap();
        let chain = vec![CertificateDer::from_pem_slice(broker.certificate.as_bytes()).unwrap()];
        let key = PrivateKeyDer::from_pem_slice(broker.key.as_bytes()).unwrap();
        let builder = ServerConfig::builder_with_provider(provider).with_safe_default_protocol_versions();
        builder.unwrap().with_client_cert_verifier(clients).with_single_cert(chain, key).unwrap()
    }

    /// TLS of a bridge that believes this authority.
    fn client(&self, identity: Option<&Member>) -> BrokerTls {
        let identity = identity.map(|member| ClientIdentity {
            certificates_pem: member.certificate.clone().into_bytes(),
            key_pem: member.key.clone().into_bytes(),
        });
        BrokerTls { authorities_pem: Some(self.pem.clone().into_bytes()), identity }
    }
}

fn settings(url: &str, tls: BrokerTls) -> BridgeSettings {
    let user = Some(BrokerUser { name: "fleet".to_owned(), password: "secret".to_owned() });
    BridgeSettings { rate_hz: 20.0, tls, user, ..BridgeSettings::new(url.parse().unwrap(), "acme") }
}

async fn wait_for_failure(running: &Running, what: &str) {
    let is_named =
        |event: &BridgeEvent| matches!(event, BridgeEvent::BrokerFailed { error } if error.contains(what));
    running.wait_for(is_named).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_broker_is_reached_by_tls_with_certificates_on_both_sides() {
    let authority = Authority::new("ours");
    let (own, of_bridge) = (authority.sign("127.0.0.1"), authority.sign("bridge"));
    let mut broker = Broker::start_with(0, 0, Some(authority.server(&own))).await;
    let url = format!("mqtts://{}", broker.address);
    let running = start(settings(&url, authority.client(Some(&of_bridge)))).await;
    let driving = running.drive("cart7");
    let Received::Connect { user, will, .. } = broker.next().await else { panic!("no connection") };
    assert_eq!((user, will.is_some()), (Some(("fleet".to_owned(), "secret".to_owned())), true));
    broker.message("/connection", |payload| payload["connectionState"] == "ONLINE").await;
    broker.message("/visualization", |payload| payload["agvPosition"]["positionInitialized"] == true).await;
    driving.abort();
    running.stop().await;
    broker.message("/connection", |payload| payload["connectionState"] == "OFFLINE").await;
    assert_eq!(broker.next().await, Received::Disconnect);
}

#[tokio::test(flavor = "multi_thread")]
async fn who_cannot_prove_who_he_is_gets_no_message() {
    let (authority, stranger) = (Authority::new("ours"), Authority::new("theirs"));
    let own = authority.sign("127.0.0.1");
    let elsewhere = authority.sign("broker.example");
    let of_bridge = authority.sign("bridge");
    for (broker, tls, what) in [
        // A broker of another authority, and one of another name.
        (
            &own,
            stranger.client(Some(&of_bridge)),
            "no connection by TLS: invalid peer certificate: UnknownIssuer",
        ),
        (&elsewhere, authority.client(Some(&of_bridge)), "not valid for name"),
        // A bridge without a certificate, and with one of another authority.
        (&own, authority.client(None), ""),
        (&own, authority.client(Some(&stranger.sign("bridge"))), ""),
    ] {
        let mut broker = Broker::start_with(0, 0, Some(authority.server(broker))).await;
        let running = start(settings(&format!("mqtts://{}", broker.address), tls)).await;
        let present = running.presence("cart7");
        wait_for_failure(&running, what).await;
        let received = broker.next().await;
        assert!(matches!(received, Received::NoTls(_)), "{what}: {received:?}");
        present.abort();
        running.stop().await;
    }
    // A broker without TLS.
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let url = format!("mqtts://{}", listener.local_addr().unwrap());
    let running = start(settings(&url, authority.client(None))).await;
    let _present = running.presence("cart7");
    listener.accept().await.unwrap().0.write_all(&[0x20, 2, 0, 0]).await.unwrap();
    wait_for_failure(&running, "no connection by TLS").await;
    running.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn certificates_that_cannot_be_used_are_refused_before_anything_is_published() {
    let authority = Authority::new("ours");
    let (one, other) = (authority.sign("bridge"), authority.sign("bridge"));
    let session = client::open_session(&client::SessionOptions::default()).await.unwrap();
    let run = async |url: &str, tls: BrokerTls| {
        let refused = vda5050::run(&session, settings(url, tls), std::future::pending(), |_| {});
        let error = tokio::time::timeout(Duration::from_secs(20), refused).await.unwrap().unwrap_err();
        assert!(!format!("{error}").contains("PRIVATE"), "{error}");
        error
    };
    let good = authority.client(Some(&one));
    let mixed = Member { certificate: one.certificate.clone(), key: other.key.clone() };
    let error = run("mqtts://127.0.0.1", authority.client(Some(&mixed))).await;
    assert!(matches!(error, BridgeError::Tls(BrokerTlsError::Identity(_))), "{error}");
    let no_key = Member { certificate: one.certificate.clone(), key: one.certificate.clone() };
    let error = run("mqtts://127.0.0.1", authority.client(Some(&no_key))).await;
    assert!(matches!(error, BridgeError::Tls(BrokerTlsError::Key(_))), "{error}");
    let text = |text: &str| BrokerTls { authorities_pem: Some(text.as_bytes().to_vec()), identity: None };
    let error = run("mqtts://127.0.0.1", text("no certificate")).await;
    let is_named =
        |of| matches!(&error, BridgeError::Tls(BrokerTlsError::NoCertificate(named)) if *named == of);
    assert!(is_named(CertificateOf::Authorities), "{error}");
    let cut = &authority.pem[..authority.pem.len() / 2];
    let error = run("mqtts://127.0.0.1", text(cut)).await;
    assert!(matches!(error, BridgeError::Tls(_)), "{error}");
    // Certificates for an address that does not use them.
    let error = run("mqtt://127.0.0.1", good).await;
    assert!(matches!(error, BridgeError::NoTls(_)) && error.to_string().contains("mqtts://"), "{error}");
    client::close_session(&session).await;
}

/// mosquitto, where it is installed.
fn mosquitto() -> Option<PathBuf> {
    let folders =
        std::env::split_paths(&std::env::var_os("PATH")?).chain(["/usr/sbin".into()]).collect::<Vec<_>>();
    folders.iter().map(|folder| folder.join("mosquitto")).find(|path| path.is_file())
}

/// A mosquitto that asks for certificate, user and password, and logs what it does.
async fn start_mosquitto(program: &Path, folder: &Path, authority: &Authority) -> (Child, u16) {
    let own = authority.sign("127.0.0.1");
    for (name, text) in [("ca.pem", &authority.pem), ("own.pem", &own.certificate), ("own.key", &own.key)] {
        std::fs::write(folder.join(name), text).unwrap();
    }
    // The file of passwords of "fleet" with "secret": PBKDF2 of SHA-512, by mosquitto's own program.
    let words = folder.join("passwords");
    let mut making = Command::new("mosquitto_passwd");
    making.arg("-b").arg("-c").arg(&words).args(["fleet", "secret"]);
    assert!(making.status().await.unwrap().success());
    let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let path = |name: &str| folder.join(name).display().to_string();
    let text = format!(
        "user root\nlistener {port} 127.0.0.1\ncafile {}\ncertfile {}\nkeyfile {}\nrequire_certificate true\n\
         allow_anonymous false\npassword_file {}\nlog_dest stderr\nlog_type all\n",
        path("ca.pem"),
        path("own.pem"),
        path("own.key"),
        path("passwords")
    );
    std::fs::write(folder.join("mosquitto.conf"), text).unwrap();
    let mut command = Command::new(program);
    command.arg("-c").arg(folder.join("mosquitto.conf")).stderr(Stdio::piped()).kill_on_drop(true);
    (command.spawn().unwrap(), port)
}

#[tokio::test(flavor = "multi_thread")]
async fn mosquitto_takes_messages_by_tls_with_certificate_and_password() {
    let Some(program) = mosquitto() else {
        let _ =
            writeln!(std::io::stderr(), "skipped: mosquitto is not installed (apt-get install mosquitto)");
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let authority = Authority::new("ours");
    let (mut broker, port) = start_mosquitto(&program, folder.path(), &authority).await;
    let mut lines = BufReader::new(broker.stderr.take().unwrap()).lines();
    let url = format!("mqtts://127.0.0.1:{port}");
    let running = start(settings(&url, authority.client(Some(&authority.sign("bridge"))))).await;
    let driving = running.drive("cart7");
    running.wait_for(|event| *event == BridgeEvent::BrokerReached).await;
    let mut wait_for_line = async |what: &str| {
        let found = async {
            while let Some(line) = lines.next_line().await.unwrap() {
                if line.contains(what) {
                    return;
                }
            }
            panic!("mosquitto ended");
        };
        tokio::time::timeout(Duration::from_secs(20), found).await.expect(what);
    };
    // It acknowledges what is retained, and takes the rest.
    wait_for_line("Sending PUBACK to driftless-acme-cart7").await;
    wait_for_line("Received PUBLISH from driftless-acme-cart7 (d0, q0, r0").await;
    driving.abort();
    running.stop().await;
    wait_for_line("Received DISCONNECT from driftless-acme-cart7").await;

    // Without its password it gets nowhere.
    let tls = authority.client(Some(&authority.sign("bridge")));
    let running = start(BridgeSettings { user: None, ..settings(&url, tls) }).await;
    let _present = running.presence("cart8");
    wait_for_failure(&running, "NotAuthorized").await;
    running.stop().await;
}
