//! `driftless view`: a map or a run in the browser.

use crate::map_place::read_map;
use crate::old_spellings;
use crate::open_page::announce;
use crate::plotting::RunFiles;
use crate::run_tracks::run_tracks;
use anyhow::{Context as _, ensure};
use map::{MapContents, store};
use map_server::{ImageLocalizer, ServedMap};
use nalgebra::Vector3;
use recognition::LoadedMap;
use std::collections::BTreeMap;
use std::net::{Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use viewer::{ViewedMap, Viewer, ViewerServer};

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  driftless view --map place.db --open\n  driftless view out --map place.db\n  \
    driftless view --map s3://bucket/city@candidate\n\n\
    Shows it on http://127.0.0.1:8080 until Ctrl-C; nothing is written. A running server shows its robots too:\n  \
    map_server --map place=place.db --http 127.0.0.1:8080"
)]
pub struct Args {
    /// Output folder of a run, with its states.csv
    #[arg(value_name = "DIR", required_unless_present = "map")]
    run: Option<PathBuf>,
    /// Database of a map, or its releases: a folder or URL, with @7 for release 7, or @candidate. With DIR the one that the run
    /// was localized in, which is shown below the run
    #[arg(long, value_name = "DB|URL")]
    map: Option<PathBuf>,
    /// Ground truth of the run [default: that of the recording which summary.json names]
    #[arg(long, value_name = "FILE", requires = "run")]
    groundtruth: Option<PathBuf>,
    /// Port on this machine; 0 takes any free one
    #[arg(long, default_value_t = 8080)]
    port: u16,
    /// Open the page in the system's browser
    #[arg(long)]
    open: bool,
}

/// Runs the command.
///
/// # Errors
/// A map or a run that cannot be read, a port that is taken.
pub fn run(args: &Args) -> anyhow::Result<()> {
    if let Some(folder) = args.run.as_ref().filter(|folder| is_database(folder)) {
        old_spellings::refuse("view", folder)?;
    }
    let database = args.map.as_ref();
    let contents = database.map(|map| read_map(map)).transpose()?.map(|named| named.contents);
    let gravity = contents.as_ref().and_then(|contents| contents.info.gravity_in_global);
    let mut missing = Vec::new();
    let viewer = if let Some(folder) = &args.run {
        let run =
            RunFiles::read(folder, args.groundtruth.as_deref(), None).context("the run cannot be shown")?;
        if let Some(contents) = &contents {
            check_map(&run, folder, database, contents)?;
        }
        missing.clone_from(&run.missing);
        Viewer::with_run(Some(run_tracks(&run, gravity.map_or(Vector3::z(), |gravity| -gravity))))
    } else {
        Viewer::of_stored_maps()
    };
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    if let Some((path, mut contents)) = database.zip(contents) {
        let name = name_of(path);
        viewer.set_map(ViewedMap::of_contents(&name, &contents));
        let images = std::mem::take(&mut contents.images).into_iter();
        let images: BTreeMap<_, _> = images.map(|image| (image.keyframe, image.jpeg)).collect();
        viewer.set_keyframe_images(&name, Arc::new(images));
        if args.run.is_none() {
            let viewer = Arc::clone(&viewer);
            // The index of a large map takes a while; the page does not wait for it.
            runtime.spawn_blocking(move || take_images(&viewer, name, contents));
        }
    }
    runtime.block_on(async {
        let address = SocketAddr::from((Ipv4Addr::LOCALHOST, args.port));
        let server = ViewerServer::start(address, viewer).await.context("choose another with --port")?;
        let url = format!("http://{}", server.address());
        if args.open {
            announce(&url);
        } else {
            println!("{url}");
        }
        for sentence in &missing {
            eprintln!("{sentence}");
        }
        tokio::signal::ctrl_c().await?;
        server.stop().await;
        Ok(())
    })
}

/// Whether a path is that of a map, and not of a run.
fn is_database(path: &Path) -> bool {
    let is_run = path.join("states.csv").exists();
    !is_run && (store::is_map(path) || path.extension().is_some_and(|extension| extension == "db"))
}

/// Refuses to draw a run in another map than it was localized in.
fn check_map(
    run: &RunFiles,
    folder: &Path,
    database: Option<&PathBuf>,
    contents: &MapContents,
) -> anyhow::Result<()> {
    let (Some(of_run), Some(of_map)) = (&run.map_identity, contents.info.identity) else { return Ok(()) };
    ensure!(
        *of_run == of_map.to_string(),
        "{} was localized in the map {of_run}, but {} is the map {of_map}: give the run's own map with --map (`driftless map-info \
         --map DB` prints the identity of a map)",
        folder.display(),
        database.map_or_else(String::new, |path| path.display().to_string())
    );
    Ok(())
}

/// Lets people localize images in a map.
fn take_images(viewer: &Viewer, name: String, contents: MapContents) {
    match LoadedMap::from_contents(contents) {
        Ok(map) => {
            let map = ServedMap { name, map: Arc::new(map) };
            viewer.take_images(Arc::new(ImageLocalizer::new(vec![map])));
        }
        Err(error) => tracing::warn!("images cannot be localized in this map: {error}"),
    }
}

/// The name of a map, as of `maps/hall.db`.
fn name_of(database: &Path) -> String {
    database.file_stem().map_or_else(|| "map".to_owned(), |name| name.to_string_lossy().into_owned())
}
