//! A fleet whose members know each other: a private authority, a certificate for each member, and Zenoh configurations
//! that let each role do what it is for.
//!
//! ```text
//! DIR/authority/    ca.pem, ca-key.pem (secret), fleet.json
//! DIR/{member}/     zenoh.json5, ca.pem, certificate.pem, key.pem (secret): what the member's machine needs, and no more
//! ```
//! All others connect to one member, the hub: a router, or the only map server. Encryption and proof of identity are
//! TLS with certificates on both sides; who may do what is Zenoh's access control, by the common name of the
//! certificate ([`access`]). The hub checks all that comes in; the others check what comes from the hub.

pub mod access;
mod authority;
mod error;
mod files;
mod member_config;
mod state;

pub use authority::{Authority, Validity};
pub use error::FleetError;
pub use state::{FleetOptions, FleetState};

use client::session::{CONFIG_FILE, Member, Role};
use std::path::{Path, PathBuf};

/// Folder of the authority, and a name that no member can have.
const AUTHORITY: &str = "authority";
/// Name of the router.
pub const ROUTER: &str = "router";
const CA: &str = "ca.pem";
const CA_KEY: &str = "ca-key.pem";
const CERTIFICATE: &str = "certificate.pem";
const KEY: &str = "key.pem";

/// A fleet on disk.
///
/// # Example
/// ```
/// use tools::fleet::{Fleet, FleetOptions, Validity};
///
/// let folder = tempfile::tempdir()?;
/// let mut options = FleetOptions::new("10.0.0.1");
/// options.servers = vec!["s1".into()];
/// options.robots = vec!["r1".into(), "r2".into()];
/// let mut fleet = Fleet::init(&folder.path().join("fleet"), options, Validity::default())?;
/// assert_eq!(fleet.hub().name, "s1");
/// let r3 = fleet.add(client::session::Role::Robot, "r3", Validity::default())?;
/// assert!(r3.join("key.pem").is_file());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Fleet {
    folder: PathBuf,
    state: FleetState,
    authority: Authority,
}

impl Fleet {
    /// Writes a new fleet.
    ///
    /// # Errors
    /// [`FleetError`]: a folder that exists already, names that are impossible or given twice, no map server.
    pub fn init(folder: &Path, options: FleetOptions, validity: Validity) -> Result<Self, FleetError> {
        let state = FleetState::new(options)?;
        if folder.exists() {
            return Err(FleetError::Exists { path: folder.to_owned() });
        }
        let (authority, ca_key) = Authority::new()?;
        let mut fleet = Self { folder: folder.to_owned(), state, authority };
        let write = |inside: &Path| {
            let place = inside.join(AUTHORITY);
            files::create_folder(&place, |place| {
                files::write_secret(&place.join(CA_KEY), &ca_key)?;
                files::write(&place.join(CA), fleet.authority.certificate())
            })?;
            inside.clone_into(&mut fleet.folder);
            fleet.write_state()?;
            fleet.state.members().iter().try_for_each(|member| fleet.write_member(member, validity))
        };
        files::create_folder(folder, write)?;
        folder.clone_into(&mut fleet.folder);
        Ok(fleet)
    }

    /// Reads a fleet that [`Fleet::init`] wrote.
    ///
    /// # Errors
    /// [`FleetError`]: a folder that holds none.
    pub fn open(folder: &Path) -> Result<Self, FleetError> {
        let place = folder.join(AUTHORITY);
        let state = FleetState::read(&place)?;
        let authority = Authority::read(&files::read(&place.join(CA))?, &files::read(&place.join(CA_KEY))?)?;
        Ok(Self { folder: folder.to_owned(), state, authority })
    }

    /// All members.
    pub fn members(&self) -> &[Member] {
        self.state.members()
    }

    /// The member that the others connect to.
    pub fn hub(&self) -> &Member {
        self.state.hub()
    }

    /// Folder of a member.
    pub fn folder_of(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// Adds a member, and lets the hub know it: the hub's new configuration must be copied to its machine.
    ///
    /// # Returns
    /// The new member's folder.
    ///
    /// # Errors
    /// [`FleetError`]: a name that is impossible or taken, a second server without a router.
    pub fn add(&mut self, role: Role, name: &str, validity: Validity) -> Result<PathBuf, FleetError> {
        let member = Member { name: name.to_owned(), role };
        self.state.add(member.clone())?;
        self.remove_left_behind(&member)?;
        self.write_member(&member, validity)?;
        // Before the fleet has the member: an addition that is stopped here is made again, one that is done is not.
        let hub = self.hub();
        self.write_config(hub, &self.folder_of(&hub.name))?;
        self.write_state()?;
        Ok(self.folder_of(name))
    }

    /// Makes a new key and certificate for one member, or for all, and writes its configuration as the fleet is now.
    /// The former certificates stay valid until they expire.
    ///
    /// # Returns
    /// The members' folders.
    ///
    /// # Errors
    /// [`FleetError`]: an unknown name, a folder that is gone.
    pub fn renew(&self, name: Option<&str>, validity: Validity) -> Result<Vec<PathBuf>, FleetError> {
        let mut renewed = Vec::new();
        let known = self.members().iter().filter(|member| name.is_none_or(|name| name == member.name));
        for member in known {
            let folder = self.folder_of(&member.name);
            let (certificate, key) = self.issue(member, validity)?;
            files::write_secret(&folder.join(KEY), &key)?;
            files::write(&folder.join(CERTIFICATE), &certificate)?;
            self.write_config(member, &folder)?;
            renewed.push(folder);
        }
        match name.filter(|_| renewed.is_empty()) {
            Some(name) => Err(FleetError::UnknownMember { name: name.to_owned() }),
            None => Ok(renewed),
        }
    }

    fn issue(&self, member: &Member, validity: Validity) -> Result<(String, String), FleetError> {
        let listens = member == self.hub();
        let addresses = if listens { self.state.addresses() } else { Vec::new() };
        self.authority.issue(&access::common_name(member), addresses, validity)
    }

    fn write_member(&self, member: &Member, validity: Validity) -> Result<(), FleetError> {
        let folder = self.folder_of(&member.name);
        if folder.exists() {
            return Err(FleetError::Exists { path: folder });
        }
        let (certificate, key) = self.issue(member, validity)?;
        files::create_folder(&folder, |folder| {
            files::write_secret(&folder.join(KEY), &key)?;
            files::write(&folder.join(CERTIFICATE), &certificate)?;
            files::write(&folder.join(CA), self.authority.certificate())?;
            self.write_config(member, folder)
        })
    }

    /// Writes the configuration of a member into its folder.
    fn write_config(&self, member: &Member, folder: &Path) -> Result<(), FleetError> {
        files::write(&folder.join(CONFIG_FILE), &self.state.config_of(member))
    }

    /// Removes the folder of a member that is not one: of an addition that was stopped.
    fn remove_left_behind(&self, member: &Member) -> Result<(), FleetError> {
        let folder = self.folder_of(&member.name);
        let is_member = [KEY, CERTIFICATE, CA, CONFIG_FILE].iter().all(|file| folder.join(file).is_file());
        if is_member { files::remove_folder(&folder) } else { Ok(()) }
    }

    fn write_state(&self) -> Result<(), FleetError> {
        files::write(&self.folder.join(AUTHORITY).join(state::FILE), &self.state.to_json())
    }
}
