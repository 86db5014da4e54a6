//! The address of an MQTT broker.

use std::fmt;
use std::str::FromStr;
use thiserror::Error;

/// Port of MQTT without TLS.
const PORT: u16 = 1883;

/// An address that cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum BrokerAddressError {
    /// TLS is wanted.
    #[error(
        "{0}: TLS is not supported; connect to a broker on this machine, and let it bridge to the other one"
    )]
    Tls(String),
    /// User or password are in the address, where every process could read them.
    #[error("the address of the broker holds a user; give it with --broker-user and --broker-password-file")]
    User,
    /// Anything else.
    #[error("{0:?} is no address of a broker; give mqtt://HOST:PORT, for example mqtt://127.0.0.1:1883")]
    Malformed(String),
}

/// Host and port of an MQTT broker, without TLS.
///
/// ```
/// let broker: vda5050::BrokerAddress = "mqtt://broker.local".parse()?;
/// assert_eq!(broker.to_string(), "mqtt://broker.local:1883");
/// # Ok::<(), vda5050::BrokerAddressError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BrokerAddress {
    /// Name or address of the host, an IPv6 address without brackets.
    pub host: String,
    /// TCP port.
    pub port: u16,
}

impl FromStr for BrokerAddress {
    type Err = BrokerAddressError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let malformed = || BrokerAddressError::Malformed(text.to_owned());
        if ["mqtts://", "ssl://", "wss://"].iter().any(|scheme| text.starts_with(scheme)) {
            return Err(BrokerAddressError::Tls(text.to_owned()));
        }
        let place =
            text.strip_prefix("mqtt://").or_else(|| text.strip_prefix("tcp://")).ok_or_else(malformed)?;
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
        let port = if port.is_empty() { PORT } else { port.parse().map_err(|_| malformed())? };
        let is_host = !host.is_empty() && !host.contains(|c: char| c == '/' || c.is_whitespace());
        if is_host && port > 0 { Ok(Self { host: host.to_owned(), port }) } else { Err(malformed()) }
    }
}

impl fmt::Display for BrokerAddress {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { host, port } = self;
        if host.contains(':') {
            write!(formatter, "mqtt://[{host}]:{port}")
        } else {
            write!(formatter, "mqtt://{host}:{port}")
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
        ] {
            assert_eq!(read(text).unwrap(), expected);
        }
        for text in ["", "broker:1883", "mqtt://", "mqtt://a:b", "mqtt://a:0", "mqtt://a b", "mqtt://[::1]x"]
        {
            assert!(matches!(read(text), Err(BrokerAddressError::Malformed(_))), "{text}");
        }
        assert!(matches!(read("mqtts://broker"), Err(BrokerAddressError::Tls(_))));
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
