//! What of Zenoh's log is for nobody's eyes.

use tracing_subscriber::EnvFilter;

/// At its level debug, Zenoh prints the whole configuration here, passwords included.
const CONFIGURATION: &str = "zenoh::api::session=info";

/// Keeps secrets out of the log, whatever else the filter asks for.
///
/// ```
/// let filter = client::without_secrets(tracing_subscriber::EnvFilter::new("debug"));
/// assert!(filter.to_string().contains("zenoh::api::session=info"));
/// ```
pub fn without_secrets(filter: EnvFilter) -> EnvFilter {
    match CONFIGURATION.parse() {
        Ok(directive) => filter.add_directive(directive),
        Err(_) => filter,
    }
}
