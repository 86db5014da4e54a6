//! The Zenoh configuration of a member.

use super::state::FleetState;
use super::{CA, CERTIFICATE, KEY, access};
use client::session::{CONFIG_FILE, Member, Role};
use serde_json::{Value, json};

/// The configuration, with file names relative to the member's folder.
pub(super) fn text(fleet: &FleetState, member: &Member) -> String {
    let Member { name, role } = member;
    let role = role.words();
    format!(
        "// Zenoh configuration of {role} {name}, written by `driftless fleet`.\n\
         // Programs of Driftless take its folder: --secure DIR. For zenohd: cd DIR && zenohd -c {CONFIG_FILE}\n\
         {:#}\n",
        settings(fleet, member)
    )
}

fn settings(fleet: &FleetState, member: &Member) -> Value {
    let is_hub = member == fleet.hub();
    let mode = match (is_hub, member.role) {
        (true, Role::Router) => "router",
        (true, _) => "peer",
        (false, _) => "client",
    };
    let (listen, connect) =
        if is_hub { (vec![listening(fleet)], vec![]) } else { (vec![], vec![hub(fleet)]) };
    let mut tls = json!({
        "root_ca_certificate": CA,
        "enable_mtls": true,
        "connect_certificate": CERTIFICATE,
        "connect_private_key": KEY,
        "verify_name_on_connect": true,
        "close_link_on_expiration": true,
    });
    if is_hub {
        tls["listen_certificate"] = json!(CERTIFICATE);
        tls["listen_private_key"] = json!(KEY);
    }
    let mut settings = json!({
        "mode": mode,
        "metadata": { "driftless": member },
        "listen": { "endpoints": listen },
        "connect": { "endpoints": connect },
        "scouting": { "multicast": { "enabled": false }, "gossip": { "enabled": false } },
        "transport": { "link": { "protocols": ["tls"], "tls": tls } },
        "access_control": access::control(fleet, member),
    });
    // A router has no keys of its own.
    if let Some(namespace) = fleet.namespace.as_ref().filter(|_| member.role != Role::Router) {
        settings["namespace"] = json!(namespace);
    }
    settings
}

/// What the others connect to.
fn hub(fleet: &FleetState) -> String {
    format!("tls/{}:{}", bracketed(&fleet.address), fleet.port)
}

/// All interfaces, or the loopback where the address is there.
fn listening(fleet: &FleetState) -> String {
    let address = match fleet.address.as_str() {
        "localhost" => "127.0.0.1".to_owned(),
        local if local.starts_with("127.") => local.to_owned(),
        ipv6 if ipv6.contains(':') => "[::]".to_owned(),
        _ => "0.0.0.0".to_owned(),
    };
    format!("tls/{address}:{}", fleet.port)
}

fn bracketed(address: &str) -> String {
    if address.contains(':') { format!("[{address}]") } else { address.to_owned() }
}
