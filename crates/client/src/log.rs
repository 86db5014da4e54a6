//! What of Zenoh's log is for nobody's eyes.

use tracing_subscriber::EnvFilter;

/// Where Zenoh prints the whole configuration at its level debug, passwords included.
const TARGET: &str = "zenoh::api::session";
/// What of it may be logged.
const CONFIGURATION: &str = "zenoh::api::session=info";

/// Keeps secrets out of the log, whatever else the filter asks for. A filter that shows less there stays as it is.
///
/// ```
/// use tracing_subscriber::EnvFilter;
///
/// let filter = client::without_secrets(EnvFilter::new("debug"));
/// assert!(filter.to_string().contains("zenoh::api::session=info"));
/// let quiet = client::without_secrets(EnvFilter::new("info,zenoh=error"));
/// assert!(!quiet.to_string().contains("zenoh::api::session"));
/// ```
pub fn without_secrets(filter: EnvFilter) -> EnvFilter {
    if !shows_secrets(&filter.to_string()) {
        return filter;
    }
    match CONFIGURATION.parse() {
        Ok(directive) => filter.add_directive(directive),
        Err(_) => filter,
    }
}

/// Whether the directive that holds for the target shows more than its level info. One that is not understood may.
fn shows_secrets(directives: &str) -> bool {
    let mut closest: Option<(usize, &str)> = None;
    for directive in directives.split(',').map(str::trim).filter(|directive| !directive.is_empty()) {
        let (target, level) = match directive.rsplit_once('=') {
            Some((target, level)) => (target, level),
            None if directive.contains("::") => (directive, "trace"),
            None => ("", directive),
        };
        if target.contains('[') {
            return true;
        }
        let holds = target.is_empty() || TARGET == target || TARGET.starts_with(&format!("{target}::"));
        if holds && closest.is_none_or(|(length, _)| target.len() >= length) {
            closest = Some((target.len(), level));
        }
    }
    let quiet = ["off", "error", "warn", "info"];
    closest.is_some_and(|(_, level)| !quiet.iter().any(|name| level.eq_ignore_ascii_case(name)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_filter_that_would_show_the_configuration_is_changed() {
        for (filter, expected) in [
            ("debug", true),
            ("trace,zenoh::api=debug", true),
            ("zenoh", true),
            ("warn,zenoh::api::session=trace", true),
            ("warn,zenoh=error,zenoh::net::runtime::orchestrator=warn", false),
            ("info", false),
            ("debug,zenoh=error", false),
            ("onboard=debug", false),
        ] {
            let changed = without_secrets(EnvFilter::new(filter));
            let raised = changed.to_string().contains("zenoh::api::session=info");
            assert_eq!(raised, expected, "{filter}: {changed}");
        }
    }
}
