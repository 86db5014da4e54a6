//! ROS names, and the keys of topics.

/// Longest namespace, node name or topic, bytes.
pub const MAX_NAME_BYTES: usize = 255;

/// A name that ROS does not allow.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the ROS {kind} {name:?} is invalid: {reason}")]
pub struct NameError {
    /// What it names.
    pub kind: &'static str,
    /// The name.
    pub name: String,
    /// What is wrong with it.
    pub reason: &'static str,
}

/// Checks one part of a name: letters, digits and `_`, not beginning with a digit.
fn check_part(part: &str) -> Result<(), &'static str> {
    let valid = |character: char| character.is_ascii_alphanumeric() || character == '_';
    match part.chars().next() {
        None => Err("a part of it is empty"),
        Some(first) if first.is_ascii_digit() => Err("a part of it begins with a digit"),
        Some(_) if !part.chars().all(valid) => Err("use letters, digits and '_'"),
        Some(_) => Ok(()),
    }
}

fn check(kind: &'static str, name: &str, parts: &str) -> Result<(), NameError> {
    let checked = if name.len() > MAX_NAME_BYTES {
        Err("it is too long")
    } else {
        parts.split('/').try_for_each(check_part)
    };
    checked.map_err(|reason| NameError { kind, name: name.to_owned(), reason })
}

/// Checks the name of a node.
///
/// # Errors
/// [`NameError`]: see there.
pub fn check_node(name: &str) -> Result<(), NameError> {
    if name.contains('/') {
        return Err(NameError { kind: "node name", name: name.to_owned(), reason: "it holds '/'" });
    }
    check("node name", name, name)
}

/// The absolute namespace, with a `/` before and none after; `/` for the empty one.
///
/// # Errors
/// [`NameError`]: a part is empty, begins with a digit, or holds other characters than letters, digits and `_`.
pub fn absolute_namespace(namespace: &str) -> Result<String, NameError> {
    let parts = namespace.trim_matches('/');
    if !parts.is_empty() {
        check("namespace", namespace, parts)?;
    }
    Ok(format!("/{parts}"))
}

/// The absolute name of a topic: itself where it begins with `/`, else below the namespace.
///
/// # Errors
/// [`NameError`]: as [`absolute_namespace`], and the empty name.
pub fn absolute_topic(namespace: &str, topic: &str) -> Result<String, NameError> {
    let relative = topic.strip_prefix('/');
    check("topic", topic, relative.unwrap_or(topic))?;
    Ok(match relative {
        Some(_) => topic.to_owned(),
        None => format!("{}/{topic}", namespace.trim_end_matches('/')),
    })
}

/// The name of a type in keys, for example `sensor_msgs::msg::dds_::Imu_` for `sensor_msgs/msg/Imu`.
pub fn dds_type(type_name: &str) -> String {
    match type_name.rsplit_once('/') {
        Some((package, message)) => format!("{}::dds_::{message}_", package.replace('/', "::")),
        None => format!("{type_name}_"),
    }
}

/// The key of a topic's messages.
///
/// # Arguments
/// * `topic`: its absolute name.
/// * `type_name`: for example `sensor_msgs/msg/Imu`.
/// * `type_hash`: `RIHS01_...`; `*` for any version of the type.
///
/// ```
/// let key = ros2::names::data_key(0, "/cam0/image_raw", "sensor_msgs/msg/Image", "*");
/// assert_eq!(key, "0/cam0/image_raw/sensor_msgs::msg::dds_::Image_/*");
/// ```
pub fn data_key(domain: u32, topic: &str, type_name: &str, type_hash: &str) -> String {
    format!("{domain}/{}/{}/{type_hash}", topic.trim_matches('/'), dds_type(type_name))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn topics_are_absolute_or_below_the_namespace() {
        let namespace = absolute_namespace("cart7/").unwrap();
        assert_eq!(namespace, "/cart7");
        assert_eq!(absolute_topic(&namespace, "odometry").unwrap(), "/cart7/odometry");
        assert_eq!(absolute_topic(&namespace, "/tf").unwrap(), "/tf");
        assert_eq!(absolute_namespace("/").unwrap(), "/");
        assert_eq!(absolute_topic("/", "a/b").unwrap(), "/a/b");
    }

    #[test]
    fn names_that_would_be_another_key_are_refused() {
        for topic in ["", "/", "a//b", "a/", "7up", "a/**", "a b", "ä", "a/@b", "a%b"] {
            assert!(absolute_topic("/", topic).is_err(), "{topic:?}");
        }
        assert!(absolute_namespace("a/*").is_err());
        assert!(check_node("a/b").is_err() && check_node("cart-7").is_err() && check_node("").is_err());
        assert!(check_node(&"a".repeat(MAX_NAME_BYTES + 1)).is_err());
        assert!(check_node("driftless_7").is_ok());
    }
}
