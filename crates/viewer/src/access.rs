//! Who may ask, and the headers of every answer.
//!
//! A page of another origin must not read the map of a robot's building through the browser of somebody who may:
//! browsers keep it from reading answers of other origins, but let it open WebSockets, and a name that it makes point to
//! 127.0.0.1 turns this server into its own origin. So the origin of a WebSocket is that of the page, and hosts are named
//! by their address, or by a name that nobody can register.

use axum::extract::Request;
use axum::http::header::{self, HeaderMap, HeaderName, HeaderValue};
use axum::http::{Method, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use std::net::{Ipv4Addr, Ipv6Addr};

/// `script-src` allows the import map in the page, by its digest.
const CONTENT_SECURITY_POLICY: &str = concat!(
    "default-src 'self'; script-src 'self' '",
    include_str!("../page/import_map.sha256"),
    "'; style-src 'self'; img-src 'self' data:; connect-src 'self'; object-src 'none'; base-uri 'none'; ",
    "form-action 'none'; frame-ancestors 'none'"
);

/// Refuses what is neither a GET of this host nor an image for it, and sets the headers.
pub(crate) async fn guard(request: Request, next: Next) -> Response {
    let mut response = match refusal(request.method(), request.uri().path(), request.headers()) {
        Some(refused) => refused.into_response(),
        None => next.run(request).await,
    };
    let headers = response.headers_mut();
    for (name, value) in [
        (header::CONTENT_SECURITY_POLICY, CONTENT_SECURITY_POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::X_FRAME_OPTIONS, "DENY"),
        (header::REFERRER_POLICY, "no-referrer"),
        (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
        (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
        (header::CACHE_CONTROL, "no-store"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    response
}

fn refusal(method: &Method, path: &str, headers: &HeaderMap) -> Option<(StatusCode, &'static str)> {
    let is_read = method == Method::GET || method == Method::HEAD;
    let is_image = method == Method::POST && takes_images(path);
    if !is_read && !is_image {
        let message = "only GET is answered here, and POST of an image to /api/maps/{map}/localize\n";
        return Some((StatusCode::METHOD_NOT_ALLOWED, message));
    }
    // With two, a proxy before this server may look at the other one.
    let mut hosts = headers.get_all(header::HOST).iter();
    let (Some(host), None) = (hosts.next().and_then(|host| host.to_str().ok()), hosts.next()) else {
        return Some((StatusCode::BAD_REQUEST, "the request names no host, or two\n"));
    };
    if !is_own_host(host) {
        return Some((
            StatusCode::MISDIRECTED_REQUEST,
            "this server answers to its address, to localhost, and to names without a dot or in .local\n",
        ));
    }
    let origin = text(headers, &header::ORIGIN);
    if headers.contains_key(header::ORIGIN) && !origin.is_some_and(|origin| is_origin_of(origin, host)) {
        return Some((StatusCode::FORBIDDEN, "pages of other origins are refused\n"));
    }
    None
}

/// Whether a path is that of a map's search for images.
fn takes_images(path: &str) -> bool {
    path.starts_with("/api/maps/") && path.ends_with("/localize")
}

fn text<'a>(headers: &'a HeaderMap, name: &HeaderName) -> Option<&'a str> {
    headers.get(name)?.to_str().ok()
}

/// Whether nobody outside can make a host's name point here: an address, or a name that no registry gives away. A port may
/// follow, and nothing else.
fn is_own_host(host: &str) -> bool {
    let (name, port) = if let Some(rest) = host.strip_prefix('[') {
        match rest.split_once(']') {
            Some((address, port)) if address.parse::<Ipv6Addr>().is_ok() => (None, port),
            _ => return false,
        }
    } else {
        let at = host.find(':').unwrap_or(host.len());
        (Some(&host[..at]), &host[at..])
    };
    let is_port =
        |port: &str| port.bytes().all(|digit| digit.is_ascii_digit()) && port.parse::<u16>().is_ok();
    (port.is_empty() || port.strip_prefix(':').is_some_and(is_port)) && name.is_none_or(is_own_name)
}

fn is_own_name(name: &str) -> bool {
    let is_name = name.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"-_.".contains(&byte));
    let is_local = || !name.contains('.') || name.to_ascii_lowercase().ends_with(".local");
    !name.is_empty() && is_name && (name.parse::<Ipv4Addr>().is_ok() || is_local())
}

/// Whether a page of an origin comes from a host; a proxy before it may speak https.
fn is_origin_of(origin: &str, host: &str) -> bool {
    let authority = origin.strip_prefix("http://").or_else(|| origin.strip_prefix("https://"));
    authority.is_some_and(|authority| authority.eq_ignore_ascii_case(host))
}

#[cfg(test)]
mod tests {
    use super::{is_origin_of, is_own_host};

    #[test]
    fn hosts_that_can_be_registered_are_foreign() {
        for own in ["127.0.0.1:8080", "[::1]:8080", "localhost", "10.0.0.7", "server:80", "hall.local:8080"] {
            assert!(is_own_host(own), "{own}");
        }
        for foreign in ["", ":80", "evil.example", "127.0.0.1.evil.example:8080", "local.evil.com"] {
            assert!(!is_own_host(foreign), "{foreign}");
        }
        for odd in [
            "localhost:8080:evil.example",
            "localhost:",
            "localhost:80a",
            "localhost:+80",
            "localhost:99999",
            "[::1]evil.example",
            "[::1",
            "[evil.example]:80",
            "[10.0.0.7]",
            "evil.example/localhost",
            "a b",
            "localhost@evil.example",
            "evil.example#",
            "::1",
        ] {
            assert!(!is_own_host(odd), "{odd}");
        }
        assert!(!is_own_host("evil.example."));
    }

    #[test]
    fn an_origin_has_the_host_and_the_port_of_the_page() {
        assert!(is_origin_of("http://localhost:8080", "localhost:8080"));
        for foreign in ["http://localhost:8081", "http://evil.example", "null", "file://", "localhost:8080"] {
            assert!(!is_origin_of(foreign, "localhost:8080"), "{foreign}");
        }
    }
}
