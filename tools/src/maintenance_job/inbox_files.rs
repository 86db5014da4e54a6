//! Files of an inbox whose sessions a map has.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};

use super::report::JobReport;

/// Removes the files of sessions that the map has from the inbox. To be called when the map is on the disk.
///
/// A file that was named and lies elsewhere stays, and so does one that a link in the inbox leads to.
///
/// # Returns
/// What was removed.
///
/// # Errors
/// A file that cannot be removed; the others are.
pub fn remove_taken(inbox: &Path, report: &JobReport) -> (Vec<PathBuf>, Result<()>) {
    let taken = report.taken.iter().map(|session| &session.file);
    let files = taken.chain(report.known.iter().map(|session| &session.file));
    let (mut removed, mut failed) = (Vec::new(), Ok(()));
    for file in files.filter(|file| is_within(inbox, file)) {
        match std::fs::remove_file(file) {
            Ok(()) => removed.push(file.clone()),
            Err(error) => {
                failed = Err(error).with_context(|| format!("{} cannot be removed", file.display()));
            }
        }
    }
    (removed, failed)
}

fn is_within(folder: &Path, file: &Path) -> bool {
    let Ok(folder) = folder.canonicalize() else { return false };
    file.canonicalize().is_ok_and(|file| file.starts_with(folder))
}

#[cfg(test)]
mod tests {
    use map::sessions::SessionId;

    use super::*;
    use crate::maintenance_job::PassedSession;

    #[test]
    fn only_files_of_the_inbox_are_removed() {
        let folder = tempfile::tempdir().unwrap();
        let inbox = folder.path().join("inbox");
        std::fs::create_dir_all(inbox.join("ada")).unwrap();
        let named = ["inbox/ada/taken.session", "elsewhere.session", "inbox/../elsewhere.session"];
        let files = named.map(|name| folder.path().join(name));
        for file in &files {
            std::fs::write(file, "").unwrap();
        }
        std::fs::write(inbox.join("ada/refused.session"), "").unwrap();
        let known = |file: &PathBuf| PassedSession { file: file.clone(), id: SessionId::from_bytes([1; 16]) };
        let report = JobReport { known: files.iter().map(known).collect(), ..JobReport::default() };
        let (removed, failed) = remove_taken(&inbox, &report);
        failed.unwrap();
        assert_eq!(removed, files[..1]);
        assert!(!files[0].exists() && files[1].exists() && inbox.join("ada/refused.session").exists());
    }
}
