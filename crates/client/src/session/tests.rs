use super::*;

fn mode_of(options: &SessionOptions) -> String {
    options.to_config().unwrap().get_json("mode").unwrap().replace('"', "")
}

fn owned(endpoints: &[&str]) -> Vec<String> {
    endpoints.iter().map(|&endpoint| endpoint.to_owned()).collect()
}

/// A configuration file with some text, and the options that name it.
fn with_file(text: &str) -> (tempfile::TempDir, SessionOptions) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("zenoh.json5");
    std::fs::write(&path, text).unwrap();
    (folder, SessionOptions { config_file: Some(path), ..SessionOptions::default() })
}

#[test]
fn the_mode_follows_from_the_endpoints() {
    let (a, b) = ("tcp/127.0.0.1:7447", "tcp/127.0.0.1:7448");
    for (listen, connect, mode) in [
        (&[][..], &[][..], "peer"),
        (&[a], &[], "peer"),
        (&[], &[a], "client"),
        (&[], &[a, b], "router"),
        (&[a], &[b], "router"),
    ] {
        let mut options =
            SessionOptions { listen: owned(listen), connect: owned(connect), ..SessionOptions::default() };
        assert_eq!(mode_of(&options), mode, "{options:?}");
        options.scout = true;
        assert_eq!(mode_of(&options), "peer", "{options:?}");
        options.mode = Some(SessionMode::Router);
        assert_eq!(mode_of(&options), "router", "{options:?}");
    }
    let nobody = SessionOptions { mode: Some(SessionMode::Client), ..SessionOptions::default() };
    assert!(nobody.to_config().unwrap_err().to_string().contains("--connect"));
}

#[test]
fn a_file_keeps_what_it_says_and_options_override_it() {
    let (_folder, mut options) = with_file(
        "{ mode: 'peer', connect: { endpoints: ['tcp/10.0.0.1:7447'] }, namespace: 'north', // north\n }",
    );
    let get = |options: &SessionOptions, key: &str| options.to_config().unwrap().get_json(key).unwrap();
    assert_eq!(mode_of(&options), "peer");
    assert!(get(&options, "connect/endpoints").contains("10.0.0.1"));
    assert_eq!(get(&options, "namespace"), "\"north\"");
    assert_eq!(get(&options, "scouting/multicast/enabled"), "false", "multicast only if asked for");
    options.connect = owned(&["tcp/10.0.0.2:7447"]);
    options.namespace = Some("south".to_owned());
    assert!(get(&options, "connect/endpoints").contains("10.0.0.2"));
    assert!(!get(&options, "connect/endpoints").contains("10.0.0.1"));
    assert_eq!(get(&options, "namespace"), "\"south\"");

    let (_folder, options) = with_file("{ connect: { endpoints: ['tcp/10.0.0.1:7447'] } }");
    assert_eq!(mode_of(&options), "client");
    let (_folder, options) = with_file("{ scouting: { multicast: { enabled: true } } }");
    assert_eq!(get(&options, "scouting/multicast/enabled"), "true");
}

#[test]
fn what_this_build_would_ignore_is_refused_in_words() {
    for (text, words) in [
        ("{ transport: { auth: { pubkey: { key_size: 2048 } } } }", "certificates (TLS)"),
        ("{ transport: { shared_memory: { enabled: true } } }", "no shared memory"),
        ("{ transport: { unicast: { compression: { enabled: true } } } }", "no compression"),
        ("{ transport: { unicast: { max_links: 2 } } }", "max_links"),
        ("{ plugins: { rest: { http_port: 8000 } } }", "zenohd"),
        ("{ access_control: { enabled: false, default_permission: 'deny', rules: [] } }", "protects nothing"),
        ("{ listen: { endpoints: ['quic/0.0.0.0:7447'] } }", "only tcp and tls"),
        ("{ connect: { endpoints: { client: ['ws/10.0.0.1:7447'] } } }", "only tcp and tls"),
        (
            "{ connect: { endpoints: [{ strategy: 'allOf', locators: ['udp/10.0.0.1:7447'] }] } }",
            "only tcp and tls",
        ),
        ("{ trnsport: {} }", "trnsport"),
        ("{ transport: { auth: { usrpwd: { usr: 'ann' } } } }", "usr"),
        ("{ transport: { link: { tls: { root_ca_certificate: '/no/such.pem' } } } }", "/no/such.pem"),
        ("{ mode: 'client' }", "--connect"),
        ("{ mode: ", "not JSON5"),
    ] {
        let (_folder, options) = with_file(text);
        let error = options.to_config().expect_err(text).to_string();
        assert!(error.contains(words), "{text}: {error}");
    }
    let missing = SessionOptions { config_file: Some("/no/such.json5".into()), ..SessionOptions::default() };
    assert!(missing.to_config().unwrap_err().to_string().contains("/no/such.json5"));
    for namespace in ["", "a//b", "a/*", "@a"] {
        let options = SessionOptions { namespace: Some(namespace.to_owned()), ..SessionOptions::default() };
        assert!(options.to_config().unwrap_err().to_string().contains("namespace"), "{namespace}");
    }
}

#[test]
fn a_damaged_file_is_refused_without_quoting_its_password() {
    let (_folder, options) =
        with_file("{ transport: { auth: { usrpwd: { user: 'r1', password: 'rosebud' x } } } }");
    let error = options.to_config().unwrap_err().to_string();
    assert!(error.contains("line 1") && !error.contains("rosebud"), "{error}");
}
