//! The address of an MQTT broker.

use std::fmt;
use std::str::FromStr;
use thiserror::Error;

/// Port of MQTT without TLS.
const PORT: u16 = 1883;
/// Port of MQTT with TLS.
const TLS_PORT: u16 = 8883;

/// An address that cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum BrokerAddressError {
    /// WebSockets are wanted.
    #[error(
        "{0}: MQTT over WebSockets is not supported; give mqtt://HOST:PORT, or mqtts://HOST:PORT with TLS"
    )]
    WebSocket(String),
    /// User or password are in the address, where every process could read them.
    #[error("the address of the broker holds a user; give it with --broker-user and --broker-password-file")]
    User,
    /// Anything else.
    #[error(
        "{0:?} is no address of a broker; give mqtt://HOST:PORT, for example mqtt://127.0.0.1:1883, or mqtts://HOST:PORT with TLS"
    )]
    Malformed(String),
}

/// Host and port of an MQTT broker, and whether it is reached by TLS.
///
/// ```
/// let broker: vda5050::BrokerAddress = "mqtt://broker.local".parse()?;
/// assert_eq!(broker.to_string(), "mqtt://broker.local:1883");
/// let broker: vda5050::BrokerAddress = "mqtts://broker.local".parse()?;
/// assert_eq!((broker.has_tls, broker.port), (true, 8883));
/// # Ok::<(), vda5050::BrokerAddressError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BrokerAddress {
    /// Name or address of the host, an IPv6 address without brackets.
    pub host: String,
    /// TCP port.
    pub port: u16,
    /// By TLS: `mqtts://`.
    pub has_tls: bool,
}

impl FromStr for BrokerAddress {
    type Err = BrokerAddressError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let malformed = || BrokerAddressError::Malformed(text.to_owned());
        let (scheme, place) = text.split_once("://").ok_or_else(malformed)?;
        let has_tls = match scheme {
            "mqtt" | "tcp" => false,
            "mqtts" | "ssl" => true,
            "ws" | "wss" => return Err(BrokerAddressError::WebSocket(text.to_owned())),
            _ => return Err(malformed()),
        };
        let place = place.trim_end_matches('/');
        if place.contains('@') {
            return Err(BrokerAddressError::User);
        }
        let (host, port) = match place.strip_prefix('[') {
            Some(rest) => {
                let (host, after) = rest.split_once(']').ok_or_else(malformed)?;
                (host, after.strip_prefix(':').or(after.is_empty().then_some("")).ok_or_else(malformed)?)
            }
            None => place.split_once(':').unwrap_or((place, "")),
        };
        let usual = if has_tls { TLS_PORT } else { PORT };
        let port = if port.is_empty() { usual } else { port.parse().map_err(|_| malformed())? };
        let is_host = !host.is_empty() && !host.contains(|c: char| c == '/' || c.is_whitespace());
        if is_host && port > 0 { Ok(Self { host: host.to_owned(), port, has_tls }) } else { Err(malformed()) }
    }
}

impl fmt::Display for BrokerAddress {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { host, port, has_tls } = self;
        let scheme = if *has_tls { "mqtts" } else { "mqtt" };
        if host.contains(':') {
            write!(formatter, "{scheme}://[{host}]:{port}")
        } else {
            write!(formatter, "{scheme}://{host}:{port}")
        }
    }
}

/// A user of a broker.
#[derive(Clone, PartialEq, Eq)]
pub struct BrokerUser {
    /// Name.
    pub name: String,
    /// Password.
    pub password: String,
}

impl fmt::Debug for BrokerUser {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.debug_struct("BrokerUser").field("name", &self.name).finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_read_and_what_is_wrong_is_named() {
        let read = |text: &str| text.parse::<BrokerAddress>().map(|address| address.to_string());
        for (text, expected) in [
            ("mqtt://10.0.0.2:1884", "mqtt://10.0.0.2:1884"),
            ("tcp://broker/", "mqtt://broker:1883"),
            ("mqtt://[::1]:1884", "mqtt://[::1]:1884"),
            ("mqtt://[::1]", "mqtt://[::1]:1883"),
            ("mqtts://broker", "mqtts://broker:8883"),
            ("ssl://broker:1", "mqtts://broker:1"),
        ] {
            assert_eq!(read(text).unwrap(), expected);
        }
        for text in ["", "broker:1883", "mqtt://", "mqtt://a:b", "mqtt://a:0", "mqtt://a b", "mqtt://[::1]x"]
        {
            assert!(matches!(read(text), Err(BrokerAddressError::Malformed(_))), "{text}");
        }
        for text in ["ws://broker", "wss://broker/mqtt"] {
            assert!(matches!(read(text), Err(BrokerAddressError::WebSocket(_))), "{text}");
        }
        let error = read("mqtt://me:secret@broker").unwrap_err();
        assert_eq!(error, BrokerAddressError::User);
        assert!(!error.to_string().contains("secret"));
    }

    #[test]
    fn a_password_is_not_printed() {
        let user = BrokerUser { name: "me".to_owned(), password: "secret".to_owned() };
        assert!(!format!("{user:?}").contains("secret"));
    }
}
