//! What a fleet consists of, kept beside its authority.

use super::error::FleetError;
use super::{ROUTER, member_config};
use client::session::{Member, Role, check_namespace};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// File that describes the fleet.
pub(super) const FILE: &str = "fleet.json";

/// What a new fleet consists of.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FleetOptions {
    /// Name or IP address of the machine that the others connect to: the router's, or the only server's.
    pub address: String,
    /// Its port.
    pub port: u16,
    /// Names of the map servers.
    pub servers: Vec<String>,
    /// Names of the robots.
    pub robots: Vec<String>,
    /// Names of those who watch and query.
    pub operators: Vec<String>,
    /// Whether the others meet at a router; with several servers always.
    pub router: bool,
    /// The only maps that may be queried; empty: all.
    pub maps: Vec<String>,
    /// Prefix of all keys.
    pub namespace: Option<String>,
}

impl FleetOptions {
    /// No members yet, and port 7447.
    pub fn new(address: &str) -> Self {
        Self {
            address: address.to_owned(),
            port: 7447,
            servers: Vec::new(),
            robots: Vec::new(),
            operators: Vec::new(),
            router: false,
            maps: Vec::new(),
            namespace: None,
        }
    }
}

/// The members of a fleet, and how they meet.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FleetState {
    pub(super) address: String,
    pub(super) port: u16,
    pub(super) maps: Vec<String>,
    pub(super) namespace: Option<String>,
    /// The hub first.
    members: Vec<Member>,
}

impl FleetState {
    pub(super) fn new(options: FleetOptions) -> Result<Self, FleetError> {
        let FleetOptions { address, port, servers, robots, operators, router, maps, namespace } = options;
        if address.is_empty() || address.contains(['/', ' ', '[', ']']) || is_name_with_port(&address) {
            return Err(FleetError::Address { address });
        }
        if servers.is_empty() {
            return Err(FleetError::NoServer);
        }
        maps.iter().try_for_each(|map| protocol::keys::validate_name(map))?;
        namespace.iter().try_for_each(|namespace| check_namespace(namespace))?;
        let mut state = Self { address, port, maps, namespace, members: Vec::new() };
        if router || servers.len() > 1 {
            state.members.push(Member { name: ROUTER.to_owned(), role: Role::Router });
        }
        for (role, names) in [(Role::MapServer, servers), (Role::Robot, robots), (Role::Operator, operators)]
        {
            for name in names {
                state.add(Member { name, role })?;
            }
        }
        Ok(state)
    }

    pub(super) fn add(&mut self, member: Member) -> Result<(), FleetError> {
        protocol::keys::validate_name(&member.name)?;
        if [super::AUTHORITY, ROUTER, ".", ".."].contains(&member.name.as_str()) {
            return Err(FleetError::ReservedName { name: member.name });
        }
        if self.members.iter().any(|other| other.name == member.name) {
            return Err(FleetError::TwoOfOneName { name: member.name });
        }
        if member.role == Role::MapServer
            && self.members.first().is_some_and(|hub| hub.role == Role::MapServer)
        {
            return Err(FleetError::NoRouter);
        }
        self.members.push(member);
        Ok(())
    }

    pub(super) fn read(folder: &Path) -> Result<Self, FleetError> {
        let path = folder.join(FILE);
        let failed = |problem: String| FleetError::NoFleet { path: path.clone(), problem };
        let text = ::files::read_to_string(&path).map_err(|error| failed(error.to_string()))?;
        let state: Self = serde_json::from_str(&text).map_err(|error| failed(error.to_string()))?;
        if state.members.is_empty() {
            return Err(failed("it has no members".to_owned()));
        }
        Ok(state)
    }

    pub(super) fn to_json(&self) -> String {
        format!("{:#}\n", serde_json::json!(self))
    }

    pub(super) fn config_of(&self, member: &Member) -> String {
        member_config::text(self, member)
    }

    /// All members, the hub first.
    pub fn members(&self) -> &[Member] {
        &self.members
    }

    /// The member that the others connect to.
    pub fn hub(&self) -> &Member {
        &self.members[0]
    }

    /// Under what the hub's certificate is valid.
    pub(super) fn addresses(&self) -> Vec<String> {
        let mut addresses = vec![self.address.clone(), "localhost".to_owned(), "127.0.0.1".to_owned()];
        addresses.dedup();
        addresses
    }
}

/// Whether a port follows; an IPv6 address has several colons.
fn is_name_with_port(address: &str) -> bool {
    address.matches(':').count() == 1
}
