//! The inbox: a folder that sessions are handed in to, part by part, with limits.
//!
//! ```text
//! DIR/ROBOT/DIGEST_TOTAL.part    what has been received of a file: its bytes from the beginning on
//! DIR/ROBOT/DIGEST_TOTAL.check   a file that has been received and is being checked
//! DIR/ROBOT/DIGEST.session       a file that is complete: digest, signature, form and robot were checked
//! ```
//! Whatever stops the program, a file is one of these. A part that is sent again changes nothing. A file whose check ended the program
//! is removed at the next start, since it could end it again; its robot hands it in from the beginning, as it does a file that it began and
//! did not go on with for a week.

use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::fs::{File, TryLockError};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use protocol::{SessionPart, Validate as _, keys};
use sha2::{Digest as _, Sha256};
use signing::{PublicKey, PublicKeyError};

use crate::error::HandInError;
use crate::reading::Session;
use crate::signature::verify;

/// The file that says that a program uses the inbox.
const LOCK: &str = ".lock";
/// How the name of a complete session ends.
const COMPLETE: &str = "session";
/// How the name of an incomplete one ends.
const INCOMPLETE: &str = "part";
/// How the name of one ends that is being checked.
const CHECKED: &str = "check";
/// Files that a robot may have begun to hand in; of more the one is removed that has waited longest.
const MOST_INCOMPLETE: usize = 4;
/// A file that a robot did not go on with for so long is removed when another one is begun.
const ABANDONED: Duration = Duration::from_hours(7 * 24);

/// Settings of an inbox.
#[derive(Clone, Debug)]
pub struct InboxSettings {
    /// The folder.
    pub folder: PathBuf,
    /// Bytes that a robot may have there.
    pub bytes_of_robot: u64,
    /// Bytes that all robots together may have there.
    pub bytes_in_all: u64,
    /// Folder with the public key `ROBOT.pub` of each robot: only sessions that are signed with it are taken. `None` takes all.
    pub keys: Option<PathBuf>,
}

/// What an inbox has of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Received {
    /// Bytes of it, from the beginning on.
    pub bytes: u64,
    /// It is complete and on the disk.
    pub is_complete: bool,
}

/// Why a part is not taken.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum InboxError {
    /// The disk of the inbox fails, or is full.
    #[error("the inbox: {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The error.
        source: std::io::Error,
    },
    /// Another program uses it.
    #[error("the inbox {} is used by another program: hand in to that server, or stop it first", folder.display())]
    InUse {
        /// Its folder.
        folder: PathBuf,
    },
    /// A robot or a part that cannot be.
    #[error("{0}")]
    Invalid(String),
    /// There is no room.
    #[error(
        "{whose} sessions in the inbox have {used} bytes with this one{}, and may have {most}: extend the map by some and delete them, or raise {switch}",
        describe(*unfinished)
    )]
    Full {
        /// Whose.
        whose: &'static str,
        /// What they have, with this one.
        used: u64,
        /// What is kept of it for files that have begun to come in.
        unfinished: u64,
        /// What they may have.
        most: u64,
        /// The setting.
        switch: &'static str,
    },
    /// The file is no session, or not signed by its robot.
    #[error("refused: {0}")]
    Session(#[from] HandInError),
    /// The session is another robot's.
    #[error("refused: the session was recorded by {recorded_by:?}, and {robot:?} hands it in")]
    OtherRobot {
        /// Who recorded it.
        recorded_by: String,
        /// Who hands it in.
        robot: String,
    },
    /// There is no key of the robot.
    #[error(
        "refused: this inbox takes signed sessions only, and the key of {robot:?} cannot be read: {source}"
    )]
    Key {
        /// The robot.
        robot: String,
        /// Why.
        source: PublicKeyError,
    },
}

/// A folder that sessions are handed in to. One program may use it at a time.
#[derive(Debug)]
pub struct Inbox {
    settings: InboxSettings,
    /// Held as long as this value lives, and by no other program.
    _lock: File,
}

impl Inbox {
    /// Opens an inbox, whose folder is made where it is missing, and removes the files whose check ended the program.
    ///
    /// # Errors
    /// [`InboxError::Io`], [`InboxError::InUse`].
    pub fn open(settings: InboxSettings) -> Result<Self, InboxError> {
        let folder = &settings.folder;
        let of_folder = |source| InboxError::Io { path: folder.clone(), source };
        std::fs::create_dir_all(folder).map_err(of_folder)?;
        let lock = File::create(folder.join(LOCK)).map_err(of_folder)?;
        match lock.try_lock() {
            Ok(()) => {
                remove_checked(folder)?;
                Ok(Self { settings, _lock: lock })
            }
            Err(TryLockError::WouldBlock) => Err(InboxError::InUse { folder: folder.clone() }),
            Err(TryLockError::Error(source)) => Err(of_folder(source)),
        }
    }

    /// Takes a part of a file.
    ///
    /// # Returns
    /// What the inbox has now: a part that does not begin there is not taken.
    ///
    /// # Errors
    /// [`InboxError`]. A file that is refused is removed.
    pub fn take(&mut self, robot: &str, part: &SessionPart) -> Result<Received, InboxError> {
        keys::validate_name(robot).map_err(|error| InboxError::Invalid(error.to_string()))?;
        if robot.starts_with('.') {
            return Err(InboxError::Invalid(format!("the name {robot:?} begins with a dot")));
        }
        part.validate().map_err(|error| InboxError::Invalid(error.to_string()))?;
        let folder = self.settings.folder.join(robot);
        let digest = types::hexadecimal::encode(&part.digest);
        let complete = folder.join(format!("{digest}.{COMPLETE}"));
        if complete.exists() {
            return Ok(Received { bytes: part.total_bytes, is_complete: true });
        }
        let incomplete = folder.join(format!("{digest}_{}.{INCOMPLETE}", part.total_bytes));
        let of_part = |source| InboxError::Io { path: incomplete.clone(), source };
        let received = incomplete.metadata().map_or(0, |metadata| metadata.len());
        if received == 0 {
            // Before anything is kept for a robot that cannot end it.
            self.key_of(robot)?;
        }
        if received >= part.total_bytes {
            // All of it came before a server was killed or could not read its disk.
            return self.finish(robot, part, &incomplete, &complete);
        }
        if received != part.offset || part.bytes.is_empty() {
            return Ok(Received { bytes: received, is_complete: false });
        }
        if received == 0 {
            self.make_room(&folder, part.total_bytes, &incomplete)?;
            std::fs::create_dir_all(&folder).map_err(of_part)?;
        }
        let append = || {
            let mut file = File::options().create(true).append(true).open(&incomplete)?;
            file.write_all(&part.bytes).inspect_err(|_| {
                // A full disk: as if nothing had come.
                let _ = file.set_len(received);
            })
        };
        append().map_err(of_part)?;
        let bytes = received + part.bytes.len() as u64;
        if bytes < part.total_bytes {
            return Ok(Received { bytes, is_complete: false });
        }
        self.finish(robot, part, &incomplete, &complete)
    }

    /// Checks a file that has been received, and makes it a session.
    fn finish(
        &self,
        robot: &str,
        part: &SessionPart,
        incomplete: &Path,
        complete: &Path,
    ) -> Result<Received, InboxError> {
        let of_part = |source| InboxError::Io { path: incomplete.to_owned(), source };
        let bytes = files::read(incomplete, part.total_bytes).map_err(of_part)?;
        if Sha256::digest(&bytes)[..] != part.digest {
            std::fs::remove_file(incomplete).map_err(of_part)?;
            tracing::warn!(robot, "a session was damaged on its way and is handed in again");
            return Ok(Received { bytes: 0, is_complete: false });
        }
        let checked = incomplete.with_extension(CHECKED);
        std::fs::rename(incomplete, &checked).map_err(of_part)?;
        if let Err(error) = self.check(robot, complete, &bytes) {
            std::fs::remove_file(&checked).map_err(of_part)?;
            // Whoever hands in nothing but what is refused leaves nothing; a folder with other files stays.
            let _ = complete.parent().map(std::fs::remove_dir);
            return Err(error);
        }
        let keep = || {
            File::open(&checked)?.sync_all()?;
            std::fs::rename(&checked, complete)?;
            // The name, too, is on the disk before it is acknowledged.
            complete.parent().map_or(Ok(()), |folder| File::open(folder)?.sync_all())
        };
        keep().map_err(|source| {
            // It can be kept at the next attempt.
            let _ = std::fs::rename(&checked, incomplete);
            of_part(source)
        })?;
        Ok(Received { bytes: part.total_bytes, is_complete: true })
    }

    /// Checks the signature of a file before anything in it is decoded, then its form and its robot.
    fn check(&self, robot: &str, path: &Path, bytes: &[u8]) -> Result<(), InboxError> {
        if let Some(key) = self.key_of(robot)? {
            verify(path, bytes, &key)?;
        }
        let session = Session::check(path, bytes)?;
        if session.header.robot != robot {
            let (recorded_by, robot) = (session.header.robot, robot.to_owned());
            return Err(InboxError::OtherRobot { recorded_by, robot });
        }
        if session.recorded.is_none() {
            return Err(HandInError::NothingRecorded { path: path.to_owned() }.into());
        }
        Ok(())
    }

    /// The key of a robot; `None` where none is needed.
    fn key_of(&self, robot: &str) -> Result<Option<PublicKey>, InboxError> {
        let Some(keys) = &self.settings.keys else { return Ok(None) };
        let key = keys.join(format!("{robot}.pub")).to_string_lossy().parse::<PublicKey>();
        key.map(Some).map_err(|source| InboxError::Key { robot: robot.to_owned(), source })
    }

    /// Checks that there is room for a file that is begun, and removes the oldest of too many that were begun before, and those that no robot
    /// goes on with.
    fn make_room(&self, folder: &Path, bytes: u64, begun: &Path) -> Result<(), InboxError> {
        let InboxSettings { folder: root, bytes_of_robot, bytes_in_all, .. } = &self.settings;
        let mut all = Vec::new();
        for of_robot in folders_of_robots(root)? {
            all.extend(sizes(&of_robot)?);
        }
        let now = SystemTime::now();
        let mut replaced = BTreeSet::new();
        let mut incomplete = Vec::new();
        for (path, _) in all.iter().filter(|(path, _)| is_incomplete(path) && path != begun) {
            let Some(written) = path.metadata().ok().and_then(|metadata| metadata.modified().ok()) else {
                continue;
            };
            if now.duration_since(written).is_ok_and(|age| age > ABANDONED) {
                replaced.insert(path.as_path());
            } else if path.parent() == Some(folder) {
                incomplete.push((written, path.as_path()));
            }
        }
        incomplete.sort();
        let too_many = (incomplete.len() + 1).saturating_sub(MOST_INCOMPLETE);
        replaced.extend(incomplete[..too_many].iter().map(|(_, path)| *path));
        let stay: Vec<&(PathBuf, u64)> =
            all.iter().filter(|(path, _)| path != begun && !replaced.contains(path.as_path())).collect();
        let of_robot: Vec<_> =
            stay.iter().copied().filter(|(path, _)| path.parent() == Some(folder)).collect();
        for (whose, files, most, switch) in [
            ("this robot's", of_robot, *bytes_of_robot, "--inbox-robot-limit"),
            ("all", stay, *bytes_in_all, "--inbox-limit"),
        ] {
            let used = bytes + files.iter().map(|(_, size)| size).sum::<u64>();
            if used > most {
                let unfinished = files.iter().filter(|(path, _)| is_incomplete(path));
                let unfinished = unfinished.map(|(_, size)| size).sum();
                return Err(InboxError::Full { whose, used, unfinished, most, switch });
            }
        }
        for &path in &replaced {
            std::fs::remove_file(path).map_err(|source| InboxError::Io { path: path.to_owned(), source })?;
        }
        Ok(())
    }
}

/// What of a full inbox is kept for files that have begun to come in, for an error.
fn describe(unfinished: u64) -> String {
    if unfinished == 0 {
        String::new()
    } else {
        format!(", {unfinished} of them for files that have only begun to come in")
    }
}

/// Whether a file has begun to come in.
fn is_incomplete(path: &Path) -> bool {
    path.extension().is_some_and(|of| of == INCOMPLETE)
}

/// The folders of all robots.
fn folders_of_robots(root: &Path) -> Result<Vec<PathBuf>, InboxError> {
    let entries = std::fs::read_dir(root)
        .and_then(|entries| entries.map(|entry| Ok(entry?.path())).collect::<std::io::Result<Vec<_>>>());
    let mut folders = entries.map_err(|source| InboxError::Io { path: root.to_owned(), source })?;
    folders.retain(|path| path.is_dir());
    Ok(folders)
}

/// Removes the files whose check ended the program.
fn remove_checked(root: &Path) -> Result<(), InboxError> {
    for folder in folders_of_robots(root)? {
        for (path, bytes) in sizes(&folder)? {
            if path.extension().is_some_and(|of| of == CHECKED) {
                let failed = |source| InboxError::Io { path: path.clone(), source };
                std::fs::remove_file(&path).map_err(failed)?;
                let path = path.display();
                tracing::warn!(%path, bytes, "the program ended while it checked this session, which is removed");
            }
        }
    }
    Ok(())
}

/// The files of a folder with their bytes, of incomplete ones those that they will have.
fn sizes(folder: &Path) -> Result<Vec<(PathBuf, u64)>, InboxError> {
    let of_file = |path: PathBuf| {
        let announced = path
            .file_stem()
            .filter(|_| is_incomplete(&path))
            .and_then(|stem| stem.to_str()?.rsplit_once('_')?.1.parse().ok());
        let size = announced.map_or_else(|| path.metadata().map(|metadata| metadata.len()), Ok)?;
        Ok((path, size))
    };
    let read = || -> std::io::Result<Vec<(PathBuf, u64)>> {
        std::fs::read_dir(folder)?.map(|entry| of_file(entry?.path())).collect()
    };
    read().map_err(|source| InboxError::Io { path: folder.to_owned(), source })
}

/// The SHA-256 of the bytes of a file.
pub fn digest_of(bytes: &[u8]) -> [u8; 32] {
    Sha256::digest(bytes).into()
}

/// Whether a file lies where an inbox keeps a complete session, `ROBOT/DIGEST.session`: it may be the only copy, of
/// whichever inbox.
///
/// # Arguments
/// * `robot`: who recorded the session.
/// * `bytes`: those of the file.
pub fn is_in_inbox(path: &Path, robot: &str, bytes: &[u8]) -> bool {
    let path = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let name = format!("{}.{COMPLETE}", types::hexadecimal::encode(&digest_of(bytes)));
    let folder = path.parent().and_then(Path::file_name);
    path.file_name() == Some(OsStr::new(&name)) && folder == Some(OsStr::new(robot))
}
