//! Names of vehicles, and the topics in which they occur.

use thiserror::Error;

/// Name of the interface that the standard suggests.
pub const INTERFACE: &str = "uagv";
/// The level of the version in topics.
const MAJOR_VERSION: &str = "v2";

/// A name that cannot be a level of a topic.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum NameError {
    /// A serial number with a character that VDA 5050 does not allow.
    #[error(
        "{0:?} cannot be a serial number: VDA 5050 allows A-Z, a-z, 0-9, '_', '.', ':' and '-'; give the robot another one \
         (--robot NAME=SERIAL)"
    )]
    Serial(String),
    /// A level that is empty or holds a character with a meaning in topics.
    #[error(
        "{0:?} cannot be a level of an MQTT topic: it must not be empty, nor hold '/', '+', '#', '$' or control characters"
    )]
    Level(String),
}

/// The topics of one vehicle.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Topics {
    /// Of [`Visualization`](crate::Visualization), quality of service 0.
    pub visualization: String,
    /// Of [`Connection`](crate::Connection), quality of service 1, retained.
    pub connection: String,
}

impl Topics {
    /// The topics of a vehicle: `interface/v2/manufacturer/serial/topic`.
    ///
    /// # Errors
    /// [`NameError`] names the level that is wrong.
    ///
    /// ```
    /// let topics = vda5050::Topics::new("uagv", "acme", "0001")?;
    /// assert_eq!(topics.visualization, "uagv/v2/acme/0001/visualization");
    /// # Ok::<(), vda5050::NameError>(())
    /// ```
    pub fn new(interface: &str, manufacturer: &str, serial: &str) -> Result<Self, NameError> {
        check_level(interface)?;
        check_level(manufacturer)?;
        check_serial(serial)?;
        let topic = |last: &str| format!("{interface}/{MAJOR_VERSION}/{manufacturer}/{serial}/{last}");
        Ok(Self { visualization: topic("visualization"), connection: topic("connection") })
    }
}

/// Checks that a name can be a level of a topic.
///
/// # Errors
/// [`NameError::Level`].
pub fn check_level(level: &str) -> Result<(), NameError> {
    let is_forbidden = |character: char| matches!(character, '/' | '+' | '#' | '$') || character.is_control();
    if level.is_empty() || level.contains(is_forbidden) {
        return Err(NameError::Level(level.to_owned()));
    }
    Ok(())
}

/// Checks that a name can be a serial number.
///
/// # Errors
/// [`NameError::Serial`].
pub fn check_serial(serial: &str) -> Result<(), NameError> {
    let is_allowed = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'_' | b'.' | b':' | b'-');
    if serial.is_empty() || !serial.bytes().all(is_allowed) {
        return Err(NameError::Serial(serial.to_owned()));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_would_change_the_topic_are_refused() {
        for serial in ["", "a/b", "+", "robot#1", "käfer", "a b"] {
            assert_eq!(check_serial(serial), Err(NameError::Serial(serial.to_owned())));
        }
        for level in ["", "a/b", "+", "#", "$share", "a\n"] {
            assert!(Topics::new("uagv", level, "1").is_err(), "{level:?}");
            assert!(Topics::new(level, "acme", "1").is_err(), "{level:?}");
        }
        assert!(Topics::new("uagv", "Acme & Söhne", "A-1.b:c_2").is_ok());
    }
}
