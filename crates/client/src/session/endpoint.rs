//! Checks of endpoints, before Zenoh sees them.

/// Protocols of this build.
const PROTOCOLS: &[&str] = if cfg!(feature = "tls") { &["tcp", "tls"] } else { &["tcp"] };

/// Why an endpoint cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EndpointError {
    /// It has no protocol or no port.
    #[error("{what} {value:?} is no endpoint: write {suggestion} (protocol/address:port)")]
    Form {
        /// What it is for.
        what: &'static str,
        /// As given.
        value: String,
        /// What was probably meant.
        suggestion: String,
    },
    /// Its protocol is not part of this build.
    #[error("{what} {value:?}: this build has no {protocol:?}, only {}", PROTOCOLS.join(" and "))]
    Protocol {
        /// What it is for.
        what: &'static str,
        /// As given.
        value: String,
        /// Its protocol.
        protocol: String,
    },
}

/// The protocol of an endpoint, which is written before the first slash.
pub(super) fn protocol(endpoint: &str) -> &str {
    endpoint.split('/').next().unwrap_or_default()
}

/// Checks that an endpoint is written as `protocol/address:port`, with a protocol of this build.
pub(super) fn check(what: &'static str, value: &str) -> Result<(), EndpointError> {
    // As in a URL, which many write first.
    let (protocol, locator) = match value.split_once("://") {
        Some((_, locator)) => (None, locator),
        None => value.split_once('/').map_or((None, value), |(protocol, locator)| (Some(protocol), locator)),
    };
    let protocol = protocol.filter(|protocol| !protocol.is_empty());
    if let Some(other) = protocol.filter(|protocol| !PROTOCOLS.contains(protocol)) {
        return Err(EndpointError::Protocol { what, value: value.to_owned(), protocol: other.to_owned() });
    }
    // Metadata and configuration may follow.
    let address = locator.split(['?', '#']).next().unwrap_or_default().trim_end_matches('/');
    let is_port = |port: &str| port.parse::<u16>().is_ok();
    let has_port = address.rsplit_once(':').is_some_and(|(host, port)| !host.is_empty() && is_port(port));
    if protocol.is_some() && has_port {
        return Ok(());
    }
    let host = if has_port { address.to_owned() } else { format!("{}:7447", address.trim_end_matches(':')) };
    let suggestion = format!("{}/{host}", protocol.unwrap_or("tcp"));
    Err(EndpointError::Form { what, value: value.to_owned(), suggestion })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_endpoint_without_protocol_or_port_is_refused_with_the_corrected_one() {
        for (given, suggestion) in [
            ("10.0.0.1:7447", "tcp/10.0.0.1:7447"),
            ("10.0.0.1", "tcp/10.0.0.1:7447"),
            ("tcp/10.0.0.1", "tcp/10.0.0.1:7447"),
            ("tls/robot7", "tls/robot7:7447"),
            ("tcp://robot7:7448", "tcp/robot7:7448"),
            ("http://robot7:7448/", "tcp/robot7:7448"),
            ("/robot7:7448", "tcp/robot7:7448"),
            ("[fe80::1]:7447", "tcp/[fe80::1]:7447"),
            ("localhost:port", "tcp/localhost:port:7447"),
        ] {
            let error = check("the endpoint to connect to", given).unwrap_err().to_string();
            assert!(
                error.contains("connect to") && error.contains(&format!("write {suggestion} ")),
                "{error}"
            );
            assert!(error.contains(given) && !error.contains('{'), "{error}");
        }
    }

    #[test]
    fn a_protocol_that_the_build_lacks_is_refused_by_name() {
        for given in ["quic/10.0.0.1:7447", "unixsock-stream/run/map", "udp/10.0.0.1:7447", "serial/dev/tty"]
        {
            let error = check("the endpoint to listen on", given).unwrap_err().to_string();
            assert!(error.contains(given) && error.contains("only tcp and tls"), "{error}");
        }
    }

    #[test]
    fn endpoints_of_zenoh_pass() {
        for given in ["tcp/127.0.0.1:7447", "tcp/[::1]:0", "tcp/host.local:7447?prio=1-3", "tls/map:7447"] {
            assert!(check("the endpoint to listen on", given).is_ok(), "{given}");
        }
    }
}
