//! Files that are there as a whole or not at all.

use std::ffi::OsString;
use std::fs::{File, OpenOptions};
use std::io::{Result, Write as _};
use std::path::{Path, PathBuf};

/// How the name of a file or folder ends while it is written.
const UNFINISHED: &str = ".unfinished";

/// Writes a file beside its place and renames it: whatever stops the program, and whatever fails, the former one stays.
///
/// What a killed attempt left is replaced.
///
/// # Errors
/// Those of the file system, a full disk among them; nothing is left then.
///
/// ```
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("settings.yaml");
/// files::write_whole(&path, b"map: hall\n")?;
/// assert_eq!(files::read_to_string(&path)?, "map: hall\n");
/// # Ok::<(), std::io::Error>(())
/// ```
pub fn write_whole(path: impl AsRef<Path>, bytes: &[u8]) -> Result<()> {
    write(path.as_ref(), bytes, &mut OpenOptions::new())
}

/// The same for a secret: readable by its owner only, where there are modes.
///
/// # Errors
/// As of [`write_whole`].
pub fn write_whole_secret(path: impl AsRef<Path>, bytes: &[u8]) -> Result<()> {
    write(path.as_ref(), bytes, &mut owner_only())
}

/// Writes a file that is not there yet, and waits until it is on the disk.
///
/// # Errors
/// [`std::io::ErrorKind::AlreadyExists`], and the others of the file system; nothing is left then but what was there before.
///
/// ```
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("robot.key.pub");
/// files::write_new(&path, b"a key")?;
/// assert!(files::write_new(&path, b"another key").is_err());
/// # Ok::<(), std::io::Error>(())
/// ```
pub fn write_new(path: impl AsRef<Path>, bytes: &[u8]) -> Result<()> {
    create(path.as_ref(), bytes, &mut OpenOptions::new())
}

/// The same for a secret: readable by its owner only, where there are modes.
///
/// # Errors
/// As of [`write_new`].
pub fn write_new_secret(path: impl AsRef<Path>, bytes: &[u8]) -> Result<()> {
    create(path.as_ref(), bytes, &mut owner_only())
}

fn owner_only() -> OpenOptions {
    #[cfg_attr(not(unix), expect(unused_mut, reason = "there are no modes"))]
    let mut options = OpenOptions::new();
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    options
}

fn create(path: &Path, bytes: &[u8], options: &mut OpenOptions) -> Result<()> {
    let mut file = options.write(true).create_new(true).open(path)?;
    let written = file.write_all(bytes).and_then(|()| file.sync_all());
    written.inspect_err(|_| _ = std::fs::remove_file(path))?;
    sync_parent(path);
    Ok(())
}

fn write(path: &Path, bytes: &[u8], options: &mut OpenOptions) -> Result<()> {
    let beside = beside(path);
    // A link or a file of another mode must not be written through.
    remove_file(&beside)?;
    let mut written = || {
        let mut file = options.write(true).create_new(true).open(&beside)?;
        file.write_all(bytes)?;
        file.sync_all()?;
        std::fs::rename(&beside, path)
    };
    written().inspect_err(|_| _ = std::fs::remove_file(&beside))?;
    sync_parent(path);
    Ok(())
}

/// Makes a folder beside its place, lets `fill` write into it, and renames it.
///
/// What a killed attempt left is removed first.
///
/// # Errors
/// Those of the file system and of `fill`; nothing is left then. A folder that is there is not replaced.
pub fn create_whole_folder<E: From<std::io::Error>>(
    path: &Path,
    fill: impl FnOnce(&Path) -> std::result::Result<(), E>,
) -> std::result::Result<(), E> {
    if path.exists() {
        return Err(std::io::Error::from(std::io::ErrorKind::AlreadyExists).into());
    }
    let beside = beside(path);
    let remove = || match std::fs::remove_dir_all(&beside) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    };
    remove()?;
    let made = std::fs::create_dir_all(&beside)
        .map_err(E::from)
        .and_then(|()| fill(&beside))
        .and_then(|()| std::fs::rename(&beside, path).map_err(E::from));
    made.inspect_err(|_| _ = remove())?;
    sync_parent(path);
    Ok(())
}

fn beside(path: &Path) -> PathBuf {
    let mut name = OsString::from(path.file_name().unwrap_or_default());
    name.push(UNFINISHED);
    path.with_file_name(name)
}

fn remove_file(path: &Path) -> Result<()> {
    match std::fs::remove_file(path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

/// Waits until a name is on the disk; without it the former one may come back when the power fails.
fn sync_parent(path: &Path) {
    let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if cfg!(unix)
        && let Err(error) = File::open(parent).and_then(|folder| folder.sync_all())
    {
        tracing::debug!(path = %path.display(), "it may be lost if the power fails now: {error}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_replaced_as_a_whole_and_nothing_is_left_beside_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("settings.yaml");
        std::fs::write(folder.path().join("settings.yaml.unfinished"), "of a killed program").unwrap();
        for text in ["one", "two, longer"] {
            write_whole(&path, text.as_bytes()).unwrap();
            assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
        }
        write_whole_secret(folder.path().join("key"), b"secret").unwrap();
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2);
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt as _;
            let mode = std::fs::metadata(folder.path().join("key")).unwrap().permissions().mode();
            assert_eq!(mode & 0o777, 0o600);
        }
        // Where it cannot take its place, it is not left beside it.
        let taken = folder.path().join("folder");
        std::fs::create_dir_all(taken.join("inside")).unwrap();
        assert!(write_whole(&taken, b"text").is_err());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 3);
    }

    #[test]
    fn a_folder_is_there_with_all_of_it_or_not_at_all() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("fleet");
        std::fs::create_dir_all(folder.path().join("fleet.unfinished/half")).unwrap();
        let full = |_: &Path| Err(std::io::Error::from(std::io::ErrorKind::StorageFull));
        assert_eq!(create_whole_folder(&path, full).unwrap_err().kind(), std::io::ErrorKind::StorageFull);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        create_whole_folder(&path, |inside| std::fs::write(inside.join("a"), "a")).unwrap();
        assert_eq!(std::fs::read_dir(&path).unwrap().count(), 1);
        let again = create_whole_folder(&path, |_| Ok::<(), std::io::Error>(())).unwrap_err();
        assert_eq!(again.kind(), std::io::ErrorKind::AlreadyExists);
    }
}
